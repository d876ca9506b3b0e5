"""How well a fit knows what is each SU's own: front end, clock, drift, gyroscope."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.records import Equations

_NOTHING = 1e-10
"""Eigenvalue of information, over the largest once all coordinates have unit information, that is
rounding: what lies in such a direction is not observable, and counts as known here."""


def su_covariances(equations: Equations) -> F64:
    """Covariance of the coordinates of each SU, whatever the joints are.

    Directions that no reading tells are left out: they are part of placements, whose observability
    is judged elsewhere, and do not disturb the other coordinates.

    Args:
        equations: of a fit, J joint coordinates and n of each of U SUs.

    Returns:
        (U, n, n) covariances.
    """
    own, gain, joint = _parts(equations)
    return np.asarray(own + gain @ joint @ np.swapaxes(gain, -1, -2))


def change_covariance(equations: Equations, first: int, second: int) -> F64:
    """(n, n) covariance of the difference of two SUs' coordinates, whatever the joints are.

    What joints do to both alike is no part of it. As above, what no reading tells is left out.

    Args:
        equations: of a fit.
        first: number of one SU.
        second: number of the other one.
    """
    own, gain, joint = _parts(equations)
    apart = gain[second] - gain[first]
    return np.asarray(own[first] + own[second] + apart @ joint @ apart.T)


def _parts(equations: Equations) -> tuple[F64, F64, F64]:
    """Covariance of each SU for known joints, how it goes with these, and theirs."""
    own = _inverse(equations.su)
    gain = own @ equations.mixed
    left = equations.joint - np.tensordot(equations.mixed, gain, ((0, 1), (0, 1)))
    return own, gain, _inverse(left)


def _inverse(information: F64) -> F64:
    """Inverses of (..., n, n) on what they tell."""
    diagonal = np.diagonal(information, axis1=-2, axis2=-1)
    scale = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    unit = scale[..., :, None] * information * scale[..., None, :]
    inverse = np.linalg.pinv(unit, rcond=_NOTHING, hermitian=True)
    return np.asarray(scale[..., :, None] * inverse * scale[..., None, :])
