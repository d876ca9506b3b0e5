"""All SUs around one pose: coefficients, what is known of them, and how far the SUs' clocks lag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.signals.coloured import Coloured
from skin2urdf.signals.filters import eroded, first_derivative
from skin2urdf.signals.information import Information
from skin2urdf.signals.regression import Design, Fit, enough, excited, fit, informative, orthonormal

_MODEL_NOISE = 3e-4
"""Error of interpolating and differentiating sampled signals [m/s^2]; a floor for the noise."""
_GREAT, _FELT = 3.0, 0.1
"""Noise without the regressors that samples do not tell apart, over that with them and in m/s^2,
from which there is too much motion for so few samples."""
_EDGE = 5
"""Samples by which a slope is taken from samples that are not used."""


@dataclass(frozen=True, eq=False)
class Samples:
    """What is recorded around one pose, low-passed.

    Attributes:
        X: (N, n) regressors of the features, n = 1 + 2 D.
        Z: (N, k) nuisances.
        y: (N, U, 3) readings [m/s^2].
        ok: (N, U) True for samples that can be used.
        expected: (n, U, 3) coefficients that a model predicts; 0 without one.
        noise: (n,) variances of encoder noise in the regressors, and (D,) covariances of those of
            position and acceleration.
        independence: independent samples per sample.
        rate: samples per second [Hz].
        cutoff: of the low-pass [Hz].
    """

    X: F64
    Z: F64
    y: F64
    ok: Bool
    expected: F64
    noise: tuple[F64, F64]
    independence: float
    rate: float
    cutoff: float


@dataclass(frozen=True, eq=False)
class PoseFit:
    """What samples around one pose say about U SUs.

    Attributes:
        coefficients: (U, n, 3) (see :class:`skin2urdf.signals.records.Features`).
        information: on them, of this pose alone.
        noise: (U, 3) standard deviation of an independent sample [m/s^2]; infinite for SUs that
            have too few samples.
        freedom: (U,) degrees of freedom of the noise.
        rests: (U,) True for SUs around which nothing moves.
        lag_numerator: (U,) change of each SU's latency that explains most, times the information
            on it [1/s].
        lag_denominator: (U,) that information [1/s^2].
    """

    coefficients: F64
    information: Information
    noise: F64
    freedom: F64
    rests: Bool
    lag_numerator: F64
    lag_denominator: F64


def pose_fit(s: Samples) -> PoseFit:
    """Fit all SUs around one pose; SUs with the same valid samples share one factorisation."""
    U, n = s.y.shape[1], s.X.shape[1]
    coefficients = np.zeros((U, n, 3))
    factors, which = [np.zeros((n, n))], np.zeros(U, np.int64)
    gain, weight = np.zeros((U, n)), np.zeros((U, n))
    noise, freedom = np.full((U, 3), np.inf), np.zeros(U)
    rests = np.zeros(U, dtype=bool)
    numerator, denominator = np.zeros(U), np.zeros(U)
    for members in _alike(s.ok):
        use = s.ok[:, members[0]]
        group = _fitted(s, use, members) if enough(use, s.rate) else None
        if group is None:
            continue
        found, Xe, Ze, felt = group
        basis = orthonormal(np.concatenate([Xe, Ze], axis=1))
        colour = Coloured.of(found.residual, basis, s.rate, s.cutoff, s.independence)
        nuisance = orthonormal(Ze)
        own = Xe - nuisance @ (nuisance.T @ Xe)
        G, gain[members] = colour.factored(found.information, own * np.sqrt(s.independence))
        which[members], weight[members] = len(factors), 1 / np.sqrt(colour.by_time(Xe))
        factors.append(G)
        coefficients[members] = found.coefficients
        noise[members] = np.hypot(found.deviation, _MODEL_NOISE)
        freedom[members], rests[members] = found.freedom, basis.shape[1] == 1
        across = _late(felt - found.residual, use, basis, s.rate)
        certain = 1 / noise[members] ** 2 / colour.by_su(across)[:, None]
        numerator[members] = -np.einsum("nui,nui,ui->u", found.residual, across, certain)
        denominator[members] = np.einsum("nui,nui,ui->u", across, across, certain)
    information = Information(np.array(factors), which[None], gain[None], weight[None])
    return PoseFit(
        coefficients, information, noise, freedom, rests,
        numerator * s.independence, denominator * s.independence,
    )  # fmt: skip


def _alike(ok: Bool) -> Iterator[Int]:
    """Numbers of the SUs that share their valid samples (N, U), group by group."""
    groups: dict[bytes, list[int]] = {}
    for u, column in enumerate(ok.T):
        groups.setdefault(column.tobytes(), []).append(u)
    yield from map(np.array, groups.values())


def _fitted(s: Samples, use: Bool, members: Int) -> tuple[Fit, F64, F64, F64] | None:
    """Fit of some SUs on some samples, regressors and nuisances that it has, readings it is of.

    None where there is too much motion for so few samples.
    """
    Xe = excited(s.X[use], s.noise[0])
    Ze, felt = _regressed(s, Xe, use, members)
    found = fit(Design(Xe, Ze, *s.noise), felt, s.independence)
    known = informative(Xe, found)
    if (known.any(axis=0) == Xe.any(axis=0)).all():
        return found, Xe, Ze, felt
    Ze, felt = _regressed(s, known, use, members)
    less = fit(Design(known, Ze, *s.noise), felt, s.independence)
    if (less.deviation > np.hypot(_GREAT * found.deviation, _FELT)).any():
        return None
    return less, known, Ze, felt


def _regressed(s: Samples, Xe: F64, use: Bool, members: Int) -> tuple[F64, F64]:
    """Nuisances (N, k) and readings (N, U, 3) to fit, for the columns Xe (N, n) that are kept."""
    D = (Xe.shape[1] - 1) // 2
    # A DoF that keeps still adds nothing at second order: its nuisances would only fit noise.
    moves = np.asarray(Xe[:, 1 + D :].any(axis=0))
    kept = s.Z[use] * np.tile(moves, s.Z.shape[1] // max(1, D))
    # Motion too small to be fitted, as of a joint that settles, is felt all the same.
    left_out = s.X[use] - Xe
    return kept, s.y[use][:, members] - np.tensordot(left_out, s.expected[:, members], 1)


def _late(fitted: F64, use: Bool, basis: F64, rate: float) -> F64:
    """(N, U, 3) how fitted readings change with time, beside what the regressors explain.

    Args:
        fitted: (N, U, 3), of the samples that are used.
        use: (M,) True for these among all.
        basis: (N, r) orthonormal basis of the regressors.
        rate: samples per second [Hz].
    """
    whole = np.zeros((len(use), *fitted.shape[1:]))
    whole[use] = fitted
    slope = first_derivative(whole, rate)[use] * eroded(use, _EDGE)[use, None, None]
    flat = slope.reshape(len(slope), -1)
    return np.asarray((flat - basis @ (basis.T @ flat)).reshape(slope.shape))
