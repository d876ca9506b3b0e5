"""Fit when the samples of a regular sensor were taken to the noisy times they were stamped with.

A sensor samples regularly, its driver stamps when a sample arrives. Stamp against message number
is then a line with noise on it, bent by clock drift and interrupted by lost messages and pauses.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.recording.numbering import Numbering, median_of, number_messages

# A line is fitted to every stretch of this many samples and seconds, whichever is longer: long
# enough to average the noise of stamps, short enough to follow the drift of a clock.
STRETCH_SAMPLES = 512
STRETCH_SECONDS = 2.0
MIN_SAMPLES = 16
REWEIGHTINGS = 4
# A fit that stays this far [periods] from the stamps for so many samples has miscounted.
ASTRAY = 0.25
ASTRAY_SAMPLES = 64


def regular_times(stamp: F64) -> F64 | None:
    """Fit regular sampling to stamps.

    Args:
        stamp: (N,) stamps in the order of arrival [s].

    Returns:
        (N,) strictly increasing fitted times within each uninterrupted piece [s], or None where
        the stamps follow no rate.
    """
    if stamp.size < MIN_SAMPLES:
        return None
    period, noise = _rate(stamp)
    if not period > 0.0:
        return None
    plain = Numbering(np.arange(stamp.size), np.zeros(1, np.int64))
    fits = [_fit(stamp, plain, period)]
    numbering = number_messages(stamp, period, noise)
    if numbering is not None:
        fits.append(_fit(stamp, numbering, period))
    sound = [fit for fit in fits if fit is not None and not _astray(stamp, fit, period, noise)]
    return min(sound, key=lambda fit: _misfit(stamp, fit), default=None)


def _rate(stamp: F64) -> tuple[float, float]:
    """Estimate period and noise of stamps from how far they are apart some messages later.

    A long lag averages noise and bursts, a short one is rarely broken by a lost message: the one
    with the least spread counts, the longer one where they are much alike.

    Args:
        stamp: (N,) stamps [s].

    Returns:
        Sampling period [s] and scale of the noise of one stamp [s].
    """
    period = noise = np.inf
    for lag in (64, 32, 16, 8):
        if 2 * lag > stamp.size:
            continue
        some = np.arange(0, stamp.size - lag, stamp.size // 4096 | 1)
        apart = stamp[some + lag] - stamp[some]
        typical = median_of(apart)
        spread = 1.4826 * median_of(np.abs(apart - typical)) / np.sqrt(2.0)
        if spread < 0.7 * noise:
            period, noise = typical / lag, spread
    return period, noise


def _fit(stamp: F64, numbering: Numbering, period: float) -> F64 | None:
    """Fit a bent line to each piece; short pieces keep their stamps."""
    fitted = stamp.copy()
    bounds = [*numbering.pieces.tolist(), stamp.size]
    for start, stop in pairwise(bounds):
        if stop - start < MIN_SAMPLES:
            continue
        number = numbering.number[start:stop].astype(np.float64)
        line = _bent_line(number - number[0], stamp[start:stop], period)
        if line is None:
            return None
        fitted[start:stop] = line
    return fitted


def _bent_line(number: F64, stamp: F64, period: float) -> F64 | None:
    """Fit one line per stretch by robust least squares and join the lines into one bent line.

    Args:
        number: (N,) message numbers.
        stamp: (N,) stamps [s].
        period: sampling period [s].

    Returns:
        (N,) fitted times [s], or None where the bent line does not rise throughout.
    """
    stretch = max(STRETCH_SAMPLES, int(STRETCH_SECONDS / period))
    n_lines = max(1, number.size // stretch)
    edges = np.linspace(0, number.size, n_lines + 1).astype(np.int64)
    starts, sizes = edges[:-1], np.diff(edges)
    middle = 0.5 * (number[starts] + number[edges[1:] - 1])
    # Numbers and stamps relative to the stretch's own middle and nominal line: well conditioned.
    u = number - np.repeat(middle, sizes)
    deviation = stamp - period * number
    weight = np.ones(number.size)
    for _ in range(REWEIGHTINGS):
        wu = weight * u
        s0, su, suu, sr, sur = (
            np.add.reduceat(term, starts)
            for term in (weight, wu, wu * u, weight * deviation, wu * deviation)
        )
        slope = (s0 * sur - su * sr) / (s0 * suu - su * su)
        offset = (sr - slope * su) / s0
        residual = deviation - np.repeat(offset, sizes) - np.repeat(slope, sizes) * u
        scale = 1.4826 * median_of(np.abs(residual))
        weight = 1.0 / (1.0 + np.square(residual / max(2.0 * scale, 1e-9)))
    knots = np.concatenate([[number[0]], number[edges[1:-1]], [number[-1]]])
    left = offset + slope * (knots[:-1] - middle)
    right = offset + slope * (knots[1:] - middle)
    height = np.concatenate([left[:1], 0.5 * (left[1:] + right[:-1]), right[-1:]])
    height += period * knots
    if not (np.diff(height) > 0.0).all():
        return None
    return np.asarray(np.interp(number, knots, height), dtype=np.float64)


def _misfit(stamp: F64, fitted: F64) -> float:
    """Mean distance of stamps from a fit, outliers weighing little."""
    distance = np.abs(stamp - fitted)
    return float(np.mean(np.minimum(distance, 6.0 * median_of(distance) + 1e-9)))


def _astray(stamp: F64, fitted: F64, period: float, noise: float) -> bool:
    """Tell whether a fit is off by whole messages for a while.

    Single stamps may be far off, so they are clipped. Averages over many may not, but for what
    the noise explains, except here and there where the clock stepped.
    """
    count = stamp.size // ASTRAY_SAMPLES
    if count == 0:
        return False
    apart = (stamp - fitted)[: count * ASTRAY_SAMPLES].reshape(count, ASTRAY_SAMPLES)
    apart = apart[:: count // 256 | 1]
    middle = median_of(apart.reshape(-1))
    reach = period + 4.0 * median_of(np.abs(apart - middle).reshape(-1))
    level = np.clip(apart - middle, -reach, reach).mean(axis=1)
    level = np.abs(level - np.median(level))
    bound = max(ASTRAY * period, 8.0 * noise / np.sqrt(ASTRAY_SAMPLES))
    return bool(np.mean(level > bound) > 0.02)
