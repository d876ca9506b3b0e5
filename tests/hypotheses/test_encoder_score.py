"""The score test of encoders: exact derivatives, sizes and significance of their errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import random_cost, random_features, random_state, random_tree, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.solve.estimate import Estimate, EstimationSettings, estimate
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.hypotheses.encoder_score import encoder_scores
from skin2urdf.hypotheses.suspicions import gross_scales
from skin2urdf.signals.records import Features

SETTINGS = EstimationSettings(Priors(gravity=GRAVITY), robust=False)


def test_the_encoder_jacobian_is_that_of_differences() -> None:
    rng = np.random.default_rng(4)
    tree = random_tree(rng, 5, 6, prismatic=0.4)
    assert tree.prismatic.any()
    state = random_state(rng, tree, n_logs=2)
    cost = random_cost(rng, tree, state, 4, noise=0.05)
    K = cost.at(state).encoder_jacobian()
    P, U, rows, _ = K.shape
    L = cost.blocks.chains.joint.shape[1]
    h = 1e-6

    def residuals(q: F64) -> F64:
        moved = Cost(tree, replace(cost.blocks, q=q), cost.priors)
        return moved.at(state).residual.reshape(P, U, rows)

    for p in range(P):
        for d in range(tree.n_joints):
            e = np.zeros_like(cost.blocks.q)
            e[p, d] = h
            change = (residuals(cost.blocks.q + e) - residuals(cost.blocks.q - e)) / (2 * h)
            for u in range(U):
                own = list(cost.blocks.chains.joint[u, : cost.blocks.chains.length[u]])
                expected = K[p, u, :, own.index(d)] if d in own else np.zeros(rows)
                assert change[p, u] == pytest.approx(expected, rel=1e-5, abs=1e-4 * abs(K).max())
    grown = np.array(cost.at(state).whole.Y)
    grown[:, :, 0] = 0.0
    exact = cost.blocks.W @ (grown @ cost.at(state).whole.GT)
    assert K[..., L:].sum(axis=-1) == pytest.approx(exact.reshape(P, U, rows))


def chain(noise: float, seed: int = 0) -> Features:
    rng = np.random.default_rng(seed)
    tree = serial_tree(4)
    return random_features(rng, tree, random_state(rng, tree, intrinsics=0.3), 10, noise, False)


def fitted(features: Features) -> Estimate:
    return estimate(features, serial_tree(4), SETTINGS)


def offset_from(pose: int) -> F64:
    h = np.zeros((1, 11))
    h[0, pose:10] = -1.0
    return h


def test_the_size_of_a_small_error_is_found_in_one_step() -> None:
    features = chain(0.05)
    q = np.array(features.q)
    q[6:, 2] += 0.01
    found = fitted(replace(features, q=q))
    gain, size, deviation = encoder_scores(found).test(2, offset_from(6))
    assert size[0] == pytest.approx(0.01, abs=5 * deviation[0] + 2e-4)
    assert gain[0] == pytest.approx((size[0] / deviation[0]) ** 2)
    assert gain[0] > 0.9 * (found.chi2 - found.degrees_of_freedom)


def test_a_constant_offset_is_no_error() -> None:
    scores = encoder_scores(fitted(chain(0.05)))
    gain, _, deviation = scores.test(1, offset_from(0))
    assert gain[0] == 0.0
    assert np.isinf(deviation[0])


def test_without_errors_gains_are_chi_squared() -> None:
    gains = [
        scores.test(d, np.concatenate([offset_from(p) for p in (3, 6, 8)]))[0]
        for scores in (encoder_scores(fitted(chain(0.05, seed))) for seed in range(12))
        for d in range(4)
    ]
    assert np.mean(gains) == pytest.approx(1.0, abs=0.45)
    assert np.max(gains) < 16


def test_scores_are_those_of_all_coordinates_written_out() -> None:
    """K and J as whole matrices, everything else projected out by least squares."""
    rng = np.random.default_rng(5)
    tree = random_tree(rng, 4, 5, prismatic=0.4)
    features = random_features(rng, tree, random_state(rng, tree, n_logs=2), 8, 0.05, False)
    found = estimate(features, tree, SETTINGS)
    scores, here = encoder_scores(found), found.cost.at(found.state)
    equations, free, K = here.normal_equations(), found.free, here.encoder_jacobian()
    by_joint, by_su = here.jacobian()
    P, U, rows = K.shape[:3]
    D, L, n_joint = tree.n_joints, K.shape[-1] // 2, len(equations.joint)
    whole_K = np.zeros((U, P, rows, D, P + 1))
    J = np.zeros((U, P * rows, n_joint + U * by_su.shape[-1]))
    for u in range(U):
        for k, d in enumerate(tree.chain(int(tree.su_joint[u]))):
            whole_K[u, np.arange(P), :, d, np.arange(P)] = K[:, u, :, k]
            whole_K[u, :, :, d, P] = K[:, u, :, L + k]
        np.add.at(J[u].T, equations.columns[u], by_joint[u].T)
        at = n_joint + u * by_su.shape[-1]
        J[u, :, at : at + by_su.shape[-1]] = by_su[u, : P * rows]
    moving = np.concatenate([free.joints.ravel(), free.logs.ravel(), free.sus.ravel()])
    J, r = J.reshape(U * P * rows, -1)[:, moving], np.swapaxes(here.residual, 0, 1).ravel()
    H = np.zeros((len(moving), len(moving)))
    H[:n_joint, :n_joint] = equations.joint
    for u, su in enumerate(np.arange(len(moving) - n_joint).reshape(U, -1) + n_joint):
        H[np.ix_(su, su)] = equations.su[u]
        np.add.at(H, (su[:, None], equations.columns[u]), equations.mixed[u])
        np.add.at(H.T, (su[:, None], equations.columns[u]), equations.mixed[u])
    g = here.gradient().flat()[moving]
    known = np.linalg.pinv(H[np.ix_(moving, moving)], rcond=1e-10, hermitian=True)
    for d in range(D):
        Kd = whole_K.reshape(U * P * rows, D, P + 1)[:, d]
        direction = np.append(np.zeros(P), -1.0)[None]
        A = Kd.T @ Kd - Kd.T @ J @ known @ (J.T @ Kd)
        b = Kd.T @ r - Kd.T @ J @ known @ g
        gain, size, _ = scores.test(d, direction)
        assert scores.alone[d] == pytest.approx(Kd.T @ Kd, rel=1e-9, abs=1e-9)
        if np.isfinite(scores.test(d, direction)[2][0]):
            slope, square = direction[0] @ b, direction[0] @ A @ direction[0]
            assert size[0] == pytest.approx(-slope / square, rel=1e-3)
            assert gain[0] == pytest.approx(slope**2 / square, rel=1e-3)


def test_a_gross_scale_is_seen_in_the_slopes() -> None:
    features = chain(0.05)
    x = np.array(features.coefficients)
    x[:, :, 1 + 2] /= 2.0
    (error,) = gross_scales(fitted(replace(features, coefficients=x)))
    assert (error.kind, error.dof) == ("scale", serial_tree(4).joint_names[2])
    assert error.size == pytest.approx(2.0, rel=0.1)
    assert not gross_scales(fitted(features))


def test_an_su_that_slips_is_no_gross_scale() -> None:
    """Its axis is another one later, and the mean of both is shorter than either."""
    features = chain(0.05)
    su = int(np.flatnonzero(serial_tree(4).su_joint == 2)[0])
    x = np.array(features.coefficients)
    x[5:, su] = x[5:, su] @ rotation_exp(np.array([[0.0, 2.2, 0.0]]))[0].T
    slipped = fitted(replace(features, coefficients=x))
    axes = slipped.cost.blocks.coefficients[:, su]
    assert np.abs(axes[5:] - axes[:5]).max() > 1.0
    assert not gross_scales(slipped)
