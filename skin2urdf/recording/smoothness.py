"""Tell from a moving signal whether its samples were taken when stamped, or at a regular rate.

If sample i was taken delta_i after the regular time t_i, the signal there is off by its slope
times delta_i, and interpolating it from its neighbours in time misses it by that much. So what
leave-one-out interpolation misses, regressed on what the stamps predict it to miss, has a
coefficient near 1 if the stamps are true and near 0 if the regular times are. This is the
comparison of the two leave-one-out residuals, written as its difference.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.recording.numbering import median_of

# First derivative per sample of a cubic fitted to 9 samples (Savitzky and Golay, 1964).
SLOPE = np.array([86.0, -142.0, -193.0, -126.0, 0.0, 126.0, 193.0, 142.0, -86.0]) / 1188.0
# What cubic interpolation from two neighbours on either side misses.
MISSED = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0
HALO = 4
WINDOW = 128
MAX_WINDOWS = 64


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
    if stamp.size < WINDOW + 2 * HALO:
        start = np.zeros(1, np.int64)
        length = stamp.size
    else:
        start = _moving_windows(signal)
        length = WINDOW + 2 * HALO
    if length <= 2 * HALO:
        return StampEvidence(0.0, np.inf)
    index = start[:, None] + np.arange(length)
    time = regular[index]
    span = time[:, 2 * HALO :] - time[:, : -2 * HALO]
    # Not across lost messages and pauses: there the rules for regular samples do not hold.
    period = median_of(span.reshape(-1)) / (2 * HALO)
    even = np.abs(span - 2 * HALO * period) < 0.5 * period
    delta = _correlate(stamp[index] - time, MISSED)
    believable = even & (np.abs(delta) < 3.0 * period) & (np.abs(delta) > 1e-4 * period)
    share_sum = weight_sum = spread_sum = 0.0
    terms = []
    for channel in signal.T:
        values = channel[index]
        whole = believable & np.isfinite(values).all(axis=1, keepdims=True)
        if not whole.any():
            continue
        values = np.where(np.isfinite(values), values, 0.0)
        missed = _correlate(values, MISSED)
        slope = _correlate(values, SLOPE) / period
        noise = max(1.4826 * median_of(np.abs(missed[whole])), 1e-12)
        # Noise of one sample is about noise / 1.4, that of the slope a third of it per period.
        moving = whole & (np.abs(slope) > 0.75 * noise / period)
        predicted = slope[moving] * delta[moving]
        # Weights bound what a single wild stamp can say.
        weight = 1.0 / (noise**2 + predicted**2)
        terms.append((weight * predicted, missed[moving], predicted))
        share_sum += float(np.sum(weight * predicted * missed[moving]))
        weight_sum += float(np.sum(weight * predicted**2))
    if weight_sum == 0.0:
        return StampEvidence(0.0, np.inf)
    share = share_sum / weight_sum
    for score, missed, predicted in terms:
        spread_sum += float(np.sum(np.square(score * (missed - share * predicted))))
    # Neighbouring residuals share samples; twice the naive deviation covers that.
    return StampEvidence(share, 2.0 * float(np.sqrt(spread_sum)) / weight_sum)


def _moving_windows(signal: F64) -> np.ndarray:
    """Starts of the windows (halo included) in which the signal ranges widest."""
    usable = (signal.shape[0] - 2 * HALO) // WINDOW
    # Every fourth sample is enough to see where a window moves.
    cut = signal[HALO : HALO + usable * WINDOW : 4].reshape(usable, WINDOW // 4, -1)
    extent = cut.max(axis=1) - cut.min(axis=1)
    extent = np.where(np.isfinite(extent), extent, 0.0)
    scale = extent.mean(axis=0)
    relative = (extent / np.where(scale > 0.0, scale, 1.0)).sum(axis=1)
    return np.sort(np.argsort(relative)[-MAX_WINDOWS:]) * WINDOW


def _correlate(rows: F64, kernel: F64) -> F64:
    """Correlate each row with ``kernel`` at its samples inside the halo."""
    half = kernel.size // 2
    length = rows.shape[1] - 2 * HALO
    out = np.zeros((rows.shape[0], length))
    for k, factor in enumerate(kernel):
        if factor:
            begin = HALO - half + k
            out += factor * rows[:, begin : begin + length]
    return out
