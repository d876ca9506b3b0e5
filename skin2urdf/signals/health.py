"""SUs whose readings can not be used at all: dead, frozen, out of range."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.faults import Fault

CHECK_SENSOR = "check its cable and its driver"

_PLAUSIBLE = (0.6, 1.4)
"""Static readings of a working sensor, in g."""
_SATURATED = 0.002
"""Share of samples at the ends of the range from which an SU counts as saturated."""


def unusable(name: str, readings: F64, still: Bool, valid: Bool, gravity: float) -> Fault | None:
    """Why an SU can not be used; None where nothing speaks against it.

    Args:
        name: the SU.
        readings: (N, 3) readings on the grid [m/s^2].
        still: (N,) True where the robot rests.
        valid: (N,) True where the stream is whole.
        gravity: magnitude of gravity [m/s^2].
    """
    if not valid.any():
        words = f"{name} has no samples while the joints were recorded, and is left out"
        return Fault("dead", name, words, CHECK_SENSOR)
    static = readings[still & valid]
    if not len(static):
        words = f"{name} has no samples while the robot rests, and is left out"
        return Fault("dead", name, words, CHECK_SENSOR)
    size = float(np.median(np.linalg.norm(static, axis=1))) / gravity
    if size < 1e-3:
        words = f"{name} reads zero all the time and is left out"
        return Fault("dead", name, words, CHECK_SENSOR)
    if not _PLAUSIBLE[0] < size < _PLAUSIBLE[1]:
        words = f"{name} reads {size:.2g} g at rest and is left out"
        return Fault("wrong unit", name, words, "check its unit and its scale")
    return None


def frozen(raw: list[F64]) -> Bool:
    """(U,) True for SUs that repeat one value all the time, while others show noise.

    Args:
        raw: U arrays (M, 3) of raw samples.
    """
    constant = np.array([len(x) > 0 and bool((x == x[:1]).all()) for x in raw], dtype=bool)
    return constant if not constant.all() and _noisy(raw, constant) else np.zeros_like(constant)


def _noisy(raw: list[F64], constant: Bool) -> bool:
    """Whether every other SU's samples differ from one to the next most of the time."""
    shares = [
        float((np.diff(x, axis=0) != 0).any(axis=1).mean())
        for x, c in zip(raw, constant, strict=True)
        if not c and len(x) > 1
    ]
    return bool(shares) and min(shares) > 0.5


def saturated(raw: F64) -> float:
    """Share of samples (M, 3) at the ends of the sensor's range, 0 where none stands out.

    A clipped signal stays at its extreme for several samples in a row, again and again.
    """
    if len(raw) < 100:
        return 0.0
    share = 0.0
    for column in raw.T:
        for end in (column.min(), column.max()):
            at = column == end
            runs = at[1:] & at[:-1]
            varied = len(np.unique(column[:: max(1, len(column) // 2000)])) > 50
            if varied and runs.sum() > 0.5 * at.sum():
                share = max(share, float(at.mean()))
    return share if share > _SATURATED else 0.0
