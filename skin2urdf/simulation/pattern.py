"""Shapes of motion: the smooth step of a move and the windowed pattern of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from skin2urdf.arrays import F64

Tones = Sequence[tuple[float, float]]
"""(frequency f [Hz], peak acceleration 2 pi f A [rad/s^2 or m/s^2]) of each tone of a pattern."""

PEAK_SPEED = 2.1875
"""Peak speed of a move by `smooth_step` over distance / duration."""


def smooth_step(x: F64) -> F64:
    """Step 35 x^4 - 84 x^5 + 70 x^6 - 20 x^7 from 0 at x = 0 to 1 at x = 1, constant outside.

    The lowest polynomial with continuous jerk, as the paper advises for its patterns: a
    specific force without kinks is one that samples can represent.
    """
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**4 * (35.0 + x * (-84.0 + x * (70.0 - 20.0 * x))))


def smooth_rise(x: F64) -> F64:
    """Integral of `smooth_step` from 0: 0 up to x = 0, x - 1/2 from x = 1 on.

    What has this for its position has a speed that rises from 0 to 1 without kinks.
    """
    inside = np.clip(x, 0.0, 1.0)
    rise = inside**5 * (7.0 + inside * (-14.0 + inside * (10.0 - 2.5 * inside)))
    return np.asarray(rise + np.maximum(x - 1.0, 0.0))


def window(time: F64, duration: float, ramp: float) -> F64:
    """The window F(t) of paper eq. 13: 0 at both ends, 1 between the flanks, C3 everywhere.

    Args:
        time: (N,) times [s].
        duration: length of the window [s].
        ramp: length of either flank [s].
    """
    return smooth_step(time / ramp) * smooth_step((duration - time) / ramp)


def windowed_pattern(time: F64, duration: float, ramp: float, tones: Tones) -> F64:
    """Pattern of paper eq. 10 and 13, summed over its tones.

    Args:
        time: (N,) times since the pattern's start [s].
        duration: length of the pattern [s].
        ramp: length of either flank of the window [s].
        tones: what the pattern is made of.

    Returns:
        (N,) offsets from the pose, 0 at both ends and never of the sign opposite to the tones'
        acceleration [rad or m].
    """
    total = np.zeros_like(time)
    for frequency, acceleration in tones:
        omega = 2 * pi * frequency
        total += acceleration / omega**2 * (1.0 - np.cos(omega * time))
    return total * window(time, duration, ramp)


def swing(tones: Tones) -> float:
    """Largest offset that a pattern of these tones can reach [rad or m]."""
    return sum(2.0 * abs(a) / (2 * pi * f) ** 2 for f, a in tones)


def distinct_time(n: int, band: tuple[float, float]) -> float:
    """Time over which the tones of :func:`tone_pairs` are linearly independent [s].

    Cosines that are spaced by f are independent over a time of 1 / (2 f) or more: the sampling
    theorem, with time and frequency exchanged. In less, some of them are hardly more than sums of
    others: over 0.4 / f, variances of regression coefficients are thousands of times as large for
    30 DoFs, and many millions of times for 60; in more there is nothing to be gained. A fifth is
    added for what the flanks of the pattern's window take.

    Args:
        n: number of DoFs.
        band: lowest and highest frequency [Hz].
    """
    spacing = (band[1] - band[0]) / (2 * n - 1)
    return 1.2 * 0.5 / spacing


def tone_pairs(n: int, band: tuple[float, float], rng: np.random.Generator) -> F64:
    """Two frequencies for each of n DoFs that move at once, all of them different.

    A pure tone makes a DoF's position and acceleration proportional, which leaves the turning of
    gravity and the lever arm inseparable; a low and a high tone tell them apart.

    Args:
        n: number of DoFs.
        band: lowest and highest frequency [Hz].
        rng: decides which DoF gets which frequencies.

    Returns:
        (n, 2) low and high frequency of each DoF [Hz].
    """
    grid = np.linspace(*band, 2 * n)
    return np.column_stack([rng.permutation(grid[:n]), rng.permutation(grid[n:])])
