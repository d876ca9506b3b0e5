"""Tell from a moving signal whether its samples were taken when stamped, or at a regular rate.

If sample i was taken delta_i after the regular time t_i, the signal there is off by its slope
times delta_i, and interpolating it from its neighbours in time misses it by that much. So what
leave-one-out interpolation misses, regressed on what the stamps predict it to miss, has a
coefficient near 1 if the stamps are true and near 0 if the regular times are. This is the
comparison of the two leave-one-out residuals, written as its difference.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.numbering import median_of

# First derivative per sample of a cubic fitted to 9 samples (Savitzky and Golay, 1964).
SLOPE = np.array([86.0, -142.0, -193.0, -126.0, 0.0, 126.0, 193.0, 142.0, -86.0]) / 1188.0
# What cubic interpolation from two neighbours on either side misses.
MISSED = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0
HALO = 4
WINDOW = 128
# Windows that are looked at: those that move most, and more where these leave a doubt, which is
# where the share is nearer to the middle than so many standard deviations.
WINDOWS = (16, 64)
CLEAR = 4.0
# Channels that are looked at together; more of them would take more memory than they save time.
TOGETHER = 8


class StampEvidence(NamedTuple):
    """How far the signal sides with the stamps.

    Attributes:
        share: near 1 where the stamps are true, near 0 where the regular times are.
        uncertainty: standard deviation of `share`; infinite where nothing moves.
    """

    share: float
    uncertainty: float


def weigh_stamps(stamp: F64, regular: F64, signal: F64) -> StampEvidence:
    """Compare stamps with regular times by the signal, where it moves most.

    Args:
        stamp: (N,) stamps [s].
        regular: (N,) regular times of the same samples [s].
        signal: (N, C) the samples; channels with gaps (NaN) count where they are whole.

    Returns:
        The evidence.
    """
    if stamp.size <= 2 * HALO:
        return StampEvidence(0.0, np.inf)
    if stamp.size < WINDOW + 2 * HALO:
        return _weighed(stamp, regular, signal, np.arange(stamp.size)[None])
    evidence = StampEvidence(0.0, np.inf)
    length = np.arange(WINDOW + 2 * HALO)
    for start in _moving_windows(signal):
        evidence = _weighed(stamp, regular, signal, start[:, None] + length)
        if abs(evidence.share - 0.5) > CLEAR * evidence.uncertainty:
            break
    return evidence


def _weighed(stamp: F64, regular: F64, signal: F64, index: Int) -> StampEvidence:
    """The evidence of windows of samples with (W, L) numbers; see :func:`weigh_stamps`."""
    time = regular[index]
    span = time[:, 2 * HALO :] - time[:, : -2 * HALO]
    # Not across lost messages and pauses: there the rules for regular samples do not hold.
    period = median_of(span.reshape(-1)) / (2 * HALO)
    even = np.abs(span - 2 * HALO * period) < 0.5 * period
    delta = _correlate(stamp[index] - time, MISSED)
    believable = even & (np.abs(delta) < 3.0 * period) & (np.abs(delta) > 1e-4 * period)
    share_sum = weight_sum = spread_sum = 0.0
    terms = []
    for first in range(0, signal.shape[1], TOGETHER):
        values = np.moveaxis(signal[:, first : first + TOGETHER][index], -1, 0)
        finite = np.isfinite(values)
        whole = np.broadcast_to(believable, (len(values), *believable.shape))
        if not finite.all():
            whole = whole & finite.all(axis=2, keepdims=True)
            values = np.where(finite, values, 0.0)
        missed = _correlate(values, MISSED)
        slope = _correlate(values, SLOPE) / period
        noise = np.full((len(values), 1, 1), np.inf)
        for k in np.flatnonzero(whole.any(axis=(1, 2))):
            noise[k] = max(1.4826 * median_of(np.abs(missed[k][whole[k]])), 1e-12)
        # Noise of one sample is about noise / 1.4, that of the slope a third of it per period.
        moving = whole & (np.abs(slope) > 0.75 * noise / period)
        left = missed[moving]
        predicted = (slope * delta)[moving]
        # Weights bound what a single wild stamp can say.
        weight = 1.0 / (np.broadcast_to(noise, moving.shape)[moving] ** 2 + predicted**2)
        terms.append((weight * predicted, left, predicted))
        share_sum += float(np.sum(weight * predicted * left))
        weight_sum += float(np.sum(weight * predicted**2))
    if weight_sum == 0.0:
        return StampEvidence(0.0, np.inf)
    share = share_sum / weight_sum
    for score, left, predicted in terms:
        spread_sum += float(np.sum(np.square(score * (left - share * predicted))))
    # Neighbouring residuals share samples; twice the naive deviation covers that.
    return StampEvidence(share, 2.0 * float(np.sqrt(spread_sum)) / weight_sum)


def _moving_windows(signal: F64) -> Iterator[Int]:
    """Starts of the windows (halo included) in which the signal ranges widest: some, then more."""
    usable = (signal.shape[0] - 2 * HALO) // WINDOW
    # Every fourth sample is enough to see where a window moves.
    cut = signal[HALO : HALO + usable * WINDOW : 4].reshape(usable, WINDOW // 4, -1)
    extent = cut.max(axis=1) - cut.min(axis=1)
    extent = np.where(np.isfinite(extent), extent, 0.0)
    scale = extent.mean(axis=0)
    relative = (extent / np.where(scale > 0.0, scale, 1.0)).sum(axis=1)
    order = np.argsort(relative)
    for most in WINDOWS:
        yield np.sort(order[-most:]) * WINDOW
        if order.size <= most:
            return


def _correlate(rows: F64, kernel: F64) -> F64:
    """Correlate each row, along the last axis, with ``kernel`` at its samples inside the halo."""
    half = kernel.size // 2
    length = rows.shape[-1] - 2 * HALO
    out = np.zeros((*rows.shape[:-1], length))
    for k, factor in enumerate(kernel):
        if factor:
            begin = HALO - half + k
            out += factor * rows[..., begin : begin + length]
    return out
