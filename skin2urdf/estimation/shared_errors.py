"""Errors of the encoders, which all SUs beyond a joint feel at once.

What an encoder rounds away (features: ``position_sd`` and ``hidden``) disturbs the features of
every SU beyond it in the same way. The weights know how large these errors are for each SU, and
take those of different SUs as independent; this adds to the covariance what they have in common.
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
        jacobian = each.jacobian()
        for i, u in enumerate(each.group.sus):
            which, scores = _scores(each, i, jacobian[i], number, cost.blocks)
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
        own[u] += cross + cross.T
    more = joint @ (total.T @ total - alone) @ joint
    return ArrowCovariance(joint + more, covariance.columns, covariance.lean, own)


def _placed(lean: F64, n_columns: int, n_logs: int) -> F64:
    """How an SU follows its chain (15, C), without the padding between joints and logs."""
    C = lean.shape[1]
    return lean[:, np.r_[: n_columns - n_logs, C - n_logs : C]]


def _numbers(blocks: FeatureBlocks) -> Int:
    """Consecutive numbers of the errors that there are, -1 for the others.

    Returns:
        (P, 1 + D, D): at [p, 0, e] the error of joint e at rest in pose p, at [p, 1 + d, e] that
        in step with the pattern of d. What no SU feels both of does not count.
    """
    D = blocks.q.shape[1]
    together = np.zeros((D, D), dtype=bool)
    for chain, n in zip(blocks.chains.joint, blocks.chains.length, strict=True):
        together[np.ix_(chain[:n], chain[:n])] = True
    in_step = together & (blocks.hidden > 0)
    felt = np.concatenate([blocks.position_sd[:, None] > 0, in_step], axis=1)
    return np.asarray(np.where(felt, felt.cumsum().reshape(felt.shape) - 1, -1))


def _scores(
    here: Residuals, i: int, jacobian: F64, number: Int, blocks: FeatureBlocks
) -> tuple[Int, F64]:
    """How one SU's equations are pulled by one standard deviation of each encoder error.

    Args:
        here: residuals of a group of SUs.
        i: which of them.
        jacobian: (P m 3, C + 15) derivatives of its residuals.
        number: (P, 1 + D, D) numbers of the errors.
        blocks: all features.

    Returns:
        (T,) numbers of the errors that the SU feels, and (T, C + 15) gradients in its joint and own
        coordinates.
    """
    group, Y = here.group, here.Y[:, i]
    P, m = Y.shape[:2]
    n, L = int(group.chains.length[i]), group.chains.joint.shape[1]
    chain = group.chains.joint[i, :n]
    rows = jacobian.reshape(P, m, 3, -1)
    by_row = np.einsum("pkm,pkac->pmac", group.W[:, i], rows) * group.weight[:, i, None, :, None]
    s, tau = Y[:, 1 : 1 + n], Y[:, 1 + L : 1 + L + n]
    at_rest = np.einsum("pac,pea->pec", by_row[:, 0], s)
    at_rest *= blocks.position_sd[:, chain, None]
    effect = s[:, None] - blocks.omega2[:, chain, None, None] * tau[:, None]
    in_step = np.einsum("pdac,pdea->pdec", by_row[:, 1 + L : 1 + L + n], effect)
    in_step *= np.sqrt(blocks.hidden[:, chain[:, None], chain])[..., None]
    which = number[:, np.r_[0, 1 + chain][:, None], chain]
    scores = np.concatenate([at_rest[:, None], in_step], axis=1)
    return which[which >= 0], scores[which >= 0]
