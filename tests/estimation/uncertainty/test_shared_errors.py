"""What encoders hide is the same for every SU beyond them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from calibrated import calibration

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.uncertainty.covariance import ArrowCovariance
from skin2urdf.estimation.uncertainty.observability import observability
from skin2urdf.estimation.uncertainty.shared_errors import with_shared_errors


def _only_in_pose(cost: Cost, pose: int) -> Cost:
    """The cost with encoder errors in one pose alone."""
    at = np.arange(len(cost.blocks.q)) == pose
    all_of_them = cost.blocks.encoders
    encoders = replace(
        all_of_them,
        position_sd=all_of_them.position_sd * at[:, None],
        hidden=all_of_them.hidden * at[:, None, None],
        white=all_of_them.white * 0.0,
    )
    return Cost(cost.tree, replace(cost.blocks, encoders=encoders), cost.priors)


def _plain(cost: Cost) -> ArrowCovariance:
    found = replace(calibration().estimate, cost=cost)
    return observability(found).covariance


def test_no_hidden_errors_change_nothing() -> None:
    cost = _only_in_pose(calibration().estimate.cost, -1)
    before = _plain(cost)
    after = with_shared_errors(before, cost, calibration().estimate.state)
    np.testing.assert_array_equal(after.joint, before.joint)
    np.testing.assert_array_equal(after.own, before.own)


def test_the_covariance_is_that_of_disturbed_targets() -> None:
    """Against gradients of the cost whose targets are moved by one error at a time."""
    state = calibration().estimate.state
    before = _plain(_only_in_pose(calibration().estimate.cost, -1))
    cost = _only_in_pose(calibration().estimate.cost, 1)
    blocks, encoders = cost.blocks, cost.blocks.encoders
    Y = cost.at(state).kin.features()[1]
    L, U, J = blocks.chains.joint.shape[1], len(blocks.su_joint), len(before.joint)
    zero = cost.at(state).gradient().flat()

    def score(disturbance: F64) -> F64:
        """Gradient when the features (U, m, 3) of the pose are off by a disturbance."""
        target = np.array(blocks.target)
        target[1] += blocks.W[1] @ disturbance
        moved = Cost(cost.tree, replace(blocks, target=target), cost.priors)
        return np.asarray(zero - moved.at(state).gradient().flat())

    D = cost.tree.n_joints
    dense = before.dense()
    extra = np.zeros_like(dense)
    for e in range(D):
        for d in range(-1, D):
            sd = encoders.position_sd[1, e] if d < 0 else np.sqrt(encoders.hidden[1, d, e])
            shared = np.zeros_like(Y)
            for u in range(U):
                chain = list(blocks.chains.joint[u, : blocks.chains.length[u]])
                if e not in chain or (d >= 0 and d not in chain):
                    continue
                i = chain.index(e)
                if d < 0:
                    shared[u] = sd * blocks.pull[1, u, i][:, None] * Y[u, 1 + i]
                else:
                    effect = Y[u, 1 + i] - encoders.omega2[1, d] * Y[u, 1 + L + i]
                    shared[u, 1 + L + chain.index(d)] = sd * effect
            if not shared.any():
                continue
            g = score(shared)
            extra += np.outer(g, g)
            for u in range(U):
                alone = score(shared * (np.arange(U) == u)[:, None, None])
                extra -= np.outer(alone, alone)
    wanted = dense @ extra @ dense
    after = with_shared_errors(before, cost, state)
    found = (after.joint - before.joint, after.su() - before.su())
    scale = np.abs(wanted[:J, :J]).max()
    np.testing.assert_allclose(found[0], wanted[:J, :J], atol=1e-6 * scale)
    for u in range(U):
        at = slice(J + 15 * u, J + 15 * (u + 1))
        np.testing.assert_allclose(
            found[1][u], wanted[at, at], atol=1e-6 * max(scale, float(np.abs(wanted[at, at]).max()))
        )


def test_what_is_rounded_away_is_the_same_where_a_joint_comes_back() -> None:
    """One joint rests at one place in two poses, and elsewhere in a third."""
    estimate = calibration().estimate
    state, blocks, joint = estimate.state, estimate.cost.blocks, 0
    before = _plain(_only_in_pose(estimate.cost, -1))
    rests = np.flatnonzero((blocks.encoders.position_sd > 0)[:, joint])[:3]
    sd, q = np.zeros_like(blocks.encoders.position_sd), np.array(blocks.q)
    sd[rests, joint] = 1e-4
    q[rests, joint] += [0.3 - q[rests[0], joint], 0.3 + 1e-6 - q[rests[1], joint], 0.1]
    encoders = replace(
        blocks.encoders,
        position_sd=sd,
        hidden=np.zeros_like(blocks.encoders.hidden),
        white=np.zeros_like(blocks.encoders.white),
    )
    blocks = replace(blocks, q=q, encoders=encoders)
    cost = Cost(estimate.tree, blocks, estimate.cost.priors)
    here = cost.at(state)
    Y, zero = here.kin.features(), here.gradient().flat()
    U, J, dense = len(blocks.su_joint), len(before.joint), before.dense()
    each = {}
    for pose in rests:
        for u in range(U):
            chain = list(blocks.chains.joint[u, : blocks.chains.length[u]])
            if joint not in chain:
                continue
            i = chain.index(joint)
            target = np.array(blocks.target)
            shift = 1e-4 * blocks.pull[pose, u, i][:, None] * Y[pose, u, 1 + i]
            target[pose, u] += blocks.W[pose, u] @ shift
            moved = Cost(cost.tree, replace(blocks, target=target), cost.priors)
            each[pose, u] = zero - moved.at(state).gradient().flat()
    together = [
        sum(g for (pose, _), g in each.items() if pose in place)
        for place in (set(rests[:2]), {rests[2]})
    ]
    extra = sum(np.outer(g, g) for g in together) - sum(np.outer(g, g) for g in each.values())
    wanted = dense @ extra @ dense
    after = with_shared_errors(before, cost, state)
    scale = float(np.abs(wanted).max())
    np.testing.assert_allclose(after.joint - before.joint, wanted[:J, :J], atol=1e-6 * scale)
    for u in range(U):
        at = slice(J + 15 * u, J + 15 * (u + 1))
        np.testing.assert_allclose(
            after.su()[u] - before.su()[u], wanted[at, at], atol=1e-6 * scale
        )


def test_noise_of_encoders_is_that_of_disturbed_samples() -> None:
    """Against one disturbed sample after the other, with patterns that have tones in common."""
    estimate = calibration().estimate
    state, blocks, pose, n = estimate.state, estimate.cost.blocks, 1, 60
    before = _plain(_only_in_pose(estimate.cost, -1))
    U, D, L = len(blocks.su_joint), estimate.tree.n_joints, blocks.chains.joint.shape[1]
    omega2 = (2 * np.pi * (3.0 + np.stack([np.arange(D), 1.0 + np.arange(D)]))) ** 2
    phase = np.sqrt(omega2) * np.arange(n)[:, None, None] / n + np.stack([np.arange(D)] * 2)
    twice = np.fft.fft(np.eye(n), axis=0) * -((2 * np.pi * np.fft.fftfreq(n, 1 / n)) ** 2)[:, None]
    twice = np.fft.ifft(twice, axis=0).real
    X = np.concatenate([np.cos(phase).sum(axis=1), -(omega2 * np.cos(phase)).sum(axis=1)], axis=1)

    def chain(u: int) -> list[int]:
        return list(blocks.chains.joint[u, : blocks.chains.length[u]])

    W, rows, columns = np.array(blocks.W), [], []
    for u in range(U):
        k = len(chain(u))
        rows.append(np.r_[1 : 1 + k, 1 + L : 1 + L + k])
        columns.append(X[:, [*chain(u), *(D + j for j in chain(u))]])
        W[pose, u] = 0.0
        W[pose, u, 0, 0] = np.sqrt(n)
        W[pose, u][np.ix_(rows[u], rows[u])] = np.linalg.cholesky(columns[u].T @ columns[u]).T
    at = np.arange(len(blocks.q)) == pose
    white = np.zeros_like(blocks.encoders.white)
    white[pose] = np.square(1e-5 * (1.0 + np.arange(D)))
    encoders = replace(
        blocks.encoders,
        white=white,
        products=(X.T @ X) * at[:, None, None],
        tones=np.tile(omega2.T, (len(at), 1, 1)),
        hidden=np.zeros_like(blocks.encoders.hidden),
        position_sd=np.zeros_like(blocks.encoders.position_sd),
    )
    blocks = replace(blocks, W=W, encoders=encoders)
    cost = Cost(estimate.tree, blocks, estimate.cost.priors)
    here = cost.at(state)
    Y, zero, dense = here.kin.features()[pose], here.gradient().flat(), before.dense()
    J, extra = len(before.joint), np.zeros_like(dense)
    for e in range(D):
        each = np.zeros((U, n, len(zero)))
        for u in (u for u in range(U) if e in chain(u)):
            i = chain(u).index(e)
            readings = np.eye(n)[..., None] * Y[u, 1 + i] + twice[..., None] * Y[u, 1 + L + i]
            found = np.linalg.lstsq(columns[u], readings.reshape(n, -1), rcond=None)[0]
            for k, shift in enumerate(np.moveaxis(found.reshape(-1, n, 3), 1, 0)):
                target = np.array(blocks.target)
                moved = 1e-5 * (1.0 + e) * shift
                target[pose, u] += W[pose, u][:, rows[u]] @ moved
                disturbed = Cost(cost.tree, replace(blocks, target=target), cost.priors)
                each[u, k] = zero - disturbed.at(state).gradient().flat()
        together = each.sum(axis=0)
        extra += together.T @ together - sum(g.T @ g for g in each)
    wanted = dense @ extra @ dense
    after = with_shared_errors(before, cost, state)
    scale = float(np.abs(wanted[:J, :J]).max())
    np.testing.assert_allclose(after.joint - before.joint, wanted[:J, :J], atol=1e-5 * scale)
    for u in range(U):
        own = slice(J + 15 * u, J + 15 * (u + 1))
        added, size = after.su()[u] - before.su()[u], float(np.abs(wanted[own, own]).max())
        np.testing.assert_allclose(added, wanted[own, own], atol=1e-5 * max(size, scale))
