"""What a sensor's own low-pass makes of a reading, its lag apart.

Up to second order, with s the Laplace variable,

    H(s) = exp(b s) / (1 + b s + r s^2)

has the lag b of the filter taken off, which a clock's lag can not be told from. One pole at F [Hz]
has ``b = 1 / (2 pi F)`` and r = 0; a filter of second order (Butterworth) has ``b^2 = 2 r`` with
``r = 1 / (2 pi F)^2``. To second order in s, H is ``1 + (b^2 / 2 - r) s^2``: a droop of the
amplitude, which at a pattern's frequency looks like a lever arm that is too short. What rises
instead, ``r > b^2`` or p below zero, does so by a factor ``1 - (r - b^2) s^2``: poles stay damped.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from skin2urdf.arrays import F64, Complex

N_FRONT = 2
"""Coordinates of a front end: p, the square of b, and r, both in s^2."""
_SLOW, _FAST = 1 / 16, 1 / 64
"""Front ends to begin with, over what is common: lags of 2 and 1 ms where 8 are. From the slow one
the way leads to real low-passes of 10 to 44 Hz; from the fast one, or from half of it, it ends
before some of them. From the slow one, noise of encoders of 12 and 13 bits leads one SU of three to
a low-pass of 7 Hz that is not there, from 8 ms on all of them."""
_SMALL = 1e-12
"""Square of a lag below which it is none [s^2]: a microsecond."""


def front_end(read: Spectrum, front: F64) -> F64:
    """Readings (U, C, N) behind their sensors' front ends.

    Args:
        read: readings without a front end.
        front: (U, 2) p and r of each SU [s^2].
    """
    return read.line + read.times(gain(read.w, front))


def front_end_slopes(read: Spectrum, in_time: Spectrum, front: F64) -> tuple[F64, F64]:
    """Derivatives of :func:`front_end` in time and in the coordinates.

    Args:
        read: readings without a front end, and
        in_time: their derivatives.
        front: as above.

    Returns:
        (U, C, N) and (2, U, C, N) [1/s and 1/s^2 times the unit].
    """
    H, by_front = transfer(read.w, front)
    return in_time.line + in_time.times(H), np.stack([read.times(each) for each in by_front])


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Signals (..., N) as straight lines, which no front end changes, and Fourier series.

    Without its line a signal would step from its end to its beginning, and ring about both. Both
    are linear in the signals, so that what many SUs read of a few points of a link is transformed
    with these.

    Attributes:
        line: (..., N) the lines.
        series: (..., F) the series of what is left, carried on beyond both ends.
        w: (F,) angular frequencies of the series [rad/s].
        size: samples of what they stand for.
        inner: which of these the signals have.
    """

    line: F64
    series: Complex
    w: F64
    size: int
    inner: slice

    @staticmethod
    def of(signals: F64, rate: float, margin: int) -> Spectrum:
        """Those of signals (..., N).

        Args:
            signals: N samples at one rate.
            rate: samples per second [Hz].
            margin: samples by which the ends are carried on.
        """
        n = signals.shape[-1]
        size = next_fast_len(n + 2 * margin, real=True)
        inner = slice(margin, margin + n)
        ends = [(0, 0)] * (signals.ndim - 1) + [(margin, size - n - margin)]
        padded = np.pad(signals, ends, mode="reflect", reflect_type="odd")
        first, last = padded[..., :1], padded[..., -1:]
        line = first + (last - first) * np.linspace(0.0, 1.0, size)
        w = 2 * np.pi * rfftfreq(size, 1 / rate)
        return Spectrum(line[..., inner], rfft(padded - line), w, size, inner)

    def mixed(self, weight: F64) -> Spectrum:
        """Those of the signals that weights (U, C, p) make of p signals."""
        shape, flat = weight.shape[:-1], weight.reshape(-1, weight.shape[-1])
        series = (flat @ self.series.view(np.float64)).view(np.complex128)
        line = (flat @ self.line).reshape(*shape, -1)
        return replace(self, line=line, series=series.reshape(*shape, -1))

    def times(self, gains: F64) -> F64:
        """(U, C, N) the series (U, C, F) with gains (F, U)."""
        return np.asarray(irfft(self.series * gains.T[:, None], self.size)[..., self.inner])


def gain(w: F64, front: F64) -> F64:
    """H at angular frequencies w (F,) [rad/s]: (F, U)."""
    return _parts(w, front)[0]


def transfer(w: F64, front: F64) -> tuple[F64, F64]:
    """H at angular frequencies w (F,) [rad/s]: (F, U), and its derivatives (2, F, U)."""
    H, N, D = _parts(w, front)
    p, r = front.T
    s, w2 = 1j * w[:, None], w[:, None] ** 2
    positive = np.maximum(p, 0.0)
    rises = r - 0.5 * np.minimum(p, 0.0) > positive
    by_q = w2 * H / np.where(rises, N, D)
    has_lag = p > _SMALL
    by_lag = s * H * (1 - 1 / D) / (2 * np.where(has_lag, np.sqrt(positive), 1.0))
    by_lag = by_lag + np.where(rises, w2 * H / D - by_q, 0.0)
    return H, np.stack([np.where(has_lag, by_lag, -0.5 * by_q), by_q])


def _parts(w: F64, front: F64) -> tuple[F64, F64, F64]:
    """(F, U) H, and its numerator (but for the lag that is taken off) and denominator."""
    p, r = front.T
    positive = np.maximum(p, 0.0)
    b = np.sqrt(positive)
    s, w2 = 1j * w[:, None], w[:, None] ** 2
    # A sensor that rises instead of drooping has no pole to say it with: beyond a damping of a half
    # poles would ring, and without a lag they would be on the axis.
    q = r - 0.5 * np.minimum(p, 0.0)
    rise = np.maximum(q - positive, 0.0)
    D = 1 + s * b - w2 * (q - rise)
    N = 1 + w2 * rise
    return np.exp(s * b) * N / D, N, D


def droop(front: F64) -> F64:
    """Droop (...) [s^2] of front ends (..., 2): what they take away per square of frequency."""
    return np.asarray(0.5 * front[..., 0] - front[..., 1])


def droop_variance(covariance: F64) -> F64:
    """Variance (...) of the droop [s^4] of front ends with covariances (..., 2, 2)."""
    weight = np.array([0.5, -1.0])
    return np.asarray(covariance @ weight @ weight)


def common_front_end(cutoff: float, order: int) -> tuple[F64, F64]:
    """Mean and standard deviation (2,) of the coordinates of a front end of a data sheet [s^2].

    Data sheets give cutoffs to a tenth, of which the coordinates go with the square.

    Args:
        cutoff: where the amplitude is down by 3 dB [Hz].
        order: 1 or 2.
    """
    square = (2 * np.pi * cutoff) ** -2
    mean = np.array([square, 0.0]) if order == 1 else np.array([2 * square, square])
    return mean, 0.2 * mean


def begin_front(front: F64, *, fast: bool = False) -> F64:
    """Front end (2,) to begin with: that of a filter of second order.

    Without any filter the slope towards one of second order is zero, and where data ask for it the
    way begins on either side.

    Args:
        front: mean and standard deviation (2, 2) of what is known before [s^2].
        fast: whether the way shall lead to low-passes only of which there is no doubt.
    """
    mean, deviation = front
    begin = (_FAST if fast else _SLOW) * np.array([1.0, 0.5]) * deviation
    return np.asarray(mean if mean.any() else begin)
