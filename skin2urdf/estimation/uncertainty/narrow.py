"""Sensors that are worse than what was said of them: a likely cause where nothing fits."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.geometry.units import MILLI_G

_BEYOND = 3.0
"""Deviations, rms over all SUs, beyond which what was said does not hold. The rms over the axes of
even two SUs is above it in less than 1 of 10^6 productions."""
_LEAST = MILLI_G
"""Error that the best accelerometers have all the same [m/s^2]."""


def narrow_priors(found: Estimate) -> tuple[str, ...]:
    """What was said of the sensors and does not hold, each with what it looks like instead.

    Estimated biases and scales are held against the deviations that were given. Where an error was
    denied altogether, so that none was estimated, the magnitude of the readings at rest shows it:
    it is gravity's, whatever the robot is. Where most come out worse than any sensor is, it is the
    robot that is wrong, and nothing is known of them.

    Args:
        found: an estimate, however bad.
    """
    told, state = found.given, found.state
    moved = found.tree.su_joint >= 0  # an SU on the base may lean on its prior alone
    on = moved & are_plausible(state)
    if 2 * on.sum() < moved.sum():
        return ()
    estimated = _estimated(found)
    words = []
    if estimated[:3].any() and told.bias > 0:
        size = _rms(state.bias[on])
        if size > _BEYOND * told.bias:
            words.append(
                f"biases come out at {size / MILLI_G:.0f} mg rms, where {told.bias / MILLI_G:.2g} "
                "mg were given (--bias)"
            )
    for name, option, columns, deviation in (
        ("scale", "--scale", slice(0, 3), told.scale),
        ("cross-axis", "--cross", slice(3, 6), told.cross),
    ):
        size = _rms(state.shape[on, columns])
        if estimated[3:][columns].any() and deviation > 0 and size > _BEYOND * deviation:
            words.append(
                f"{name} errors come out at {size:.2g} rms, where {deviation:.2g} was given "
                f"({option})"
            )
    if not estimated[:6].all():
        size, allowed = _off_gravity(found), _allowed(found)
        if size > _BEYOND * allowed:
            words.append(
                f"the readings at rest differ from gravity by {size / MILLI_G:.0f} mg rms, where "
                f"--bias, --scale or --no-intrinsics allow for {allowed / MILLI_G:.0f} mg"
            )
    return tuple(words)


def _estimated(found: Estimate) -> Bool:
    """(9,) which of bias, scale and cross-axis terms were estimated."""
    return np.asarray(found.free.sus[:, 6:].any(axis=0))


def _off_gravity(found: Estimate) -> float:
    """How far the magnitudes of readings at rest are from gravity's, rms [m/s^2]."""
    blocks = found.cost.blocks
    size = np.linalg.norm(blocks.coefficients[:, :, 0], axis=-1)
    heard = np.isfinite(blocks.noise).all(axis=-1) & np.isfinite(blocks.variance[:, :, 0])
    return _rms((size - found.given.gravity)[heard])


def _allowed(found: Estimate) -> float:
    """How far they may be by what was said, rms [m/s^2]."""
    told, free = found.given, _estimated(found)
    parts = told.bias * free[0], told.scale * told.gravity * free[3], _LEAST
    return float(np.linalg.norm(parts))


def _rms(values: F64) -> float:
    """Root mean square; 0 of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
