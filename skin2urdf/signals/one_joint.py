"""The clock of an SU that one joint alone moves, on a rail or beyond a vertical axis.

Gravity tells it nothing, or what it tells is little beside that of SUs farther out; its readings
are those of one joint all the same, exactly: a constant, the joint's sine and cosine, acceleration
and squared speed. At the right lag these leave noise, which is as different from one sample to the
next as ever; an SU that other joints move as well is left something that lasts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.signals.expansion import Expansion, best_line

_WHITE = 0.5
"""Mean square of what changes from one sample to the next, over that of white noise, from which
what is left is noise: half way between noise and what lasts."""


def searched(
    readings: F64,
    valid: Bool,
    expansions: Sequence[Expansion],
    rate: float,
    reach: float,
    steep: float,
) -> tuple[Expansion, float, float] | None:
    """The one joint whose motion leaves noise of an SU, and its offset [s] and drift.

    Args:
        readings: (n, 3) means [m/s^2].
        valid: (n,) where they are whole.
        expansions: of each joint by itself.
        rate: samples per second [Hz].
        reach: largest offset [s].
        steep: largest drift.

    Returns:
        None where there is none.
    """
    lines = [(e, best_line(readings, valid, e, rate, reach, steep)) for e in expansions]
    found = [(e, line) for e, line in lines if line is not None]
    if not found:
        return None
    joint, line = min(found, key=lambda each: each[1].left)
    if not _leaves_noise(readings, valid, joint, rate, line.offset, line.drift):
        return None
    return joint, line.offset, line.drift


def _leaves_noise(
    readings: F64, valid: Bool, joint: Expansion, rate: float, offset: float, drift: float
) -> bool:
    """Whether what a joint leaves of the readings at a lag is noise."""
    n = len(readings)
    terms = joint.terms(np.inf)
    if terms is None:
        return False
    lag = np.rint((offset + drift * (np.arange(n) - n / 2) / rate) * rate).astype(int)
    at = np.arange(n) - lag
    use = valid & (at >= 0) & (at < n)
    used = terms[at[use]]
    left = readings[use] - used @ np.linalg.lstsq(used, readings[use], rcond=None)[0]
    steps = np.diff(left, axis=0)[np.diff(np.flatnonzero(use)) == 1]
    return bool((steps**2).mean() > 2 * _WHITE * (left**2).mean())
