"""Uniform sampling, zero-phase low-pass and differentiation, the same for every stream.

Joint positions and SU readings go through identical filters before they are compared. The
regression's coefficients are constant, so filtering both sides alike adds no bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import convolve1d, map_coordinates, minimum_filter1d, spline_filter1d

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.recording.shelf import STREAMS_IN_MEMORY, Shelf, put_away, room_for_streams
from skin2urdf.recording.silence import SHORTEST_GAP, SILENT
from skin2urdf.threads import do_each

# Central differences of eighth order: at a tenth of the sampling rate still exact to 1e-5.
FIRST_DIFFERENCES = np.array(
    [1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280]
)
SECOND_DIFFERENCES = np.array(
    [-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560]
)
_LINEAR_RATE = 1300.0
"""Uneven streams faster than this [Hz] are interpolated linearly; slower ones by cubic splines."""
_UNEVEN = 1e-4
"""Relative change from one period to the next up to which a stream is regular."""
_COINCIDING = 0.25
"""Time between samples, over the usual one, below which they count as one sample: where a curve is
drawn through both, it strays from them by about as much as their noise parts them."""
_STOPBAND = 100.0
"""Attenuation beyond a low-pass [dB]: gravity of 10 m/s^2 leaves 0.1 mm/s^2, below any noise."""


@dataclass(frozen=True)
class Grid:
    """Uniform times ``start + i / rate``, i < size.

    Attributes:
        start: first time [s].
        rate: samples per second [Hz].
        size: number of samples N.
    """

    start: float
    rate: float
    size: int

    @property
    def time(self) -> F64:
        """(N,) times [s]."""
        return self.start + np.arange(self.size) / self.rate


def low_pass(cutoff: float, rate: float) -> F64:
    """Symmetric FIR low-pass with unit gain at rest, -6 dB at ``cutoff`` [Hz]."""
    width = 0.8 * min(cutoff, rate / 2 - cutoff)
    taps = int(np.ceil((_STOPBAND - 7.95) / (2.285 * 2 * np.pi * width / rate))) | 1
    beta = 0.1102 * (_STOPBAND - 8.7)
    x = np.arange(taps) - taps // 2
    sinc = np.sinc(2 * cutoff / rate * x) * np.kaiser(taps, beta)
    return np.asarray(sinc / sinc.sum())


def noise_bandwidth(taps: F64, rate: float) -> float:
    """One-sided equivalent noise bandwidth of an FIR filter [Hz]."""
    return float(np.sum(taps**2) * rate / 2)


def sample(time: F64, values: F64, grid: Grid) -> tuple[F64, Bool]:
    """Low-pass a stream and sample it on a grid.

    Args:
        time: (M,) strictly increasing sample times [s].
        values: (M, C) samples.
        grid: where to.

    Returns:
        (N, C) values, and (N,) False where the stream has a gap or has ended.
    """
    if len(time) < 8:
        return np.zeros((grid.size, values.shape[1])), np.zeros(grid.size, dtype=bool)
    steps = np.diff(time)
    typical = float(np.median(steps))
    factor = max(1, round(1 / (typical * grid.rate)))
    if np.abs(np.diff(steps)).max() < _UNEVEN * typical:
        out, reach = _sample_regular(time, values, grid, factor, typical)
    else:
        out, reach = _sample_irregular(time, values, grid, factor, typical)
    gap = steps > max(SILENT * typical, SHORTEST_GAP)
    bad = np.zeros(grid.size, dtype=bool)
    t = grid.time
    for a, b in zip(time[:-1][gap], time[1:][gap], strict=True):
        bad |= (t > a - reach) & (t < b + reach)
    bad |= (t < time[0] + reach) | (t > time[-1] - reach)
    return out, ~bad


def _sample_regular(
    time: F64, values: F64, grid: Grid, factor: int, period: float
) -> tuple[F64, float]:
    """Decimate on the stream's own clock, then interpolate what is left by quintic splines.

    Returns:
        (N, C) values, and for how long what is missing beyond the stream's ends is felt [s].
    """
    taps = low_pass(0.36 * grid.rate, 1 / period) if factor > 1 else np.ones(1)
    half = len(taps) // 2
    # Of the full convolution, the first complete output belongs to the first sample.
    lead = half + -2 * half % factor
    padded = np.pad(values, ((lead, half), (0, 0)), mode="edge")
    kept = time[::factor]
    first = (lead + half) // factor
    coarse = _decimated(padded, taps, factor, first, len(kept))
    index = np.interp(grid.time, kept, np.arange(len(kept)))
    return Spline(coarse).within(index), half * period


def _sample_irregular(
    time: F64, values: F64, grid: Grid, factor: int, typical: float
) -> tuple[F64, float]:
    """Interpolate at a multiple of the grid's rate, then decimate; returns as above."""
    fine_rate = grid.rate * factor
    taps = low_pass(0.36 * grid.rate, fine_rate) if factor > 1 else np.ones(1)
    half = len(taps) // 2
    fine = grid.start + (np.arange(-half, grid.size * factor + half)) / fine_rate
    if 1 / typical > _LINEAR_RATE:
        dense = np.stack([np.interp(fine, time, column) for column in values.T], axis=1)
    else:
        from scipy.interpolate import CubicSpline

        time, values = _parted(time, values, _COINCIDING * typical)
        inside = np.clip(fine, time[0], time[-1])
        dense = CubicSpline(time, values)(inside)
    # Full convolution, of which the first complete output belongs to the grid's first time.
    lead = np.zeros(((-2 * half) % factor, values.shape[1]))
    first = (len(lead) + 2 * half) // factor
    out = _decimated(np.concatenate([lead, dense]), taps, factor, first, grid.size)
    return out, half / fine_rate


def _parted(time: F64, values: F64, least: float) -> tuple[F64, F64]:
    """Samples with those closer than some time to the one before as one, at their mean time.

    Stamps that jitter by as much as samples are apart come to lie next to each other, or on each
    other. A curve through both has the slope of their noise, which motion never had, and carries
    it far beyond them.
    """
    first = np.flatnonzero(np.r_[True, np.diff(time) >= least])
    if len(first) == len(time):
        return time, values
    count = np.diff(first, append=len(time))
    together = np.add.reduceat(time, first) / count
    return together, np.add.reduceat(values, first, axis=0) / count[:, None]


def _decimated(values: F64, taps: F64, factor: int, first: int, size: int) -> F64:
    """Some of every ``factor``-th samples of the full convolution along the first axis.

    Args:
        values: (M, C) samples.
        taps: (T,) odd number of taps.
        factor: of the decimation.
        first: of the samples that are left, the first that is wanted, and
        size: how many.
    """
    begin, T = first * factor - 2 * (len(taps) // 2), len(taps)
    # Outputs side by side are one product with a matrix whose columns are the taps, moved along.
    rows = (_SIDE_BY_SIDE - 1) * factor + T
    matrix = np.zeros((rows, _SIDE_BY_SIDE))
    for i in range(_SIDE_BY_SIDE):
        matrix[i * factor : i * factor + T, i] = taps[::-1]
    products = -(-size // _SIDE_BY_SIDE)
    end = begin + (products - 1) * _SIDE_BY_SIDE * factor + rows
    padded = np.pad(values[: max(0, end)], ((max(0, -begin), max(0, end - len(values))), (0, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, rows, axis=0)
    seen = windows[max(0, begin) :: _SIDE_BY_SIDE * factor][:products] @ matrix
    return np.ascontiguousarray(np.moveaxis(seen, 1, 2).reshape(-1, values.shape[1])[:size])


_SIDE_BY_SIDE = 32
"""Samples that are decimated at once; a product with a matrix that caches hold."""


class Spline:
    """Quintic splines through samples (M, C), to be taken anywhere between them.

    Args:
        values: (M, C) samples.
        shelf: where its coefficients, as many numbers, are kept; in memory if None.
    """

    def __init__(self, values: F64, shelf: Shelf | None = None) -> None:
        # Reflected in its end points a signal goes on smoothly; a spline feels no more than this.
        ends = ((_MARGIN, _MARGIN), (0, 0))
        padded = np.pad(values, ends, mode="reflect", reflect_type="odd")
        self._size = len(values)
        coefficients = spline_filter1d(padded.T, order=5, axis=1, mode="mirror")
        self._coefficients = coefficients if shelf is None else shelf.put(coefficients)

    def at(self, index: F64) -> F64:
        """Values (K, C) at fractional positions (K,); NaN beyond the ends."""
        outside = (index < 0) | (index > self._size - 1)
        out = self.within(np.clip(index, 0, self._size - 1))
        out[outside] = np.nan
        return out

    def within(self, index: F64) -> F64:
        """Values (K, C) at fractional positions (K,) in [0, M - 1]."""
        at = index[None] + _MARGIN
        columns = (
            map_coordinates(c, at, order=5, mode="mirror", prefilter=False)
            for c in self._coefficients
        )
        return np.stack(list(columns), axis=1)

    def later(self, by: float) -> F64:
        """Values (M, C) at all positions plus ``by``; beyond the ends those at the ends."""
        from scipy.interpolate import BSpline  # only here: it takes 0.1 s to load

        size, step = self._size, int(np.floor(by))
        first = min(size, max(0, -step))
        last = max(first, min(size, size - step - 1))
        out = np.empty((size, len(self._coefficients)))
        out[:first], out[last:] = self.within(np.array([0.0, size - 1.0]))[:, None]
        there = np.zeros((len(self._coefficients), last - first))
        begin = first + step + _MARGIN - 2
        # One fraction for all: weights are numbers, and samples in a row.
        weights = BSpline.basis_element(np.arange(7.0))(np.arange(5.0, -1.0, -1.0) + (by - step))
        for k, weight in enumerate(weights):
            there += weight * self._coefficients[:, begin + k : begin + k + last - first]
        out[first:last] = there.T
        return out


_MARGIN = 24
"""Samples by which splines are carried on."""


def spread(time: F64, samples: Bool, grid: Grid) -> Bool:
    """(N,) True where one of the marked samples (M,) enters what :func:`sample` gives.

    Args:
        time: (M,) strictly increasing sample times [s].
        samples: (M,) the marked ones.
        grid: where to.
    """
    if not samples.any():
        return np.zeros(grid.size, dtype=bool)
    reach = 4 / grid.rate  # the low-pass has little weight beyond
    marked = time[samples]
    after = np.searchsorted(marked, grid.time - reach)
    return np.asarray(after < np.searchsorted(marked, grid.time + reach))


def filtered(values: F64, taps: F64) -> F64:
    """Zero-phase FIR along the first axis, same length; ends repeat the outermost samples."""
    if len(values) >= len(taps):
        half, N = len(taps) // 2, len(values)
        padded = np.empty((N + 2 * half, *values.shape[1:]))
        padded[:half], padded[half : half + N], padded[half + N :] = values[0], values, values[-1]
        return _convolved(padded, taps)
    return np.asarray(convolve1d(values, taps, axis=0, mode="nearest"))


_BLOCK = 8
"""Blocks of a long convolution over the taps, as few transforms of lengths as caches hold."""


def _convolved(values: F64, taps: F64) -> F64:
    """Complete outputs of a convolution along the first axis, block by block (overlap and save)."""
    T, N = len(taps), len(values)
    size = next_fast_len(min(_BLOCK * T, N), real=True)
    step = size - T + 1
    spectrum = rfft(taps, size).reshape((-1,) + (1,) * (values.ndim - 1))
    out = np.empty((N - T + 1, *values.shape[1:]))
    for begin in range(0, len(out), step):
        block = values[begin : begin + size]
        done = irfft(rfft(block, size, axis=0) * spectrum, size, axis=0)
        end = min(begin + step, len(out))
        out[begin:end] = done[T - 1 : T - 1 + end - begin]
    return out


def passed(values: F64, filters: F64, every: int) -> F64:
    """Complete outputs of some FIRs, of each so many-th sample only, as products of matrices.

    Args:
        values: (C, N) samples last.
        filters: (R, T) weights of T samples, from the first on.
        every: samples from one output to the next.

    Returns:
        (C, R, M), the first outputs made of the first T samples.
    """
    (n_filters, size), (rows, n) = filters.shape, values.shape
    count = (n - size) // every + 1
    out = np.empty((rows, n_filters, count))
    together = max(1, min(count, size // every))  # so that half of a matrix is not zero
    for begin, end in ((0, count - count % together), (count - count % together, count)):
        if begin == end:
            continue
        each = min(together, end - begin)
        band = np.zeros((n_filters, each, (each - 1) * every + size))
        for i in range(each):
            band[:, i, i * every : i * every + size] = filters
        windows = sliding_window_view(values, band.shape[2], axis=1)
        windows = windows[:, begin * every :: each * every].swapaxes(0, 1)
        done = windows @ band.reshape(-1, band.shape[2]).T
        out[..., begin:end] = (
            done.reshape(len(windows), rows, n_filters, each)
            .transpose(1, 2, 0, 3)
            .reshape(rows, n_filters, -1)
        )
    return out


def first_derivative(values: F64, rate: float, at: Int | None = None) -> F64:
    """First derivative along the first axis, of all samples or where it is wanted."""
    return _differentiated(values, FIRST_DIFFERENCES * rate, at)


def second_derivative(values: F64, rate: float, at: Int | None = None) -> F64:
    """Second derivative along the first axis, of all samples or where it is wanted."""
    return _differentiated(values, SECOND_DIFFERENCES * rate**2, at)


def higher_derivatives(q: F64, rate: float, last: int) -> F64:
    """(last - 1, N, D) second and higher derivatives of positions (N, D), up to the last."""
    out = [second_derivative(q, rate)]
    for order in range(3, last + 1):
        odd = order % 2 == 1
        out.append(first_derivative(out[-1], rate) if odd else second_derivative(out[-2], rate))
    return np.stack(out)


def _differentiated(values: F64, weights: F64, at: Int | None) -> F64:
    """Differences of neighbours, weighed; ends repeat the outermost samples."""
    if at is None:
        return np.asarray(convolve1d(values, weights[::-1], axis=0, mode="nearest"))
    out = np.zeros((len(at), *values.shape[1:]))
    half, steps = len(weights) // 2, np.unique(np.diff(at))
    inside = len(steps) == 1 and at[0] >= half and at[-1] + half < len(values)
    for k, weight in zip(range(-half, len(weights)), weights, strict=False):
        if not weight:
            continue
        if inside:  # samples in a row need no copies
            out += weight * values[at[0] + k : at[-1] + k + 1 : steps[0]]
        else:
            out += weight * values[np.clip(at + k, 0, len(values) - 1)]
    return out


def eroded(mask: Bool, reach: int) -> Bool:
    """(N,) True where the mask holds for ``reach`` samples on either side as well."""
    return np.asarray(minimum_filter1d(mask.astype(np.uint8), 2 * reach + 1, mode="nearest") > 0)


def shifted(values: F64, rate: float, delay: float) -> F64:
    """Values (N, C) of a stream taken ``delay`` [s] later, by quintic splines."""
    return values if delay == 0.0 else Spline(values).later(delay * rate)


def aligned(readings: F64, rate: float, lag: F64) -> F64:
    """Readings (N, U, 3) with every SU's lag (U,) [s] undone; themselves where there is none."""
    if not lag.any():
        return readings
    out = room_for_streams(*readings.shape)

    def align(u: int) -> None:
        out[:, u] = shifted(readings[:, u], rate, float(lag[u]))
        if u % STREAMS_IN_MEMORY == 0:
            put_away(readings, out)

    do_each(align, range(len(lag)), len(lag))
    return out
