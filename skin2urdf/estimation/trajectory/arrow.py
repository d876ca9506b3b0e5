"""Normal equations in arrow form, solved by eliminating every SU on its own (Schur complement)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.trajectory.records import Equations

NOTHING = 1e-9
"""Relative weight that holds directions without any information where they are."""


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Normal equations of which every SU is eliminated, over the free coordinates.

    Attributes:
        su_inverse: (U, n, n) inverse information of each SU's coordinates for known joints.
        lean: (U, n, J) how each SU follows the joint part.
        schur: (J, J) information of the joint part, whatever the SUs are.
        gradient: (J,) its gradient.
        own: (U, n) step of the SUs for joints that stay.
    """

    su_inverse: F64
    lean: F64
    schur: F64
    gradient: F64
    own: F64


def eliminated(
    equations: Equations,
    free_joint: Bool,
    free_su: Bool,
    damping: float = 0.0,
    nothing: float = NOTHING,
) -> Eliminated:
    """Eliminate every SU.

    Args:
        equations: the system.
        free_joint: (J,), and
        free_su: (U, n), the coordinates that may move.
        damping: share of each coordinate's own information that is added to it.
        nothing: share by which directions without any information are held.
    """
    both = free_su[:, :, None] & free_su[:, None, :]
    su = np.where(both, equations.su, 0.0)
    diagonal = np.einsum("uii->ui", su)
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    unit = su / size[:, :, None] / size[:, None, :]
    index = np.arange(su.shape[1])
    unit[:, index, index] = np.where(free_su, 1 + damping + nothing, 1.0)
    inverse = _inverse(unit, nothing) / size[:, :, None] / size[:, None, :]
    inverse = np.where(both, 0.5 * (inverse + np.swapaxes(inverse, 1, 2)), 0.0)
    mixed = np.where(free_su[:, :, None] & free_joint, equations.mixed, 0.0)
    lean = -inverse @ mixed
    H = np.where(free_joint[:, None] & free_joint, equations.joint, 0.0)
    index = np.arange(len(H))
    H[index, index] += damping * np.diag(H)
    schur = H + np.tensordot(mixed, lean, ((0, 1), (0, 1)))
    own = np.einsum("unm,um->un", inverse, equations.su_gradient)
    gradient = np.where(free_joint, equations.joint_gradient, 0.0)
    gradient += np.einsum("unj,un->j", lean, equations.su_gradient)
    return Eliminated(inverse, lean, schur, gradient, own)


def _inverse(unit: F64, nothing: float) -> F64:
    """(..., n, n) inverses of information matrices whose diagonals are 1."""
    try:
        return np.asarray(np.linalg.inv(unit))
    except np.linalg.LinAlgError:
        # Rounding has taken more from what hardly shows than what holds it.
        lam, V = np.linalg.eigh(unit)
        return np.asarray((V / np.maximum(lam, nothing)[..., None, :]) @ np.swapaxes(V, -1, -2))


def joint_inverse(schur: F64, free: Bool, nothing: float = NOTHING) -> F64:
    """(J, J) inverse of a Schur complement over its free coordinates."""
    diagonal = np.diag(schur)
    size = np.sqrt(np.where(free & (diagonal > 0), diagonal, 1.0))
    unit = np.where(free[:, None] & free, schur / size[:, None] / size, 0.0)
    index = np.arange(len(unit))
    unit[index, index] = np.where(free, np.maximum(np.diag(unit), 0.0) + nothing, 1.0)
    inverse = _inverse(unit, nothing) / size[:, None] / size
    return np.asarray(np.where(free[:, None] & free, 0.5 * (inverse + inverse.T), 0.0))


def newton_step(system: Eliminated, free_joint: Bool) -> tuple[F64, F64]:
    """(J,) and (U, n) step to the minimum of the quadratic model."""
    joint = joint_inverse(system.schur, free_joint) @ system.gradient
    return joint, system.own + np.einsum("unj,j->un", system.lean, joint)
