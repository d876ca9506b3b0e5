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
from skin2urdf.estimation.cost import Cost, Evaluation
from skin2urdf.estimation.covariance import ArrowCovariance
from skin2urdf.estimation.state import State


def with_shared_errors(covariance: ArrowCovariance, cost: Cost, state: State) -> ArrowCovariance:
    """A covariance with the correlation between SUs that the encoders' errors bring about.

    Args:
        covariance: the inverse of the weighted information.
        cost: the cost.
        state: where it was taken.
    """
    D, P = cost.tree.n_joints, len(cost.blocks.q)
    n_latent = P * D * (1 + D)
    J = len(covariance.joint)
    if not n_latent or not J:
        return covariance
    here = cost.at(state)
    joint_rows, su_rows = here.jacobian()
    total, alone = np.zeros((n_latent, J)), np.zeros((J, J))
    pulls = []
    for u, lean in enumerate(covariance.lean):
        which, scores = _scores(here, u, joint_rows[u], su_rows[u])
        pull = np.zeros((len(which), J))
        C = lean.shape[1]
        np.add.at(pull.T, covariance.columns[u], (scores[:, :C] + scores[:, C:] @ lean).T)
        alone += pull.T @ pull
        np.add.at(total, which, pull)
        pulls.append((which, pull, scores[:, C:] @ covariance.own[u]))
    joint = covariance.joint
    moved = total @ joint
    own = np.array(covariance.own)
    for u, (which, pull, response) in enumerate(pulls):
        others = (moved[which] - pull @ joint)[:, covariance.columns[u]]
        cross = covariance.lean[u] @ others.T @ response
        own[u] += cross + cross.T
    more = joint @ (total.T @ total - alone) @ joint
    return ArrowCovariance(joint + more, covariance.columns, covariance.lean, own)


def _scores(here: Evaluation, u: int, joint_rows: F64, su_rows: F64) -> tuple[Int, F64]:
    """How one SU's equations are pulled by one standard deviation of each encoder error.

    Returns:
        (T,) which errors they are (pose by pose, those at rest before those in step with the
        pattern of each DoF), and (T, C + 15) gradients in the SU's joint and own coordinates.
    """
    blocks = here.cost.blocks
    P, D = len(blocks.q), here.cost.tree.n_joints
    n, L = int(blocks.chains.length[u]), blocks.chains.joint.shape[1]
    chain = blocks.chains.joint[u, :n]
    m = blocks.chains.n_rows
    rows = np.concatenate([joint_rows, su_rows[: P * m * 3]], axis=1).reshape(P, m, 3, -1)
    by_row = np.einsum("pkm,pkac->pmac", blocks.W[:, u], rows) / blocks.noise[:, u, None, :, None]
    Y = here.kin.features()[:, u]
    s, tau = Y[:, 1 : 1 + n], Y[:, 1 + L : 1 + L + n]
    at_rest = np.einsum("pac,pea->pec", by_row[:, 0], s)
    at_rest *= blocks.position_sd[:, chain, None]
    effect = s[:, None] - blocks.omega2[:, chain, None, None] * tau[:, None]
    in_step = np.einsum("pdac,pdea->pdec", by_row[:, 1 + L : 1 + L + n], effect)
    in_step *= np.sqrt(blocks.hidden[:, chain[:, None], chain])[..., None]
    base = (np.arange(P) * D * (1 + D))[:, None]
    which = [(base + chain).ravel()]
    which.append((base[..., None] + D + chain[:, None] * D + chain).ravel())
    columns = rows.shape[-1]
    return np.concatenate(which), np.concatenate(
        [at_rest.reshape(-1, columns), in_step.reshape(-1, columns)]
    )
