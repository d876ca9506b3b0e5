"""Noise that is neither white nor steady, as each regressor meets it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from skin2urdf.arrays import F64, Record

_LOWEST, _HIGHEST = 0.25, 0.75
"""Frequencies at which residuals tell the noise: from [Hz], up to the share of the cutoff from
which the low-pass takes something away."""
_AT_MOST = 1e3
"""Largest factor between the noise that a regressor meets and the mean."""
_RANK = 1e-9
"""Relative eigenvalue from which regressors count as independent."""


@dataclass(frozen=True, eq=False)
class Coloured(Record):
    """Noise of U SUs around one pose, relative to its mean over all samples.

    Residuals are neither white nor steady: what the encoders' rounding adds grows with the fourth
    power of frequency, and only while a joint moves. A coefficient sees the noise at the
    frequencies and times of the regressors that it is told by (White 1980).

    Attributes:
        level: (U, 2) the spectrum's part that is white, and the one that grows with the fourth
            power of the frequency over the cutoff.
        power: (N, U) mean square by time.
        rate: samples per second [Hz].
        cutoff: of the low-pass [Hz].
    """

    level: F64
    power: F64
    rate: float
    cutoff: float

    @classmethod
    def of(
        cls, residual: F64, basis: F64, rate: float, cutoff: float, independence: float
    ) -> Coloured:
        """The noise that residuals show.

        At rest the encoders add nothing to the sensors' noise, which is white and steady.

        Args:
            residual: (N, U, 3) residuals.
            basis: (N, r) orthonormal basis of all regressors, nuisances included.
            rate: samples per second [Hz].
            cutoff: of the low-pass [Hz].
            independence: independent samples per sample.
        """
        N, U, _ = residual.shape
        f = _frequencies(N, rate)
        band = (f > _LOWEST) & (f < _HIGHEST * cutoff)
        # A window may be too short to hold a frequency of the band.
        if basis.shape[1] == 1 or not band.any():
            return cls(np.tile([1.0, 0.0], (U, 1)), np.ones((N, U)), rate, cutoff)
        spectrum = (np.abs(np.fft.rfft(residual, axis=0)) ** 2).mean(axis=2)
        # White noise that leaves residuals of this power would be as high in the whole pass band.
        freedom = max(1.0, independence * N - basis.shape[1])
        mean = spectrum.sum(axis=0) / (0.5 * freedom)
        # The regressors have taken their share of the noise, at their frequencies and times.
        taken = (np.abs(np.fft.rfft(basis, axis=0)) ** 2).sum(axis=1) / len(basis)
        spectrum /= (1 - np.clip(taken, 0.0, 0.8))[:, None]
        level = _spectra((f[band] / cutoff) ** 4, spectrum[band].T)
        level /= np.maximum(mean, 1e-300)[:, None]
        leverage = np.clip(np.einsum("ni,ni->n", basis, basis) / independence, 0.0, 0.8)
        squared = (residual**2).mean(axis=2) / (1 - leverage)[:, None]
        power = uniform_filter1d(squared, max(1, int(0.5 * rate)), axis=0, mode="nearest")
        power /= np.maximum(power.mean(axis=0), 1e-300)
        return cls(level, power, rate, cutoff)

    def by_time(self, X: F64) -> F64:
        """(U, n) noise power at the times of each regressor of X (N, n); 1 for columns of zeros.

        At least 1: what makes some times noisier is the encoders' noise, of high frequencies. At
        low ones, which tell s from tau, quiet times are no quieter than others.
        """
        return np.maximum(_clipped(_ratio(self.power.T @ X**2, (X**2).sum(axis=0))), 1.0)

    def factored(self, information: F64, X: F64) -> tuple[F64, F64]:
        """The information that least squares have where the noise has these spectra.

        Ordinary least squares have the covariance ``I^-1 (a I + b J) I^-1``, where I is the
        information for white noise and J holds the same products weighted like the second level of
        the spectrum. I and J are made diagonal together, once for all SUs.

        Args:
            information: (n, n) for white noise of unit power.
            X: (N, n) regressors without what nuisances explain, so scaled that ``X^T X`` is the
                information.

        Returns:
            (n, n) G and (U, n) gains: the information is ``G diag(gain) G^T``.
        """
        n = len(information)
        used = np.flatnonzero(np.diag(information) > 0)
        size = np.sqrt(np.diag(information)[used])
        lam, V = np.linalg.eigh(information[np.ix_(used, used)] / size / size[:, None])
        lam, V = lam[lam > _RANK], V[:, lam > _RANK]
        root, back = size[:, None] * V * np.sqrt(lam), (V / np.sqrt(lam)).T / size
        spectrum, high = self._spectrum(X[:, used])
        steep = (spectrum.conj().T * high) @ spectrum
        share, turn = np.linalg.eigh(back @ steep.real @ back.T)
        G, gain = np.zeros((n, n)), np.zeros((len(self.level), n))
        G[used, : len(lam)] = root @ turn
        gain[:, : len(lam)] = 1 / _clipped(self.level @ np.stack([np.ones_like(share), share]))
        return G, gain

    def by_su(self, X: F64) -> F64:
        """(U,) noise power that a regressor X (N, U, 3) meets of which each SU has its own."""
        energy = (X**2).sum(axis=2)
        shares = self._shares(X.reshape(len(X), -1)).reshape(2, -1, 3).sum(axis=2)
        by_frequency = _ratio((self.level.T * shares).sum(axis=0), energy.sum(axis=0))
        return _clipped(
            by_frequency * _ratio((self.power * energy).sum(axis=0), energy.sum(axis=0))
        )

    def _shares(self, X: F64) -> F64:
        """(2, n) energy of each column of X (N, n), and the same weighted like the second level."""
        spectrum, high = self._spectrum(X)
        shares = np.stack([np.ones_like(high), high]) @ np.abs(spectrum) ** 2
        return np.asarray(_ratio(shares, shares[0], 0.0) * (X**2).sum(axis=0))

    def _spectrum(self, X: F64) -> tuple[NDArray[np.complex128], F64]:
        """(F, n) spectra whose squares add up to the energies of X (N, n); (F,) the second level.

        They reach up to the cutoff.
        """
        f = _frequencies(len(X), self.rate)
        inside = f < self.cutoff
        both_sides = np.where(f[inside] > 0, 2.0, 1.0)[:, None]
        spectrum = np.fft.rfft(X, axis=0)[inside] * np.sqrt(both_sides / len(X))
        return spectrum, (f[inside] / self.cutoff) ** 4


def _frequencies(n: int, rate: float) -> F64:
    return np.asarray(np.fft.rfftfreq(n, 1 / rate), dtype=np.float64)


def _ratio(x: F64, energy: F64, otherwise: float = 1.0) -> F64:
    """``x / energy``, and ``otherwise`` where there is no energy."""
    out: F64 = np.divide(x, energy, out=np.full(x.shape, otherwise), where=energy > 0)
    return out


def _clipped(factor: F64) -> F64:
    return np.asarray(np.clip(factor, 1 / _AT_MOST, _AT_MOST))


def _spectra(shape: F64, power: F64) -> F64:
    """Non-negative levels (U, 2) of spectra ``a + b shape``, by iterated weighting.

    Args:
        shape: (F,) what the second level multiplies.
        power: (U, F) periodograms; their scatter is proportional to the spectrum.
    """
    average = np.maximum(power.mean(axis=1, keepdims=True), 1e-300)
    # A few bins may all be small by chance, and what they stand for would count as exact: one more,
    # which has the average, keeps the level plausible. It loses its weight where there are many.
    power = np.concatenate([np.ones_like(average), power / average], axis=1)
    shape = np.concatenate([[0.0], shape])
    trust = np.where(np.arange(len(shape)) > 0, 1.0, 0.5 / len(shape))
    model = np.ones_like(power)
    for _ in range(4):
        w = trust / model**2
        aa, ab, bb = w.sum(axis=1), w @ shape, w @ shape**2
        ay, by = (w * power).sum(axis=1), (w * power) @ shape
        determinant = np.maximum(aa * bb - ab * ab, 1e-300)
        a, b = (bb * ay - ab * by) / determinant, (aa * by - ab * ay) / determinant
        # Where one level would be negative, the other stands alone: the one that gains more.
        flat = ay**2 * bb >= by**2 * aa
        alone = (a < 0) | (b < 0)
        a = np.where(alone, np.where(flat, ay / aa, 0.0), a)
        b = np.where(alone, np.where(flat, 0.0, by / bb), b)
        model = np.maximum(a[:, None] + b[:, None] * shape, 1e-3)
    return np.asarray(np.stack([a, b], axis=1) * average)
