"""Tell from a moving signal whether its samples were taken when stamped, or at a regular rate.

If sample i was taken delta_i after the regular time t_i, the signal there is off by its slope
times delta_i, and interpolating it from its neighbours in time misses it by that much. So what
leave-one-out interpolation misses, regressed on what the stamps predict it to miss, has a
coefficient near 1 if the stamps are true and near 0 if the regular times are. This is the
comparison of the two leave-one-out residuals, written as its difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.recording.numbering import median_of, medians_of

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
    """How far the signals of S streams side with the stamps.

    Attributes:
        share: (S,) near 1 where the stamps are true, near 0 where the regular times are.
        uncertainty: (S,) standard deviations of `share`; infinite where nothing moves.
    """

    share: F64
    uncertainty: F64


def weigh_stamps(stamp: F64, regular: F64, signals: Sequence[F64]) -> StampEvidence:
    """Compare stamps with regular times by the signals, where these move most.

    Args:
        stamp: (S, N) stamps of S streams [s].
        regular: (S, N) regular times of the same samples [s].
        signals: (N, C) samples of each stream; channels with gaps (NaN) count where they are whole.

    Returns:
        The evidence of each stream.
    """
    streams, count = stamp.shape
    share, uncertainty = np.zeros(streams), np.full(streams, np.inf)
    if count <= 2 * HALO:
        return StampEvidence(share, uncertainty)
    if count < WINDOW + 2 * HALO:
        index = np.broadcast_to(np.arange(count), (streams, 1, count))
        return _weighed(stamp, regular, signals, index)
    length = np.arange(WINDOW + 2 * HALO)
    order = np.stack([_by_movement(signal) for signal in signals])
    doubtful = np.arange(streams)
    for most in WINDOWS:
        start = np.sort(order[doubtful, -most:], axis=1) * WINDOW
        found = _weighed(
            stamp[doubtful],
            regular[doubtful],
            [signals[k] for k in doubtful.tolist()],
            start[:, :, None] + length,
        )
        share[doubtful], uncertainty[doubtful] = found
        doubtful = doubtful[~(np.abs(found.share - 0.5) > CLEAR * found.uncertainty)]
        if order.shape[1] <= most or not doubtful.size:
            break
    return StampEvidence(share, uncertainty)


def _weighed(stamp: F64, regular: F64, signals: Sequence[F64], index: Int) -> StampEvidence:
    """The evidence of windows of samples with (S, W, L) numbers; see :func:`weigh_stamps`."""
    streams = len(index)
    row = np.arange(streams)[:, None, None]
    time = regular[row, index]
    span = time[:, :, 2 * HALO :] - time[:, :, : -2 * HALO]
    # Not across lost messages and pauses: there the rules for regular samples do not hold.
    period = (medians_of(span.reshape(streams, -1)) / (2 * HALO))[:, None, None]
    even = np.abs(span - 2 * HALO * period) < 0.5 * period
    delta = _correlate(stamp[row, index] - time, MISSED)
    even &= np.abs(delta) < 3.0 * period
    believable = even & (np.abs(delta) > 1e-4 * period)
    channels = signals[0].shape[1]
    score_sum, weight_sum = np.zeros(streams), np.zeros(streams)
    squares, by_noise = np.zeros((3, streams)), np.zeros(streams)
    for first in range(0, channels, TOGETHER):
        values = np.stack([
            signal[at, channel]
            for signal, at in zip(signals, index, strict=True)
            for channel in range(first, min(first + TOGETHER, channels))
        ])  # fmt: skip
        values = values.reshape(streams, -1, *index.shape[1:])
        finite = np.isfinite(values)
        usable, whole = even[:, None], believable[:, None]
        if not finite.all():
            sound = finite.all(axis=3, keepdims=True)
            usable, whole = usable & sound, whole & sound
            values = np.where(finite, values, 0.0)
        missed = _correlate(values, MISSED)
        slope = _correlate(values, SLOPE)
        noise = _noise(missed, np.broadcast_to(usable, missed.shape))[:, :, None, None]
        # Noise of one sample is about noise / 1.4, that of the slope a third of it per period.
        moving = whole & (np.abs(slope) > 0.75 * noise)
        predicted = slope
        predicted *= (delta / period)[:, None]
        # Weights bound what a single wild stamp can say.
        score = np.where(moving, predicted / (noise**2 + predicted**2), 0.0)
        # Noise that is not known, and infinite, moves nothing.
        by_noise += (np.where(np.isfinite(noise), noise, 0.0) ** 2 * score**2).sum(axis=(1, 2, 3))
        left = score * missed
        expected = np.multiply(score, predicted, out=predicted)
        score_sum += left.sum(axis=(1, 2, 3))
        weight_sum += expected.sum(axis=(1, 2, 3))
        # Of the sum of (left - share expected)^2, whose share is not known yet.
        for k, (one, other) in enumerate([(left, left), (left, expected), (expected, expected)]):
            squares[k] += np.einsum("scwl,scwl->s", one, other)
    told = weight_sum > 0.0
    weight = np.where(told, weight_sum, 1.0)
    share = score_sum / weight
    spread = np.maximum(squares[0] - 2 * share * squares[1] + share**2 * squares[2], 0.0)
    # The share follows what it is made of, all of it where that is one sample: what is left is no
    # less than noise. Neighbouring residuals share samples; twice the naive deviation covers that.
    deviation = 2.0 * np.sqrt(np.maximum(spread, by_noise)) / weight
    return StampEvidence(share, np.where(told, deviation, np.inf))


def _noise(missed: F64, usable: Bool) -> F64:
    """(S, C) scale of what interpolation misses (S, C, W, L) where it is usable; else infinite."""
    rows = np.abs(missed).reshape(-1, missed.shape[2] * missed.shape[3])
    usable = usable.reshape(rows.shape)
    noise = np.full(len(rows), np.inf)
    everywhere = usable.all(axis=1)
    if everywhere.any():
        noise[everywhere] = medians_of(rows[everywhere])
    for k in np.flatnonzero(~everywhere & usable.any(axis=1)):
        noise[k] = median_of(rows[k][usable[k]])
    return np.asarray(np.maximum(1.4826 * noise, 1e-12).reshape(missed.shape[:2]))


def _by_movement(signal: F64) -> Int:
    """Windows (halo included) of a signal (N, C), those last in which it ranges widest."""
    usable = (signal.shape[0] - 2 * HALO) // WINDOW
    # Every fourth sample is enough to see where a window moves.
    cut = signal[HALO : HALO + usable * WINDOW : 4].reshape(usable, WINDOW // 4, -1)
    extent = cut.max(axis=1) - cut.min(axis=1)
    extent = np.where(np.isfinite(extent), extent, 0.0)
    scale = extent.mean(axis=0)
    return np.argsort((extent / np.where(scale > 0.0, scale, 1.0)).sum(axis=1))


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
