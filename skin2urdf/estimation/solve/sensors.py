"""Bias and shape of every SU for given placements: a linear problem of nine unknowns each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.estimation.problem.cost import Cost, Evaluation
from skin2urdf.estimation.problem.state import N_INTRINSIC, N_PLACEMENT, Free, State

_OF_AXIS = np.array([[0, 3, 8, 7], [1, 8, 4, 6], [2, 7, 6, 5]])
"""Coordinates among bias and shape by which axis i reads 1, x, y, z."""


def sensors_refitted(cost: Cost, state: State, free: Free) -> tuple[State, Evaluation]:
    """The state with the best bias and shape of every SU for its placements.

    Where gravity stands still in an SU, its tilt and its bias can hardly be told apart. The pairs
    that explain the readings form an arc, which a step in both would leave; solving for the
    sensors anew leads back to it.

    Args:
        cost: the cost.
        state: placements, and sensors to begin with.
        free: which coordinates may move.

    Returns:
        The state, and the cost there; never above that of the given state.
    """
    here = cost.at(state)
    moving = free.sus[:, N_PLACEMENT:]
    if not moving.any():
        return state, here
    deviations = cost.priors.deviations
    known = np.divide(1.0, deviations, out=np.zeros(N_INTRINSIC), where=deviations > 0)
    H = np.tile(np.diag(known**2), (cost.tree.n_sus, 1, 1))
    g = here.prior * known
    for part in here.groups:
        group = part.group
        Z = np.concatenate([group.W[..., :1], group.W @ part.Y], axis=-1)
        gram = np.swapaxes(Z, -1, -2) @ Z
        pull = np.swapaxes(Z, -1, -2) @ part.residual
        for axis, index in enumerate(_OF_AXIS):
            rows = (group.sus[:, None, None], index[:, None], index)
            weight = group.weight[:, :, axis]
            H[rows] += np.einsum("pu,puij->uij", weight**2, gram)
            g[group.sus[:, None], index] += np.einsum("pu,pui->ui", weight, pull[..., axis])
    H = np.where(moving[:, :, None] & moving[:, None], H, np.eye(N_INTRINSIC))
    x = np.linalg.solve(H, -np.where(moving, g, 0.0)[..., None])[..., 0]
    refitted = replace(state, bias=state.bias + x[:, :3], shape=state.shape + x[:, 3:])
    there = cost.with_sensors(here, refitted.bias, refitted.shape)
    return (refitted, there) if there.chi2 < here.chi2 else (state, here)
