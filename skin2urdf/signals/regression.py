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

from skin2urdf.arrays import F64, Bool
from skin2urdf.geometry.units import GRAVITY

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
        freedom: degrees of freedom of each deviation.
    """

    coefficients: F64
    information: F64
    residual: F64
    deviation: F64
    freedom: float


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
    freedom = max(N * independence - rank, 1.0)
    variance = (residual**2).sum(axis=0) * independence / freedom
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
        freedom,
    )


def _eigen(A: F64) -> tuple[F64, F64]:
    """Eigenvalues (k,) and vectors (n, k) of a symmetric matrix (n, n), without its empty rows."""
    used = np.flatnonzero(np.diag(A) != 0)
    lam, V = np.linalg.eigh(A[np.ix_(used, used)])
    whole = np.zeros((len(A), len(used)))
    whole[used] = V
    return lam, whole


_LARGEST = (GRAVITY, 1.0)
"""What slopes s [m/s^2/rad] and lever arms tau [m] may be; gravity bounds the former."""


def informative(X: F64, found: Fit) -> F64:
    """X (N, n) with columns set to zero that a fit tells nothing of.

    A joint that comes to rest moves by a milliradian in the samples of several rests at one pose.
    With fine encoders that counts as excited, but it hardly differs from a constant, and the
    coefficients, gravity's among them, come out as large numbers that cancel. What is worse known
    than nature bounds it is better predicted from the rest than fitted.
    """
    # Few samples may leave nothing of a column beside the nuisances, or less than nothing.
    used = X.any(axis=0) & (np.diag(found.information) > 0)
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


def enough(samples: Bool, rate: float) -> bool:
    """Whether a pose has enough samples to be of use (a quarter of a second)."""
    return int(samples.sum()) >= 0.25 * rate
