"""Fit when the samples of a regular sensor were taken to the noisy times they were stamped with.

A sensor samples regularly, its driver stamps when a sample arrives. Stamp against message number
is then a line with noise on it, bent by clock drift and interrupted by lost messages and pauses.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.linalg.lapack import dptsv as ptsv

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.numbering import Numbering, median_of, number_messages

# The line may bend after every stretch of this many samples and seconds, whichever is longer: long
# enough to average the noise of stamps, short enough to follow the drift of a clock.
STRETCH_SAMPLES = 512
STRETCH_SECONDS = 2.0
# By how many squares of the stamps' noise a bend has to improve the fit (one, by chance alone).
BEND_PRICE = 6.0
MIN_SAMPLES = 16
# Samples from which weights are found, and how many of a stretch there are among them at least.
SOME = 1024
LEAST = 34
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
        line = bent_line(number - number[0], stamp[start:stop], period)
        if line is None:
            return None
        fitted[start:stop] = line
    return fitted


def bent_line(number: F64, stamp: F64, period: float) -> F64 | None:
    """Fit a line with a bend every so often by robust least squares, and no more bends than needed.

    A bend that the clock did not make follows the noise of the stamps, by the same time for all
    channels of a stream. So bends are taken out, every other one at a time, while the fit gets no
    worse than by chance.

    Args:
        number: (N,) message numbers.
        stamp: (N,) stamps [s].
        period: sampling period [s].

    Returns:
        (N,) fitted times [s], or None where the bent line does not rise throughout.
    """
    stretch = max(STRETCH_SAMPLES, int(STRETCH_SECONDS / period))
    edges = np.linspace(0, number.size, max(1, number.size // stretch) + 1).astype(np.int64)
    starts = edges[:-1]
    knots = np.concatenate([number[starts], number[-1:]])
    # Numbers relative to the stretch's first and stamps to the nominal line: well conditioned.
    u = number - np.repeat(number[starts], np.diff(edges))
    deviation = stamp - period * number
    # What each sample weighs shows in some of them as well as in all.
    some = np.arange(0, number.size, min(number.size // SOME | 1, STRETCH_SAMPLES // LEAST))
    height = _reweighted(knots, number[some], u[some], deviation[some], some, starts)
    weight = _weights(deviation - np.interp(number, knots, height))
    moments = _moments(weight, u, deviation, starts)
    height, misfit = _joined(knots, moments)
    noise = misfit / max(float(moments[0].sum()) - len(knots), 1.0)
    best, kept = misfit + BEND_PRICE * noise * len(knots), knots
    while len(knots) > 2:
        knots, moments = _with_half_the_bends(knots, moments)
        fewer, misfit = _joined(knots, moments)
        price = misfit + BEND_PRICE * noise * len(knots)
        if price > best:
            break
        best, height, kept = price, fewer, knots
    height += period * kept
    if not (np.diff(height) > 0.0).all():
        return None
    return np.asarray(np.interp(number, kept, height), dtype=np.float64)


def _reweighted(knots: F64, number: F64, u: F64, deviation: F64, rows: Int, starts: Int) -> F64:
    """Heights at the knots from some rows, by robust least squares (see :func:`bent_line`)."""
    first = np.searchsorted(rows, starts)
    weight = np.ones(rows.size)
    for _ in range(REWEIGHTINGS - 1):
        height, _ = _joined(knots, _moments(weight, u, deviation, first))
        weight = _weights(deviation - np.interp(number, knots, height))
    return height


def _weights(residual: F64) -> F64:
    """What each of (N,) residuals weighs: less, the further they are out."""
    scale = 1.4826 * median_of(np.abs(residual))
    return np.asarray(1.0 / (1.0 + np.square(residual / max(2.0 * scale, 1e-9))))


def _moments(weight: F64, u: F64, deviation: F64, starts: Int) -> F64:
    """(6, K - 1) sums over each stretch (see :func:`_joined`)."""
    wu, wd = weight * u, weight * deviation
    products = (weight, wu, wu * u, wd, wd * u, wd * deviation)
    return np.stack([np.add.reduceat(each, starts) for each in products])


def _joined(knots: F64, moments: F64) -> tuple[F64, float]:
    """Weighted least-squares line with bends.

    Args:
        knots: (K,) numbers at which it may bend, both ends included.
        moments: (6, K - 1) sums over each stretch of ``w, w u, w u^2, w d, w d u, w d^2``, where
            u counts from the knot before, and d is what to fit with weight w.

    Returns:
        (K,) heights at the knots and the weighted sum of squares that is left.
    """
    length = np.diff(knots)
    w, wu, wuu, d, du, dd = moments
    wt, wtt, dt = wu / length, wuu / length**2, du / length
    diagonal, right = np.zeros(len(knots)), np.zeros(len(knots))
    diagonal[:-1] += w - 2 * wt + wtt
    diagonal[1:] += wtt
    right[:-1] += d - dt
    right[1:] += dt
    # The matrix is tridiagonal, symmetric and positive: LAPACK's solver for these, unwrapped.
    *_, height, failed = ptsv(diagonal, wt - wtt, right)
    if failed:
        return np.full(len(knots), np.nan), np.inf
    return np.asarray(height), float(dd.sum() - height @ right)


def _with_half_the_bends(knots: F64, moments: F64) -> tuple[F64, F64]:
    """Knots and moments (see :func:`_joined`) with pairs of stretches made one."""
    first = np.arange(0, len(knots) - 1, 2)
    ahead = knots[:-1] - np.repeat(knots[first], 2)[: len(knots) - 1]
    w, wu, wuu, d, du, dd = moments
    moved = np.stack([w, wu + ahead * w, wuu + ahead * (2 * wu + ahead * w), d, du + ahead * d, dd])
    return np.append(knots[first], knots[-1]), np.add.reduceat(moved, first, axis=1)


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
