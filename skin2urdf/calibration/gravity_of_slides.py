"""Gravity's size by joints that slide.

A slide is felt in units of gravity and counted in metres. Where gravity is of another size than was
assumed, features, which take it as given, would have its encoder wrong by as much.
"""

from __future__ import annotations

from dataclasses import replace

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import BAD_MISFIT
from skin2urdf.calibration.rounds import Solution
from skin2urdf.calibration.samples import fit_samples
from skin2urdf.calibration.settings import CalibrationSettings

_MATTERS = 1e-3
"""Part of gravity by which another size matters: scale errors below are sought in no encoder."""
_BELIEVED = 3.0
"""Standard deviations of gravity's size beyond which the encoder is wrong rather than gravity."""


def with_gravity_of_slides(first: Solution | None, clock: Clock) -> CalibrationSettings | None:
    """Choices with the gravity that all samples show; None where it is as it was assumed.

    Args:
        first: the first estimate, if there is one.
        clock: runs the stage.
    """
    if first is None or not first.found.tree.prismatic.any():
        return None
    settings = first.logs.settings
    if settings.motion != "all" or settings.gravity_deviation == 0:
        return None
    along = clock.run("all samples", lambda tell: fit_samples(first, tell, look_further=False))
    if along is None or not along.misfit <= BAD_MISFIT:
        return None
    assumed, size = settings.estimation.priors.gravity, along.fitted.state.gravity
    off = abs(size - assumed)
    if not _MATTERS * assumed < off < _BELIEVED * settings.gravity_deviation:
        return None
    priors = replace(settings.estimation.priors, gravity=size)
    return replace(settings, estimation=replace(settings.estimation, priors=priors))
