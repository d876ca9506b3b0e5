"""One joint after the other peeled off an SU's chain, from the SU inwards.

Seen from an SU, the axis of the last joint and its lever arm are the same in every pose. Once that
joint's motion is undone, the same holds for the next one, down to the base::

    s = f0 x k          tau = k x r          r = sum of offsets, each constant in its segment

so what is constant shows which joint comes next, along which axis, and in which sense it turns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.problem.blocks import FeatureBlocks
from skin2urdf.estimation.start.orientation import ROUGH_BIAS
from skin2urdf.geometry.so3 import axis_rotation, cross, skew

_SENSE_EVIDENCE = 30.0
"""Chi-squared difference below which both senses of an axis are kept as hypotheses."""
_SENSE_LEVER = 1.5
"""Gravity across an axis [m/s^2 rms] below which its sense is not taken from gravity's slope."""
_ROUGH_LEVER2 = 1e-8
"""Squared error of a lever arm [m^2] that peeled axes may cause."""
_RIDGE = 1e-9
"""Information, over a coefficient's own, that keeps the inverse of what was not excited finite."""
_ROUGH_SLOPE2 = 1e-4
"""The same of a slope [(m/s^2)^2]."""


@dataclass(frozen=True, eq=False)
class Readings:
    """One SU's Jacobian and gravity in the P poses in which it was heard, by the n joints before.

    Attributes:
        q: (P, n) positions of the joints.
        f0: (P, 3) gravity [m/s^2].
        s: (P, n, 3) slopes.
        tau: (P, n, 3) lever arms.
        var_s: (P, n) variances of the slopes; infinite where not measured.
        var_tau: (P, n) likewise of the lever arms.
        covariance: (P, n) of slope and lever arm, the same along all axes. A pure tone makes a
            joint's position and acceleration proportional, which shows little but a sum of both.
    """

    q: F64
    f0: F64
    s: F64
    tau: F64
    var_s: F64
    var_tau: F64
    covariance: F64

    @staticmethod
    def of(blocks: FeatureBlocks, su: int) -> Readings:
        """The readings of one SU, joints from the RS outwards."""
        ok = np.isfinite(blocks.noise[:, su]).all(axis=1)
        n, L = int(blocks.chains.length[su]), blocks.chains.joint.shape[1]
        y = blocks.coefficients[ok, su]
        noise2 = (blocks.noise[ok, su] ** 2).mean(axis=1)
        variance = blocks.variance[ok, su] * noise2[:, None]
        slopes, levers = np.arange(1, 1 + n), np.arange(1 + L, 1 + L + n)
        var_s, var_tau = variance[:, slopes], variance[:, levers]
        measured = np.isfinite(var_s) & np.isfinite(var_tau)
        size = np.sqrt(np.where(measured, var_s, 0.0) * np.where(measured, var_tau, 0.0))
        correlation = _correlations(blocks.W[ok, su])[:, slopes, levers]
        return Readings(
            q=blocks.q[ok][:, blocks.chains.joint[su, :n]],
            f0=y[:, 0],
            s=y[:, slopes],
            tau=y[:, levers],
            var_s=var_s,
            var_tau=var_tau,
            covariance=correlation * size,
        )


def _correlations(W: F64) -> F64:
    """(P, m, m) correlations of coefficients whose whitening matrices are W (P, m, m)."""
    information = np.swapaxes(W, -1, -2) @ W
    scale = np.sqrt(np.einsum("pii->pi", information))
    scale = np.where(scale > 0, scale, 1.0)
    unit = information / scale[:, :, None] / scale[:, None] + _RIDGE * np.eye(W.shape[-1])
    covariance = np.linalg.inv(unit)
    deviation = np.sqrt(np.einsum("pii->pi", covariance))
    return np.asarray(covariance / deviation[:, :, None] / deviation[:, None])


@dataclass(frozen=True, eq=False)
class Peeled:
    """An SU's chain with its outer joints undone.

    Attributes:
        R: (P, 3, 3) turns vectors from the SU's frame to the current segment's, both aligned at
            position zero.
        inner: rotations (P, 3, 3) from each peeled segment to the current one, the SU's first.
        slid: (P, 3) by how far the peeled sliding joints have moved the SU, in the current
            segment's frame [m].
    """

    R: F64
    inner: tuple[F64, ...]
    slid: F64

    @staticmethod
    def nothing(n_poses: int) -> Peeled:
        """No joint undone yet."""
        identity = np.broadcast_to(np.eye(3), (n_poses, 3, 3))
        return Peeled(identity, (identity,), np.zeros((n_poses, 3)))

    def beyond(self, axis: F64, q: F64, *, slides: bool) -> Peeled:
        """One more joint undone, with constant axis (3,) at positions q (P,)."""
        if slides:
            return Peeled(self.R, self.inner, self.slid + q[:, None] * axis)
        turn = axis_rotation(axis, q)
        identity = np.broadcast_to(np.eye(3), turn.shape)
        return Peeled(
            turn @ self.R,
            (*(turn @ E for E in self.inner), identity),
            (turn @ self.slid[..., None])[..., 0],
        )


@dataclass(frozen=True, eq=False)
class Candidate:
    """A joint as the outermost one that is not peeled yet.

    Attributes:
        axis: (3,) its constant axis in the current segment's frame.
        misfit: chi-squared of what is not constant.
        freedom: its degrees of freedom.
    """

    axis: F64
    misfit: float
    freedom: int

    @property
    def per_freedom(self) -> float:
        """Chi-squared per degree of freedom; infinite where nothing was measured."""
        return self.misfit / self.freedom if self.freedom else np.inf


@dataclass(frozen=True, eq=False)
class _Column:
    """One joint's column of an SU's Jacobian in the current segment's frame; (P, 3) and (P,)."""

    f0: F64
    s: F64
    tau: F64
    var_s: F64
    var_tau: F64
    covariance: F64

    @staticmethod
    def of(readings: Readings, joint: int, peeled: Peeled) -> _Column:
        f0, s, tau = (
            (peeled.R @ y[..., None])[..., 0]
            for y in (readings.f0, readings.s[:, joint], readings.tau[:, joint])
        )
        var_s, var_tau = readings.var_s[:, joint], readings.var_tau[:, joint]
        return _Column(f0, s, tau, var_s, var_tau, readings.covariance[:, joint])

    def lever(self, slope: F64, slope_error: float) -> tuple[F64, F64]:
        """Lever arms (P, 3) and their weights (P,) where the slope (P, 3) is known as well.

        What the measured slope is off tells of the lever arm's error, for they are correlated.
        """
        both, seen = np.isfinite(self.var_s), np.isfinite(self.var_tau)
        spread = np.where(both, self.var_s, 1.0) + slope_error**2
        gain = np.where(both, self.covariance / spread, 0.0)
        rest = np.where(seen, self.var_tau, 1.0) - gain * self.covariance
        weight = np.where(seen, 1 / np.sqrt(np.maximum(rest, 0.0) + _ROUGH_LEVER2), 0.0)
        return self.tau + gain[:, None] * (slope - self.s), weight


def candidates(readings: Readings, joint: int, peeled: Peeled, *, slides: bool) -> list[Candidate]:
    """How constant a joint is, the best sense of its axis first; one where gravity shows it.

    Args:
        readings: of the SU.
        joint: index of the joint in the SU's chain.
        peeled: the joints beyond it, undone.
        slides: whether it is prismatic.
    """
    column = _Column.of(readings, joint, peeled)
    if not np.isfinite(column.var_tau).any():
        return [Candidate(np.array([0.0, 0.0, 1.0]), np.inf, 0)]
    if slides:
        push, w = column.lever(np.zeros_like(column.s), 0.0)
        k = (push * w[:, None] ** 2).sum(axis=0)
        return [_sliding(column, k / np.linalg.norm(k))]
    axes = constant_axis(
        column.f0, column.s, column.tau, column.var_s, column.var_tau, column.covariance
    )
    found = [(_turning(column, peeled, k), against) for k, against in axes]
    return [replace(c, misfit=c.misfit + against) for c, against in found]


def misfit_of(readings: Readings, axes: F64, prismatic: Bool) -> float:
    """Chi-squared of all lever arms of an SU's chain for given axes.

    Args:
        readings: of the SU.
        axes: (n, 3) axes of its chain at position zero, in its frame.
        prismatic: (n,) True for prismatic joints.
    """
    peeled, total = Peeled.nothing(len(readings.q)), 0.0
    for i in reversed(range(len(axes))):
        column, slides = _Column.of(readings, i, peeled), bool(prismatic[i])
        of = _sliding(column, axes[i]) if slides else _turning(column, peeled, axes[i])
        peeled = peeled.beyond(axes[i], readings.q[:, i], slides=slides)
        total += of.misfit
    return total


def _sliding(column: _Column, k: F64) -> Candidate:
    """A prismatic joint along an axis: it pushes by the axis itself."""
    push, w = column.lever(np.zeros_like(column.s), 0.0)
    misfit = float((((push - k) * w[:, None]) ** 2).sum())
    return Candidate(k, misfit, max(1, 3 * int((w > 0).sum()) - 2))


def _turning(column: _Column, peeled: Peeled, k: F64) -> Candidate:
    """A revolute joint about an axis, offsets of the segments beyond it as fits best."""
    both = np.isfinite(column.var_s)
    lever, w = column.lever(cross(column.f0, k[None]), ROUGH_BIAS)
    ws = np.where(both, 1 / np.sqrt(np.where(both, column.var_s, 1.0) + _ROUGH_SLOPE2), 0.0)
    across = np.concatenate([skew(k) @ E for E in peeled.inner], axis=2) * w[:, None, None]
    A = across.reshape(-1, across.shape[2])
    b = ((lever - cross(k[None], peeled.slid)) * w[:, None]).reshape(-1)
    offsets, _, rank, _ = np.linalg.lstsq(A, b, rcond=1e-6)
    misfit = float(np.sum((A @ offsets - b) ** 2) + np.sum(((column.s @ k) * ws) ** 2))
    freedom = 3 * int((w > 0).sum()) + int(both.sum()) - int(rank) - 2
    return Candidate(k, misfit, max(1, freedom))


def constant_axis(
    f0: F64, s: F64, tau: F64, var_s: F64, var_tau: F64, covariance: F64
) -> list[tuple[F64, float]]:
    """The axis that is constant in all poses; both senses where the data leave it open.

    Minimises the misfit of ``s = f0 x k`` and of ``s . k = tau . k = 0`` over unit vectors k.

    Returns:
        Axes (3,), and the chi-squared that speaks against each, beside the first.
    """
    w_s = np.where(np.isfinite(var_s), 1 / np.maximum(var_s, 1e-300), 0.0)
    # What s and tau have in common is taken off tau, so that the two are independent.
    lever = tau - (covariance * w_s)[:, None] * s
    rest = var_tau - covariance**2 * w_s
    w_tau = np.where(np.isfinite(var_tau), 1 / np.maximum(rest, 1e-9 * var_tau), 0.0)
    w_rough = np.where(w_s > 0, 1 / (np.where(w_s > 0, var_s, 0.0) + ROUGH_BIAS**2), 0.0)
    S = skew(f0)
    A = np.einsum("p,pi,pj->ij", w_s, s, s) + np.einsum("p,pi,pj->ij", w_tau, lever, lever)
    A += np.einsum("p,pji,pjk->ik", w_rough, S, S)
    b = np.einsum("p,pji,pj->i", w_rough, S, s)
    k = _least_on_sphere(A, b)
    across = np.sqrt(np.mean(np.sum(cross(f0, k[None]) ** 2, axis=-1)))
    against = 4 * float(b @ k)
    certain = against > _SENSE_EVIDENCE and across > _SENSE_LEVER
    return [(k, 0.0)] if certain else [(k, 0.0), (-k, against)]


def _least_on_sphere(A: F64, b: F64) -> F64:
    """Unit vector k that minimises ``k.A.k - 2 b.k`` (secular equation of the multiplier)."""
    lam, Q = np.linalg.eigh(A)
    beta = Q.T @ b
    size = float(np.linalg.norm(beta))
    if size <= 1e-12 * max(float(lam[2]), 1e-300) or abs(beta[0]) < 1e-9 * size:
        k = Q[:, 0]
        return np.asarray(k if b @ k >= 0 else -k)

    def excess(shift: float) -> float:
        return float(np.sum((beta / (lam - lam[0] + shift)) ** 2) - 1.0)

    low = abs(beta[0]) * (1 - 1e-12)
    shift = brentq(excess, min(low, size) * 1e-3, size * 1.0001, xtol=1e-14 * size)
    k = Q @ (beta / (lam - lam[0] + shift))
    return np.asarray(k / np.linalg.norm(k))
