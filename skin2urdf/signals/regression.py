"""Linear regression of the readings around one pose on the motion of all joints.

For one joint moving far the reading is exactly ``a + b cos(dq) + c sin(dq) + tau qdd + e qd^2``
with constant vectors, so the regressors of a DoF are ``sin dq`` (coefficient s), ``qdd``
(coefficient tau), and the nuisances ``1 - cos dq`` and ``qd^2``. What joints moving together add at
second order (gravity turned by two of them, Coriolis terms) stays in the residual at first; with a
model at hand the whole remainder beyond first order is predicted and subtracted (``curvature``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import j1

from skin2urdf.arrays import F64, Bool

_SIGNAL_TO_NOISE = 30.0
"""Energy of a regressor over its encoder noise below which it counts as not excited."""


@dataclass(frozen=True, eq=False)
class Design:
    """Regressors around one pose, filtered.

    Attributes:
        X: (N, n) regressors of the features, n = 1 + 2 D; columns that are not excited are zero.
        nuisance: (N, k) further regressors, to be projected out.
        noise: (n,) variance of the encoder noise in each column.
        noise_cross: (D,) covariance of the encoder noise in dq and qdd of each DoF.
    """

    X: F64
    nuisance: F64
    noise: F64
    noise_cross: F64


@dataclass(frozen=True, eq=False)
class Fit:
    """Coefficients of several SUs that share valid samples.

    Attributes:
        coefficients: (U, n, 3).
        information: (n, n) regressor products, per independent sample.
        residual: (N, U, 3) what the regressors leave [m/s^2].
        deviation: (U, 3) standard deviation of one independent sample [m/s^2].
    """

    coefficients: F64
    information: F64
    residual: F64
    deviation: F64


def excited(X: F64, noise: F64) -> F64:
    """X (N, n) with columns set to zero whose variation does not stand out from encoder noise."""
    energy = X.var(axis=0)
    n_dofs = (X.shape[1] - 1) // 2
    smallest = np.r_[0.0, np.full(n_dofs, 1e-10), np.full(n_dofs, 1e-6)]
    quiet = energy <= np.maximum(_SIGNAL_TO_NOISE * noise, smallest)
    # Without its acceleration, a DoF's position would stand for both.
    quiet[1 : 1 + n_dofs] |= quiet[1 + n_dofs :]
    quiet[0] = False
    return np.asarray(np.where(quiet, 0.0, X))


def fit(design: Design, y: F64, independence: float) -> Fit:
    """Least squares with nuisances projected out and encoder noise allowed for.

    Encoder noise in a regressor adds its variance to the regressor's energy and so shrinks the
    coefficient; the known variance is taken off again (corrected least squares).

    Args:
        design: the regressors.
        y: (N, U, 3) filtered readings.
        independence: independent samples per sample of the low-passed signals, at most 1.
    """
    N, n = design.X.shape
    U = y.shape[1]
    Y = y.reshape(N, U * 3)
    Z = np.concatenate([design.X, design.nuisance], axis=1)
    scale = np.sqrt((Z**2).sum(axis=0))
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    noise = np.concatenate([design.noise * N, np.zeros(design.nuisance.shape[1])])
    noise = np.where(scale > 0, noise, 0.0)
    Zs = Z * inverse
    products = Zs.T @ Zs
    corrected = products - np.diag(noise * inverse**2)
    D = len(design.noise_cross)
    slope, lever = 1 + np.arange(D), 1 + D + np.arange(D)
    shared = design.noise_cross * N * inverse[slope] * inverse[lever]
    corrected[slope, lever] -= shared
    corrected[lever, slope] -= shared
    lam, V = _eigen(corrected)
    keep = lam > 1e-8
    solve = (V[:, keep] / lam[keep]) @ V[:, keep].T
    corrected = (V[:, keep] * lam[keep]) @ V[:, keep].T
    solution = (solve @ (Zs.T @ Y)) * inverse[:, None]
    residual = Y - Z @ solution
    rank = int(keep.sum())
    independent = max(N * independence - rank, 1.0)
    # Errors over a deviation that few samples gave are those of Student's t.
    variance = (residual**2).sum(axis=0) * independence / max(independent - 2.0, independent / 3)
    a, b = corrected[:n, :n], corrected[:n, n:]
    if b.shape[1]:
        mu, W = _eigen(corrected[n:, n:])
        ok = mu > 1e-8
        a = a - (b @ W[:, ok] / mu[ok]) @ (b @ W[:, ok]).T
    information = a * scale[:n, None] * scale[:n] * independence
    return Fit(
        solution[:n].reshape(n, U, 3).transpose(1, 0, 2),
        information,
        residual.reshape(N, U, 3),
        np.sqrt(variance.reshape(U, 3)),
    )


def _eigen(A: F64) -> tuple[F64, F64]:
    """Eigenvalues (k,) and vectors (n, k) of a symmetric matrix (n, n), without its empty rows."""
    used = np.flatnonzero(np.diag(A) != 0)
    lam, V = np.linalg.eigh(A[np.ix_(used, used)])
    whole = np.zeros((len(A), len(used)))
    whole[used] = V
    return lam, whole


_LARGEST = (9.81, 1.0)
"""What slopes s [m/s^2/rad] and lever arms tau [m] may be; gravity bounds the former."""


def informative(X: F64, found: Fit) -> F64:
    """X (N, n) with columns set to zero that a fit tells nothing of.

    A joint that comes to rest moves by a milliradian in the samples of several rests at one pose.
    With fine encoders that counts as excited, but it hardly differs from a constant, and the
    coefficients, gravity's among them, come out as large numbers that cancel. What is worse known
    than nature bounds it is better predicted from the rest than fitted.
    """
    used = X.any(axis=0)
    size = np.sqrt(np.diag(found.information)[used])
    lam, V = np.linalg.eigh(found.information[np.ix_(used, used)] / size / size[:, None])
    deviation = np.full(X.shape[1], np.inf)
    deviation[used] = np.sqrt((V**2 / np.maximum(lam, 1e-12)).sum(axis=1)) / size
    D = (X.shape[1] - 1) // 2
    useless = deviation * np.median(found.deviation) > np.r_[np.inf, np.repeat(_LARGEST, D)]
    # Without its acceleration, a DoF's position would stand for both.
    useless[1 : 1 + D] |= useless[1 + D :]
    return np.asarray(np.where(useless, 0.0, X))


def orthonormal(Z: F64) -> F64:
    """(N, r) orthonormal basis of what the columns of Z (N, k) that are not zero span."""
    basis, _ = np.linalg.qr(Z[:, np.einsum("ni,ni->i", Z, Z) > 0])
    return np.asarray(basis)


def noise_by_row(
    X: F64, basis: F64, residual: F64, rate: float, cutoff: float, independence: float
) -> F64:
    """Noise power that each regressor meets, relative to the mean over all samples.

    Residuals are neither white nor steady: what the encoders' rounding adds grows with the fourth
    power of frequency, and only while a joint moves. A coefficient sees the noise at the
    frequencies and times of its own regressor, so its variance is that of ordinary least squares
    times ``sum |X(f)|^2 S(f) / sum |X(f)|^2`` and the same over time (White 1980).

    Args:
        X: (N, n) filtered regressors; zero columns get 1.
        basis: (N, r) orthonormal basis of all regressors, nuisances included.
        residual: (N, U, 3) residuals.
        rate: samples per second [Hz].
        cutoff: of the low-pass [Hz].
        independence: independent samples per sample.

    Returns:
        (U, n) factors.
    """
    N, U, _ = residual.shape
    f = np.asarray(np.fft.rfftfreq(N, 1 / rate), dtype=np.float64)
    band = (f > 0.25) & (f < 0.9 * cutoff)
    power = (np.abs(np.fft.rfft(residual, axis=0)) ** 2).mean(axis=2)[band]
    level = _spectra((f[band] / cutoff) ** 4, power.T)
    X_power = np.abs(np.fft.rfft(X, axis=0)) ** 2
    inside = f < 0.9 * cutoff
    shape = np.stack([np.ones(int(inside.sum())), (f[inside] / cutoff) ** 4], axis=1)
    share = X_power[inside].T @ shape
    total = X_power[inside].sum(axis=0)
    by_frequency = np.divide(level @ share.T, total, out=np.ones((U, len(total))), where=total > 0)
    by_frequency /= np.maximum(power.mean(axis=0), 1e-300)[:, None]

    leverage = np.clip(np.einsum("ni,ni->n", basis, basis) / independence, 0.0, 0.8)
    squared = (residual**2).mean(axis=2) / (1 - leverage)[:, None]
    span = max(1, int(0.5 * rate))
    steady = uniform_filter1d(squared, span, axis=0, mode="nearest")
    energy = X**2
    sums = energy.sum(axis=0)
    by_time = np.divide(steady.T @ energy, sums, out=np.ones((U, len(sums))), where=sums > 0)
    by_time /= np.maximum(steady.mean(axis=0), 1e-300)[:, None]
    return np.asarray(np.clip(by_frequency * by_time, 1e-3, 1e3))


def _spectra(shape: F64, power: F64) -> F64:
    """Non-negative levels (U, 2) of spectra ``a + b shape``, by iterated weighting.

    Args:
        shape: (F,) what the second level multiplies.
        power: (U, F) periodograms; their scatter is proportional to the spectrum.
    """
    average = np.maximum(power.mean(axis=1, keepdims=True), 1e-300)
    power = power / average
    model = np.ones_like(power)
    for _ in range(4):
        w = 1 / model**2
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


def regressors(dq: F64, qd: F64, qdd: F64, linear: bool) -> tuple[F64, F64]:
    """Unfiltered regressors of the features (N, 1 + 2 D) and nuisances (N, k).

    Args:
        dq: (N, D) positions relative to the pose [rad or m].
        qd: (N, D) velocities.
        qdd: (N, D) accelerations.
        linear: True where the remainder beyond first order is subtracted from the readings.
    """
    one = np.ones((len(dq), 1))
    if linear:
        return np.concatenate([one, dq, qdd], axis=1), np.zeros((len(dq), 0))
    X = np.concatenate([one, np.sin(dq), qdd], axis=1)
    return X, np.concatenate([1 - np.cos(dq), qd**2], axis=1)


def hidden_motion(dq: F64, qdd: F64, resolution: F64) -> tuple[F64, F64]:
    """Motion that encoders round away in step with a DoF's pattern, relative to the pattern.

    While DoF d moves, others move along a little (coupling, sag). What rounding makes of such a
    motion repeats in every cycle and so does not average out (:func:`rounded_away`).

    Args:
        dq: (N, D) low-passed positions [rad or m].
        qdd: (N, D) low-passed accelerations.
        resolution: (D,) encoder steps [rad or m].

    Returns:
        (D, D) mean square hidden motion of joint e per mean square acceleration of DoF d, at
        [d, e], and (D,) squared angular frequencies of the patterns; 0 for DoFs that do not move.
    """
    energy = qdd**2
    total = energy.sum(axis=0)
    weight = np.divide(energy, total, out=np.zeros_like(energy), where=total > 0)
    while_moving = weight.T @ energy
    # A sine's fourth moment over its second is 3/4 of its squared amplitude.
    peak2 = np.diag(while_moving)[:, None] / 0.75
    moves = peak2 > 1e-6
    against = -((dq - dq.mean(axis=0)) * qdd).sum(axis=0)
    omega2 = np.divide(total, against, out=np.zeros_like(total), where=moves[:, 0] & (against > 0))
    peak = np.sqrt(while_moving / 0.75)
    along = np.divide(peak, omega2[:, None], out=np.zeros_like(peak), where=omega2[:, None] > 0)
    steps = np.divide(along, resolution, out=np.zeros_like(along), where=resolution > 0)
    hidden = rounded_away(steps) * resolution**2
    return np.divide(hidden, peak2, out=np.zeros_like(hidden), where=moves), omega2


def rounded_away(steps: F64) -> F64:
    """Mean square error of a sine's amplitude [steps^2] after rounding, by its amplitude [steps].

    Rounding is a Fourier series in the rounded value. Over all positions of the sine's middle
    between two steps, the error of its amplitude a has the mean square
    ``sum_n 2 J1(2 pi n a)^2 / (pi n)^2``, near 0.012 / a for many steps. Below a quarter of a step,
    where the amplitude itself can not be known, the largest error is taken.
    """
    n = np.arange(1, 9)
    series = 2 * j1(2 * np.pi * n * np.maximum(steps, 0.25)[..., None]) ** 2 / (np.pi * n) ** 2
    return np.asarray(series.sum(axis=-1))


def enough(samples: Bool, rate: float) -> bool:
    """Whether a pose has enough samples to be of use (a quarter of a second)."""
    return int(samples.sum()) >= 0.25 * rate
