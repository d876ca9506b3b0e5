"""What a fit leaves of the readings, over what noise leaves by itself.

Weights follow the residuals, and so take whatever the model lacks for noise; what is left of the
readings would then never be much more than that. Noise of sensors, encoders and vibration is of
high frequencies, motion is not: the second differences of residuals show the noise alone, and how
much slower residuals are than noise shows what the model lacks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.signals.trajectory import Trajectory

SPANS = (0.5, 2.0)
"""Lengths of spans whose means are looked at [s]: those of moves, and of what outlasts them."""
_LEAST = 1e-3**2
"""Variance of low-passed readings that no sensor falls below [m^2/s^4]: a tenth of a milligravity.
Some logs repeat one value over a rest."""
_FEWEST = 8
"""Samples of an SU from which its noise is known."""


@dataclass(frozen=True, eq=False)
class Leftover(Record):
    """What a fit leaves of U SUs.

    Attributes:
        ratio: (U,) squares of mean residuals over spans of time, over what noise makes of them;
            near 1 or below where the model explains an SU's readings, infinite where the fit has
            shifted them out of the log, NaN without readings.
        rms: (U,) root mean square of these means [m/s^2].
    """

    ratio: F64
    rms: F64

    @property
    def mean(self) -> float:
        """Mean ratio of all SUs."""
        return float(np.nanmean(self.ratio))

    @property
    def largest(self) -> float:
        """Largest ratio of an SU."""
        return float(np.nanmax(self.ratio))


def leftover(along: MotionEstimate) -> Leftover:
    """What a fit leaves, by SU."""
    U = along.problem.tree.n_sus
    by_length, by_rms = [], []
    for seconds in SPANS:
        total, square, count = np.zeros(U), np.zeros(U), np.zeros(U)
        for log, predicted in zip(along.problem.logs, along.fitted.predicted, strict=True):
            every = int(log.kept[1] - log.kept[0]) if len(log.kept) > 1 else 1
            n = max(1, round(seconds * log.rate / every))
            gain, averaged = _of_white_noise(log, every, n)
            for u in range(U):
                residual, there = predicted.residual[:, u], predicted.measured[:, u]
                variance = _noise(residual, there, gain)
                means = _means(residual, there, n)
                if variance > 0 and len(means):
                    total[u] += float((means**2).sum()) / (variance * averaged)
                    square[u] += float((means**2).sum())
                    count[u] += means.size
        nothing = np.full(U, np.nan)
        by_length.append(np.divide(total, count, out=nothing.copy(), where=count > 0))
        by_rms.append(np.sqrt(np.divide(square, count, out=nothing.copy(), where=count > 0)))
    seen = sum(p.measured.sum(axis=0) for p in along.fitted.predicted)
    valid = sum(log.valid.sum(axis=0) for log in along.problem.logs)
    gone = (valid > 0) & (2 * seen < valid)
    ratio, rms = np.fmax(*by_length), np.fmax(*by_rms)
    return Leftover(np.where(gone, np.inf, ratio), np.where(gone, np.inf, rms))


def _of_white_noise(log: Trajectory, every: int, n: int) -> tuple[float, float]:
    """Variances of second differences, and of means over n samples, of low-passed white noise.

    Both over that of the samples themselves.
    """
    taps = np.convolve(log.taps, log.taps)
    correlation = np.correlate(taps, taps, "full")
    middle = len(taps) - 1
    lags = np.arange(n) * every
    r = np.where(lags <= middle, correlation[middle + np.minimum(lags, middle)], 0.0)
    r /= correlation[middle]
    at = np.zeros(max(3, n))
    at[:n] = r
    if n < 3:
        more = np.arange(3) * every
        at[:3] = correlation[middle + np.minimum(more, middle)] / correlation[middle]
    second = 6 * at[0] - 8 * at[1] + 2 * at[2]
    weights = np.where(np.arange(n) == 0, n, 2 * (n - np.arange(n)))
    return float(second), float((weights * r).sum() / n**2)


def _noise(residual: F64, there: Bool, gain: float) -> float:
    """Variance of white noise that has the second differences of residuals (K, 3)."""
    whole = there[:-2] & there[1:-1] & there[2:]
    if whole.sum() < _FEWEST:
        return 0.0
    bend = (residual[:-2] - 2 * residual[1:-1] + residual[2:])[whole]
    # The median of chi-squared with three degrees of freedom is 2.366.
    return max(_LEAST, float(np.median((bend**2).sum(axis=1)) / 2.366 / gain))


def _means(residual: F64, there: Bool, n: int) -> F64:
    """(S, 3) means over spans of n samples that are whole."""
    size = len(residual) // n * n
    whole = there[:size].reshape(-1, n).all(axis=1)
    return np.asarray(residual[:size].reshape(-1, n, 3).mean(axis=1)[whole])
