"""Errors of the encoders, which all SUs beyond a joint feel at once.

What an encoder rounds away (features: ``position_sd`` and ``hidden``) and its noise (``white``)
disturb the features of every SU beyond it in the same way. The weights know how large these errors
are for each SU, and take those of different SUs as independent; this adds to the covariance what
they have in common.
With weights W, Jacobian J and noise of covariance S, the covariance of a weighted least-squares
estimate is ``C J^T W S W J C`` with ``C = (J^T W J)^-1``.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.blocks import FeatureBlocks
from skin2urdf.estimation.cost import Cost
from skin2urdf.estimation.covariance import ArrowCovariance
from skin2urdf.estimation.residuals import Residuals
from skin2urdf.estimation.state import N_SU, State

_RESTS = 0.9
"""Error at rest over a joint's largest from which it rests all the time: in patterns, it turns
round in many places."""
_THERE = 0.5
"""Distance from which two places are not the same, over the standard deviation of rounding."""


def with_shared_errors(covariance: ArrowCovariance, cost: Cost, state: State) -> ArrowCovariance:
    """A covariance with the correlation between SUs that the encoders' errors bring about.

    Args:
        covariance: the inverse of the weighted information.
        cost: the cost.
        state: where it was taken.
    """
    number = _numbers(cost.blocks)
    J = len(covariance.joint)
    if not J or number.max(initial=-1) < 0:
        return covariance
    here = cost.at(state)
    total, alone = np.zeros((number.max() + 1, J)), np.zeros((J, J))
    pulls = []
    for each in here.groups:
        rows = each.feature_jacobian()
        for i, u in enumerate(each.group.sus):
            which, scores = _scores(each, i, rows[:, i], number, cost.blocks)
            columns = each.group.columns[i]
            by_joint, by_su = np.split(scores, [-N_SU], axis=1)
            lean = _placed(covariance.lean[u], len(columns), 2 * (cost.n_logs - 1))
            pull = by_joint + by_su @ lean
            np.add.at(alone, (columns[:, None], columns), pull.T @ pull)
            np.add.at(total, (which[:, None], columns), pull)
            pulls.append((u, which, columns, lean, pull, by_su @ covariance.own[u]))
    joint = covariance.joint
    moved = total @ joint
    own = np.array(covariance.own)
    for u, which, columns, lean, pull, response in pulls:
        others = moved[which[:, None], columns] - pull @ joint[columns[:, None], columns]
        cross = lean @ others.T @ response
        again = _added_up(response, which)
        own[u] += cross + cross.T + again.T @ again - response.T @ response
    more = joint @ (total.T @ total - alone) @ joint
    return ArrowCovariance(joint + more, covariance.columns, covariance.lean, own)


def _added_up(rows: F64, which: Int) -> F64:
    """Rows (T, n) of the same error added up."""
    number, place = np.unique(which, return_inverse=True)
    out = np.zeros((len(number), rows.shape[1]))
    np.add.at(out, place, rows)
    return out


def _placed(lean: F64, n_columns: int, n_logs: int) -> F64:
    """How an SU follows its chain (15, C), without the padding between joints and logs."""
    C = lean.shape[1]
    return lean[:, np.r_[: n_columns - n_logs, C - n_logs : C]]


def _numbers(blocks: FeatureBlocks) -> Int:
    """Consecutive numbers of the errors that there are, -1 for the others.

    Returns:
        (P, 1 + 3 D, D): at [p, 0, e] the error of joint e at rest in pose p, at [p, 1 + d, e] what
        is hidden in step with the pattern of d, and behind these the noise in step with each of its
        two tones. What no SU feels both of does not count.
    """
    D = blocks.q.shape[1]
    together = np.zeros((D, D), dtype=bool)
    for chain, n in zip(blocks.chains.joint, blocks.chains.length, strict=True):
        together[np.ix_(chain[:n], chain[:n])] = True
    noisy = together & (blocks.white > 0)
    felt = np.concatenate(
        [
            blocks.position_sd[:, None] > 0,
            together & (blocks.hidden > 0),
            *(noisy & (blocks.energy[..., k, None] > 0) for k in range(2)),
        ],
        axis=1,
    )
    number = np.where(felt, felt.cumsum().reshape(felt.shape) - 1, -1)
    first = _first_there(blocks)
    number[:, 0] = np.where(felt[:, 0], number[first, 0, np.arange(D)], -1)
    return np.asarray(number)


def _first_there(blocks: FeatureBlocks) -> Int:
    """(P, D) the first pose in which a joint rests where it rests in a pose; else the pose.

    What an encoder rounds away is the same whenever the joint comes back to a place.
    """
    P, D = blocks.q.shape
    first = np.tile(np.arange(P)[:, None], D)
    sd = blocks.position_sd
    rests = (sd > 0) & (sd > _RESTS * sd.max(axis=0, initial=0.0))
    for joint in range(D):
        poses = np.flatnonzero(rests[:, joint])
        poses = poses[np.argsort(blocks.q[poses, joint], kind="stable")]
        apart = np.diff(blocks.q[poses, joint]) > _THERE * sd[poses[1:], joint]
        for place in np.split(poses, np.flatnonzero(apart) + 1):
            first[place, joint] = place.min(initial=P)
    return first


def _scores(
    here: Residuals, i: int, rows: F64, number: Int, blocks: FeatureBlocks
) -> tuple[Int, F64]:
    """How one SU's equations are pulled by one standard deviation of each encoder error.

    Args:
        here: residuals of a group of SUs.
        i: which of them.
        rows: (P, m, 3, C + 15) derivatives of its features, over the noise.
        number: (P, 1 + 3 D, D) numbers of the errors.
        blocks: all features.

    Returns:
        (T,) numbers of the errors that the SU feels, and (T, C + 15) gradients in its joint and own
        coordinates.
    """
    group, Y, W = here.group, here.Y[:, i], here.group.W[:, i]
    n, L, D = int(group.chains.length[i]), group.chains.joint.shape[1], blocks.q.shape[1]
    chain = group.chains.joint[i, :n]
    to_s, to_tau = slice(1, 1 + n), slice(1 + L, 1 + L + n)
    s, tau = Y[:, to_s], Y[:, to_tau]
    rows = rows * group.weight[:, i, None, :, None]
    information = np.swapaxes(W, -1, -2) @ W
    weighted = np.einsum("pnm,pmac->pnac", information, rows)
    pairs = np.s_[:, chain[:, None], chain]

    def in_step(omega2: F64, rows: F64, variance: F64) -> F64:
        """Errors of e in step with a motion of d that enters the equations by rows."""
        effect = s[:, None] - omega2[..., None, None] * tau[:, None]
        pulls = np.einsum("pdac,pdea->pdec", rows, effect)
        return np.asarray(pulls * np.sqrt(variance[pairs])[..., None])

    pull = np.zeros((len(Y), n, Y.shape[1]))
    longest = blocks.chains.joint.shape[1]
    pull[:, :, np.r_[0, to_s]] = blocks.pull[:, group.sus[i], :n, : 1 + n]
    pull[:, :, to_tau] = blocks.pull[:, group.sus[i], :n, 1 + longest : 1 + longest + n]
    at_rest = np.einsum("pem,pmac,pea->pec", pull, weighted, s, optimize=True)
    at_rest *= blocks.position_sd[:, chain, None]
    scores = [at_rest[:, None]]
    scores.append(in_step(blocks.omega2[:, chain], weighted[:, to_tau], blocks.hidden))
    # What the weights make of the energy of a pattern's position and acceleration.
    tones, energy = blocks.tones[:, chain], blocks.energy[:, chain]
    total = np.stack([energy.sum(axis=-1), (energy * tones**2).sum(axis=-1)])
    kept = np.diagonal(information, axis1=1, axis2=2)
    kept = np.stack([kept[:, to_s], kept[:, to_tau]]) / np.where(total > 0, total, np.inf)
    for k in range(2):
        by_s, by_tau = kept * np.sqrt(energy[..., k])
        by = by_s[..., None, None] * rows[:, to_s]
        by -= (tones[..., k] * by_tau)[..., None, None] * rows[:, to_tau]
        scores.append(in_step(tones[..., k], by, blocks.white))
    errors = np.r_[0, 1 + chain, 1 + D + chain, 1 + 2 * D + chain]
    which = number[:, errors[:, None], chain]
    every = np.concatenate(scores, axis=1)
    return which[which >= 0], every[which >= 0]
