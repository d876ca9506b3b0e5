"""Fit when the samples of a regular sensor were taken to the noisy times they were stamped with.

A sensor samples regularly, its driver stamps when a sample arrives. Stamp against message number
is then a line with noise on it, bent by clock drift and interrupted by lost messages and pauses.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.linalg.lapack import dptsv as ptsv

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.recording.earliest import number_by_earliest
from skin2urdf.recording.lattice import BELOW, number_on_lattice
from skin2urdf.recording.numbering import (
    MOVED,
    Numbering,
    may_have_gaps,
    median_of,
    medians_of,
    number_messages,
    queue_of,
)

# The line may bend after every stretch of this many samples and seconds, whichever is longer: long
# enough to average the noise of stamps, short enough to follow the drift of a clock.
STRETCH_SAMPLES = 512
STRETCH_SECONDS = 2.0
# By how many squares of the stamps' noise a bend has to improve the fit (one, by chance alone).
BEND_PRICE = 6.0
MIN_SAMPLES = 16
# Noise of stamps [periods] up to which no jump of a stamp is taken for a loss: one in a million.
JITTERS = 0.08
# Samples from which weights are found, and how many of a stretch there are among them at least.
SOME = 1024
LEAST = 34
REWEIGHTINGS = 4
# Messages that queue come closer than by this part of a period, or a queue takes too long to end.
QUEUED = 0.5 * MOVED
# Noise of a stamp that a pause exceeds: a difference of two does by chance once in 2,000 times.
BEYOND = 5.0
# Longest time that a way stalls for [s]; what comes after a longer pause was not waiting.
STALLED = 2.0
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
    return regular_times_of(stamp[None])[0]


def regular_times_of(stamp: F64) -> list[F64 | None]:
    """Fit regular sampling to the stamps of several streams, each by itself (see `regular_times`).

    Args:
        stamp: (S, N) stamps of S streams in the order of arrival [s].

    Returns:
        What `regular_times` returns for each.
    """
    found: list[F64 | None] = [None] * len(stamp)
    if not len(stamp) or stamp.shape[1] < MIN_SAMPLES:
        return found
    period, noise = _rates(stamp)
    rows = np.flatnonzero(period > 0.0)
    if not rows.size:
        return found
    if rows.size < len(stamp):
        stamp, period, noise = stamp[rows], period[rows], noise[rows]
    stamp = _without_queues(stamp, period, noise)
    plain = bent_lines(np.arange(stamp.shape[1], dtype=np.float64), stamp, period)
    sound = ~_astray(stamp, plain, period, noise)
    gaps = may_have_gaps(stamp, period, noise)
    for k, row in enumerate(rows.tolist()):
        fits = [plain[k]] if sound[k] else []
        if gaps[k]:
            fits += _fits_between_gaps(stamp[k], float(period[k]), float(noise[k]))
        misfits = [_misfit(stamp[k], fit) for fit in fits] if len(fits) > 1 else [0.0]
        found[row] = fits[int(np.argmin(misfits))] if fits else None
    return found


def _rates(stamp: F64) -> tuple[F64, F64]:
    """Estimate periods and noise of stamps from how far they are apart some messages later.

    A long lag averages noise and bursts, a short one is rarely broken by a lost message: the one
    with the least spread counts, the longer one where they are much alike.

    Args:
        stamp: (S, N) stamps [s].

    Returns:
        (S,) sampling periods [s] and scales of the noise of one stamp [s].
    """
    streams, count = stamp.shape
    period, noise = np.zeros(streams), np.full(streams, np.inf)
    for lag in (64, 32, 16, 8):
        if 2 * lag > count:
            continue
        step = count // 4096 | 1
        apart = stamp[:, lag::step] - stamp[:, : count - lag : step]
        typical = medians_of(apart)
        spread = 1.4826 * medians_of(np.abs(apart - typical[:, None])) / np.sqrt(2.0)
        # Losses make the rest too long, and a queue, while it lasts, messages too close.
        better = (spread < 0.7 * noise) & ~(typical < (1 - BELOW) * lag * period)
        period = np.where(better, typical / lag, period)
        noise = np.where(better, spread, noise)
    return period, noise


def _without_queues(stamp: F64, period: F64, noise: F64) -> F64:
    """Stamps of messages that queued up while a driver or the way stalled, as if they had not.

    One that has others right behind it waited until these were there, but for the periods between
    them. Only where a pause beyond noise comes before them is it no noise that brought them close.

    Args:
        stamp: (S, N) stamps [s].
        period: (S,) sampling periods [s].
        noise: (S,) scales of the noise of one stamp [s].

    Returns:
        (S, N) stamps, at most as late.
    """
    step = np.diff(stamp, axis=1) / period[:, None]
    close = step < 1 - QUEUED
    pause = 1 + np.maximum(MOVED, BEYOND * noise / period)[:, None]
    waits = step[:, :-1]
    stalls = close[:, 1:] & (waits > pause) & (waits < STALLED / period[:, None])
    rows = np.flatnonzero(stalls.any(axis=1))
    if not rows.size:
        return stamp
    out = stamp.copy()
    for row in rows.tolist():
        due = period[row] * np.arange(stamp.shape[1])
        # The last first, as one stall may follow another before all that waited is there.
        for before in np.flatnonzero(stalls[row])[::-1].tolist():
            queue = slice(before + 1, before + 2 + int(step[row, before] / QUEUED))
            late = out[row, queue] - due[queue]
            least = np.minimum.accumulate(late[::-1])[::-1]
            waited = late - least > BEYOND * noise[row]
            out[row, queue] = due[queue] + np.where(waited, least, late)
    return out


def _fits_between_gaps(stamp: F64, period: float, noise: float) -> list[F64]:
    """Fits (N,) to each piece of a stream that lost messages, if it lost any and there is one.

    Jumps of single stamps place losses exactly where stamps are good; where they are not, the phase
    of the clock still tells how many there are.
    """
    numberings = [number_messages(stamp, period, noise)]
    if noise > JITTERS * period:
        numberings += [number_on_lattice(stamp, period), number_by_earliest(stamp, period)]
    fits = (_fit(stamp, numbering, period) for numbering in numberings if numbering is not None)
    whole = [fitted for fitted in fits if fitted is not None]
    scale = np.array([period]), np.array([noise])
    return [fitted for fitted in whole if not _astray(stamp[None], fitted[None], *scale)[0]]


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
    """Fit a line with a bend every so often to the stamps of one stream (see `bent_lines`).

    Args:
        number: (N,) message numbers.
        stamp: (N,) stamps [s].
        period: sampling period [s].

    Returns:
        (N,) fitted times [s], or None where the bent line does not rise throughout.
    """
    line: F64 = bent_lines(number, stamp[None], np.array([period]))[0]
    return None if np.isnan(line).any() else line


def bent_lines(number: F64, stamp: F64, period: F64) -> F64:
    """Fit lines with a bend every so often by robust least squares, and no more bends than needed.

    A bend that the clock did not make follows the noise of the stamps, by the same time for all
    channels of a stream. So bends are taken out, every other one at a time, while the fit gets no
    worse than by chance.

    Args:
        number: (N,) message numbers, the same for all S streams.
        stamp: (S, N) stamps [s].
        period: (S,) sampling periods [s].

    Returns:
        (S, N) fitted times [s], NaN for streams whose bent line does not rise throughout.
    """
    stretch = np.maximum(STRETCH_SAMPLES, (STRETCH_SECONDS / period).astype(np.int64))
    stretches = np.maximum(1, number.size // stretch)
    fitted = np.empty(stamp.shape)
    for count in np.unique(stretches):
        rows: slice | Bool = slice(None) if len(fitted) == 1 else stretches == count
        fitted[rows] = _bent(number, stamp[rows], period[rows], int(count))
    return fitted


def _bent(number: F64, stamp: F64, period: F64, stretches: int) -> F64:
    """Lines of so many stretches at most (see :func:`bent_lines`)."""
    edges = np.linspace(0, number.size, stretches + 1).astype(np.int64)
    starts = edges[:-1]
    knots = np.concatenate([number[starts], number[-1:]])
    # Numbers relative to the stretch's first and stamps to the nominal line: well conditioned.
    u = number - np.repeat(number[starts], np.diff(edges))
    deviation = stamp - period[:, None] * number
    # What each sample weighs shows in some of them as well as in all.
    step = min(number.size // SOME | 1, STRETCH_SAMPLES // LEAST)
    first = -(-starts // step)
    height = _reweighted(knots, u[::step], deviation[:, ::step], first)
    weight = _weights(deviation - _along(knots, height, u, starts))
    moments = _moments(weight, u, deviation, starts)
    height, misfit = _joined(knots, moments)
    noise = misfit / np.maximum(moments[0].sum(axis=1) - len(knots), 1.0)
    # Messages that come right behind each other are late alike: a line follows all of them.
    noise *= queue_of(stamp, period)
    best = misfit + BEND_PRICE * noise * len(knots)
    lines = [(knots, each) for each in height]
    rows = np.arange(len(stamp))
    while len(knots) > 2 and rows.size:
        knots, moments = _with_half_the_bends(knots, moments)
        height, misfit = _joined(knots, moments)
        price = misfit + BEND_PRICE * noise[rows] * len(knots)
        good = np.flatnonzero(~(price > best[rows]))
        rows, moments = rows[good], moments[:, good]
        best[rows] = price[good]
        for k, row in zip(good.tolist(), rows.tolist(), strict=True):
            lines[row] = knots, height[k]
    fitted = np.full(stamp.shape, np.nan)
    for row, (kept, deviations) in enumerate(lines):
        heights = deviations + period[row] * kept
        if (np.diff(heights) > 0.0).all():
            fitted[row] = np.interp(number, kept, heights)
    return fitted


def _along(knots: F64, height: F64, u: F64, starts: Int) -> F64:
    """Values (S, N) of bent lines.

    Args:
        knots: (K,) numbers at which they bend.
        height: (S, K) their heights there.
        u: (N,) how far behind the knot before them values are wanted.
        starts: (K - 1,) the first of these behind each knot.
    """
    count = np.diff(starts, append=u.size)
    slope = np.diff(height, axis=1) / np.diff(knots)
    line = np.repeat(slope, count, axis=1)
    line *= u
    line += np.repeat(height[:, :-1], count, axis=1)
    return line


def _reweighted(knots: F64, u: F64, deviation: F64, starts: Int) -> F64:
    """(S, K) heights at the knots from some rows, by robust least squares (see :func:`_bent`)."""
    weight = np.ones(deviation.shape)
    height = np.zeros((len(deviation), len(knots)))
    for last in range(REWEIGHTINGS - 1):
        height, _ = _joined(knots, _moments(weight, u, deviation, starts))
        if last < REWEIGHTINGS - 2:
            weight = _weights(deviation - _along(knots, height, u, starts))
    return height


def _weights(residual: F64) -> F64:
    """What each of (S, N) residuals weighs: less, the further they are out."""
    scale = 1.4826 * medians_of(np.abs(residual))
    weight = residual / np.maximum(2.0 * scale, 1e-9)[:, None]
    np.square(weight, out=weight)
    weight += 1.0
    return np.asarray(np.reciprocal(weight, out=weight))


def _moments(weight: F64, u: F64, deviation: F64, starts: Int) -> F64:
    """(6, S, K - 1) sums over each stretch (see :func:`_joined`)."""
    wu, wd = weight * u, weight * deviation
    products = (weight, wu, wu * u, wd, wd * u, wd * deviation)
    if len(starts) == 1:
        return np.stack([each.sum(axis=1, keepdims=True) for each in products])
    return np.stack([np.add.reduceat(each, starts, axis=1) for each in products])


def _joined(knots: F64, moments: F64) -> tuple[F64, F64]:
    """Weighted least-squares lines with bends.

    Args:
        knots: (K,) numbers at which they may bend, both ends included.
        moments: (6, S, K - 1) sums over each stretch of ``w, w u, w u^2, w d, w d u, w d^2``, where
            u counts from the knot before, and d is what to fit with weight w.

    Returns:
        (S, K) heights at the knots and (S,) weighted sums of squares that are left.
    """
    length = np.diff(knots)
    w, wu, wuu, d, du, dd = moments
    wt, wtt, dt = wu / length, wuu / length**2, du / length
    diagonal, right = np.zeros((len(w), len(knots))), np.zeros((len(w), len(knots)))
    diagonal[:, :-1] += w - 2 * wt + wtt
    diagonal[:, 1:] += wtt
    right[:, :-1] += d - dt
    right[:, 1:] += dt
    beside = wt - wtt
    # The matrices are tridiagonal, symmetric and positive: LAPACK's solver for these, unwrapped.
    solved = [ptsv(*row) for row in zip(diagonal, beside, right, strict=True)]
    height = np.array([np.full(len(knots), np.nan) if bad else at for *_, at, bad in solved])
    left = dd.sum(axis=1) - np.einsum("sk,sk->s", height, right)
    return height.reshape(right.shape), np.where(np.isnan(left), np.inf, left)


def _with_half_the_bends(knots: F64, moments: F64) -> tuple[F64, F64]:
    """Knots and moments (see :func:`_joined`) with pairs of stretches made one."""
    first = np.arange(0, len(knots) - 1, 2)
    ahead = knots[:-1] - np.repeat(knots[first], 2)[: len(knots) - 1]
    w, wu, wuu, d, du, dd = moments
    moved = np.stack([w, wu + ahead * w, wuu + ahead * (2 * wu + ahead * w), d, du + ahead * d, dd])
    return np.append(knots[first], knots[-1]), np.add.reduceat(moved, first, axis=2)


def _misfit(stamp: F64, fitted: F64) -> float:
    """Mean distance of stamps from a fit, outliers weighing little."""
    distance = np.abs(stamp - fitted)
    return float(np.mean(np.minimum(distance, 6.0 * median_of(distance) + 1e-9)))


def _astray(stamp: F64, fitted: F64, period: F64, noise: F64) -> Bool:
    """Tell which fits are off by whole messages for a while.

    Single stamps may be far off, so they are clipped. Averages over many may not, but for what
    the noise explains, except here and there where the clock stepped. Of messages that queue whole
    queues are noise.

    Args:
        stamp: (S, N) stamps [s].
        fitted: (S, N) fits [s]; one that holds no numbers is astray.
        period: (S,) sampling periods [s].
        noise: (S,) scales of the noise of one stamp [s].
    """
    streams, samples = stamp.shape
    lost: Bool = np.isnan(fitted[:, 0])
    count = samples // ASTRAY_SAMPLES
    if count == 0:
        return lost
    apart = (stamp - fitted)[:, : count * ASTRAY_SAMPLES]
    apart = apart.reshape(streams, count, ASTRAY_SAMPLES)[:, :: count // 256 | 1]
    flat = apart.reshape(streams, -1)
    middle = medians_of(flat)[:, None]
    reach = period + 4.0 * medians_of(np.abs(flat - middle))
    away = apart - middle[:, None]
    level = np.clip(away, -reach[:, None, None], reach[:, None, None]).mean(axis=2)
    level = np.abs(level - np.median(level, axis=1, keepdims=True))
    alone = ASTRAY_SAMPLES / queue_of(stamp, period)
    bound = np.maximum(ASTRAY * period, 8.0 * noise / np.sqrt(alone))
    return np.asarray(lost | (np.mean(level > bound[:, None], axis=1) > 0.02))
