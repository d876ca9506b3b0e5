"""Errors of the encoders, which all SUs beyond a joint feel at once.

What an encoder rounds away (features: ``position_sd`` and ``hidden``) and its noise (``white``)
disturb the features of every SU beyond it in the same way. The weights know how large these errors
are for each SU, and take those of different SUs as independent; this adds to the covariance what
they have in common.
With weights W, Jacobian J and noise of covariance S, the covariance of a weighted least-squares
estimate is ``C J^T W S W J C`` with ``C = (J^T W J)^-1``.

White noise n of encoder e adds ``s_e n + tau_e n2`` to the readings, n2 its second derivative. The
regressors X meet it as ``X^T n``, of covariance ``X^T X`` per unit: the same for all SUs, and
correlated where the patterns of several joints are alike. The derivative moves over to the
regressors, where that of an acceleration, of a pattern of two tones of squared frequencies a and
b, is ``-(a + b)`` times the acceleration and ``-a b`` times the position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.blocks import FeatureBlocks
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.problem.residuals import Residuals
from skin2urdf.estimation.problem.state import N_SU, State
from skin2urdf.estimation.uncertainty.covariance import ArrowCovariance

_RIDGE = 1e-9
"""Added to correlations of patterns, which may be those of one motion."""
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
    errors = _errors(cost.blocks)
    J = len(covariance.joint)
    if not J or not errors.count:
        return covariance
    here = cost.at(state)
    total, alone = np.zeros((errors.count, J)), np.zeros((J, J))
    pulls = []
    for each in here.groups:
        rows = each.feature_jacobian()
        for i, u in enumerate(each.group.sus):
            which, scores = _scores(each, i, rows[:, i], errors, cost.blocks)
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
    """(E, n) rows (T, n) added up by the E different errors, numbered by which (T,)."""
    number, place = np.unique(which, return_inverse=True)
    out = np.zeros((len(number), rows.shape[1]))
    np.add.at(out, place, rows)
    return out


def _placed(lean: F64, n_columns: int, n_logs: int) -> F64:
    """How an SU follows its chain (15, C), without the padding between joints and logs."""
    C = lean.shape[1]
    return lean[:, np.r_[: n_columns - n_logs, C - n_logs : C]]


@dataclass(frozen=True, eq=False)
class _Noise:
    """White noise of one joint's encoder, as the patterns of joints on a chain with it meet it.

    Attributes:
        joints: (T,) these joints.
        factor: (P, 2 T, 2 T) root of the products of their positions and accelerations.
        first: (P,) number of the first of its 2 T errors in each pose, -1 where there are none.
    """

    joints: Int
    factor: F64
    first: Int


@dataclass(frozen=True, eq=False)
class _Errors:
    """Consecutive numbers of independent errors.

    Attributes:
        number: (P, 1 + D, D) at [p, 0, e] of the error of joint e at rest in pose p, at
            [p, 1 + d, e] of what is hidden in step with the pattern of d; -1 where none is felt.
        noises: of each joint's encoder.
        count: how many there are.
    """

    number: Int
    noises: Sequence[_Noise]
    count: int


def _errors(blocks: FeatureBlocks) -> _Errors:
    """The errors that there are."""
    P, D = blocks.q.shape
    together = np.zeros((D, D), dtype=bool)
    for chain, n in zip(blocks.chains.joint, blocks.chains.length, strict=True):
        together[np.ix_(chain[:n], chain[:n])] = True
    felt = np.concatenate(
        [blocks.encoders.position_sd[:, None] > 0, together & (blocks.encoders.hidden > 0)], axis=1
    )
    number = np.where(felt, felt.cumsum().reshape(felt.shape) - 1, -1)
    first = _first_there(blocks)
    number[:, 0] = np.where(felt[:, 0], number[first, 0, np.arange(D)], -1)
    count, noises = int(felt.sum()), []
    moved = np.diagonal(blocks.encoders.products, axis1=1, axis2=2)[:, :D] > 0
    for e in range(D):
        joints = np.flatnonzero(together[e])
        noisy = ((blocks.encoders.white[:, joints, e] > 0) & moved[:, joints]).any(axis=1)
        width = 2 * len(joints)
        begin = np.where(noisy, count + width * (noisy.cumsum() - 1), -1)
        count += width * int(noisy.sum())
        both = np.concatenate([joints, D + joints])
        factor = np.zeros((P, width, width))
        factor[noisy] = _root(blocks.encoders.products[np.ix_(noisy, both, both)])
        noises.append(_Noise(joints, factor, begin))
    return _Errors(number, noises, count)


def _root(products: F64) -> F64:
    """(P, n, n) roots of positive semidefinite products."""
    size = np.sqrt(np.diagonal(products, axis1=1, axis2=2))
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    alike = products * inverse[:, :, None] * inverse[:, None, :]
    ridge = _RIDGE * np.eye(products.shape[1])
    return np.asarray(np.linalg.cholesky(alike + ridge) * size[..., None])


def _first_there(blocks: FeatureBlocks) -> Int:
    """(P, D) the first pose in which a joint rests where it rests in a pose; else the pose.

    What an encoder rounds away is the same whenever the joint comes back to a place.
    """
    P, D = blocks.q.shape
    first = np.tile(np.arange(P)[:, None], D)
    sd = blocks.encoders.position_sd
    rests = (sd > 0) & (sd > _RESTS * sd.max(axis=0, initial=0.0))
    for joint in range(D):
        poses = np.flatnonzero(rests[:, joint])
        poses = poses[np.argsort(blocks.q[poses, joint], kind="stable")]
        apart = np.diff(blocks.q[poses, joint]) > _THERE * sd[poses[1:], joint]
        for place in np.split(poses, np.flatnonzero(apart) + 1):
            first[place, joint] = place.min(initial=P)
    return first


def _scores(
    here: Residuals, i: int, rows: F64, errors: _Errors, blocks: FeatureBlocks
) -> tuple[Int, F64]:
    """How one SU's equations are pulled by one standard deviation of each encoder error.

    Args:
        here: residuals of a group of SUs.
        i: which of them.
        rows: (P, m, 3, C + 15) derivatives of its features, over the noise.
        errors: all errors.
        blocks: all features.

    Returns:
        (T,) numbers of the errors that the SU feels, and (T, C + 15) gradients in its joint and own
        coordinates.
    """
    group, Y, W = here.group, here.Y[:, i], here.group.W[:, i]
    n, L = int(group.chains.length[i]), group.chains.joint.shape[1]
    chain = group.chains.joint[i, :n]
    to_s, to_tau = slice(1, 1 + n), slice(1 + L, 1 + L + n)
    s, tau = Y[:, to_s], Y[:, to_tau]
    rows = rows * group.weight[:, i, None, :, None]
    information = np.swapaxes(W, -1, -2) @ W
    weighted = np.einsum("pnm,pmac->pnac", information, rows)
    pull = np.zeros((len(Y), n, Y.shape[1]))
    longest = blocks.chains.joint.shape[1]
    pull[:, :, np.r_[0, to_s]] = blocks.pull[:, group.sus[i], :n, : 1 + n]
    pull[:, :, to_tau] = blocks.pull[:, group.sus[i], :n, 1 + longest : 1 + longest + n]
    at_rest = np.einsum("pem,pmac,pea->pec", pull, weighted, s, optimize=True)
    at_rest *= blocks.encoders.position_sd[:, chain, None]
    effect = s[:, None] - blocks.encoders.omega2[:, chain, None, None] * tau[:, None]
    in_step = np.einsum("pdac,pdea->pdec", weighted[:, to_tau], effect)
    in_step *= np.sqrt(blocks.encoders.hidden[:, chain[:, None], chain])[..., None]
    which = errors.number[:, np.r_[0, 1 + chain][:, None], chain]
    scores = np.concatenate([at_rest[:, None], in_step], axis=1)
    kept = np.diagonal(information, axis1=1, axis2=2)
    by_s = kept[:, to_s, None, None] * rows[:, to_s]
    by_tau = kept[:, to_tau, None, None] * rows[:, to_tau]
    numbers, noise = _noise_scores((by_s, by_tau), (s, tau), chain, errors, blocks)
    return (
        np.concatenate([which[which >= 0], numbers]),
        np.concatenate([scores[which >= 0], noise]),
    )


def _noise_scores(
    by: tuple[F64, F64],
    effects: tuple[F64, F64],
    chain: Int,
    errors: _Errors,
    blocks: FeatureBlocks,
) -> tuple[Int, F64]:
    """How white noise of its joints' encoders pulls one SU's equations.

    Args:
        by: (P, n, 3, C + 15) information on its s and tau, times their derivatives.
        effects: (P, n, 3) s [m/s^2/rad] and tau [m/rad], in the SU's frame.
        chain: (n,) its joints.
        errors: all errors.
        blocks: all features.

    Returns:
        (T,) numbers of the errors, and (T, C + 15) gradients, per standard deviation of each.
    """
    D = blocks.q.shape[1]
    size = np.diagonal(blocks.encoders.products, axis1=1, axis2=2)[:, np.r_[chain, D + chain]]
    # What the weights make of the products of a pattern's positions and accelerations.
    unit = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    by_s, by_tau = (
        x * u[..., None, None] for x, u in zip(by, np.split(unit, 2, axis=1), strict=True)
    )
    a, b = np.moveaxis(blocks.encoders.tones[:, chain], -1, 0)[..., None]
    numbers = [np.zeros(0, dtype=np.int64)]
    scores = [np.zeros((0, by_s.shape[-1]))]
    for k, e in enumerate(chain):
        noise, width = errors.noises[e], len(errors.noises[e].joints)
        p = np.flatnonzero(noise.first >= 0)
        s_by_s, tau_by_s, s_by_tau, tau_by_tau = (
            np.einsum("pdac,pa->pdc", x[p], effect[p, k])
            for x in (by_s, by_tau)
            for effect in effects
        )
        position = s_by_s - (a * b)[p] * tau_by_tau
        acceleration = tau_by_s + s_by_tau - (a + b)[p] * tau_by_tau
        met = np.concatenate([position, acceleration], axis=1)
        met *= np.tile(np.sqrt(blocks.encoders.white[p][:, chain, e]), 2)[..., None]
        at = np.searchsorted(noise.joints, chain)
        root = noise.factor[p][:, np.r_[at, width + at]]
        numbers.append((noise.first[p, None] + np.arange(2 * width)).ravel())
        scores.append((np.swapaxes(root, 1, 2) @ met).reshape(-1, met.shape[-1]))
    return np.concatenate(numbers), np.concatenate(scores)
