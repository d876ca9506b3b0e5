"""Gravity as SUs feel it at rest and in slow motion, and chains of joints that explain it.

No patterns and no moves of single joints are asked for: a reading averaged over a rest, or over a
moment of a move, is gravity seen in the SU's frame, off by what accelerations can make of it::

    y = (I + S) R^T Rot(k_m, -q_m) .. Rot(k_1, -q_1) x + b

with x the upward gravity in the frame of a segment whose motion is known, k the axes of the
joints beyond it, R the SU's orientation on the last one, and S, b its scale, cross-axis and bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int, frozen
from skin2urdf.geometry.so3 import axis_rotation, cross, rotation_exp, skew, wahba
from skin2urdf.signals.encoder_noise import EncoderNoise
from skin2urdf.signals.filters import (
    filtered,
    first_derivative,
    low_pass,
    second_derivative,
)
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled, static_moves

_STEADY = 0.02
"""Standard deviation [m/s^2] of gravity at rest that no average takes away: 2 mg, by which the
bias of MEMS sensors wanders within minutes, and which 2 mrad of play in joints make."""
_LEVER = 0.5
"""Lever arm [m] by which accelerations of joints are felt before any is known: that of an arm."""
_LAG = 0.03
"""Standard deviation [s] of what the SUs' clocks, buses and filters lag the joints'."""
_WINDOW = 0.2
"""Length of a moment of a move [s]: readings averaged over it hold nothing above 2 Hz."""
_SLOW = 2.5
"""Cutoff [Hz] of the joints' motion from which accelerations in such a window are judged: what an
encoder rounds is differentiated no further than that."""
_MOST_WINDOWS = 120
"""Windows looked at; the rest of a long log would only repeat what the steadiest ones say."""
PRIOR = np.array([0.5] * 3 + [0.03] * 3 + [0.01] * 3)
"""Standard deviations of bias [m/s^2], scale and cross-axis errors of common accelerometers."""
SHAPE_INDEX = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@dataclass(frozen=True, eq=False)
class GravityWindows:
    """Readings of gravity in W windows of rest or slow motion.

    Attributes:
        dof_names: D DoF names.
        su_names: U SU names.
        q: (W, D) mean joint positions [rad or m].
        log: (W,) index of the log.
        reading: (W, U, 3) mean readings [m/s^2]; 0 where an SU was not heard.
        sd: (W, U) what gravity's share of them may be off by, per axis [m/s^2]; infinite where an
            SU was not heard.
    """

    dof_names: tuple[str, ...]
    su_names: tuple[str, ...]
    q: F64
    log: Int
    reading: F64
    sd: F64

    def __post_init__(self) -> None:
        for name in ("q", "reading", "sd"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "log", frozen(self.log, np.int64))

    @property
    def weight(self) -> F64:
        """(W, U) inverse variances [s^4/m^2]; 0 where an SU was not heard."""
        return np.asarray(1.0 / self.sd**2)

    def some(self, which: Int) -> GravityWindows:
        """Only some of the windows."""
        return GravityWindows(
            self.dof_names, self.su_names, self.q[which], self.log[which], self.reading[which],
            self.sd[which],
        )  # fmt: skip


def gravity_windows(
    sampled: Sequence[Sampled], su_names: Sequence[str], most: int = _MOST_WINDOWS
) -> GravityWindows:
    """Windows of all logs in which readings are mostly gravity, the steadiest ones.

    Args:
        sampled: the logs on their grids, with the same joints and SUs.
        su_names: U SU names.
        most: number of windows kept at most.
    """
    q, log, reading, variance = [], [], [], []
    for g, s in enumerate(sampled):
        rate = s.motion.grid.rate
        smooth = filtered(s.motion.q, low_pass(_SLOW, rate))
        qd, qdd = first_derivative(smooth, rate), second_derivative(smooth, rate)
        for begin, end, rests in _intervals(s):
            n = end - begin
            part = slice(begin, end)
            valid = s.valid[part].mean(axis=0) > 0.5
            weights = s.valid[part, :, None] / np.maximum(s.valid[part].sum(0), 1)[:, None]
            mean = (s.readings[part] * weights).sum(axis=0)
            spread = ((s.readings[part] - mean) ** 2 * weights).sum(axis=(0, 2)) / 3
            seconds = n / rate
            speed = np.abs(qd[part]).sum(axis=1)
            acceleration = np.abs(qdd[part]).sum(axis=1)
            if rests:
                # What rings or shakes averages out over its periods, half a second at most.
                error = spread / (1 + 2 * seconds)
            else:
                felt = _LEVER * float((acceleration + speed**2).mean())
                turning = np.linalg.norm(s.readings[end - 1] - s.readings[begin], axis=-1) / seconds
                error = felt**2 + (_LAG * turning) ** 2
            q.append(s.motion.q[part].mean(axis=0))
            log.append(g)
            reading.append(np.where(valid[:, None], mean, 0.0))
            variance.append(np.where(valid, error + _STEADY**2, np.inf))
    D, U = sampled[0].motion.q.shape[1], len(su_names)
    windows = GravityWindows(
        sampled[0].motion.dof_names, tuple(su_names), np.array(q).reshape(-1, D),
        np.array(log, dtype=np.int64), np.array(reading).reshape(-1, U, 3),
        np.sqrt(np.array(variance).reshape(-1, U)),
    )  # fmt: skip
    total = windows.weight.sum(axis=1)
    heard = np.flatnonzero(total > 0)
    steadiest = heard[np.argsort(-total[heard], kind="stable")[:most]]
    return windows.some(np.sort(steadiest))


def _intervals(s: Sampled) -> list[tuple[int, int, bool]]:
    """Grid intervals of rests, without their ends, and of the moments in between."""
    out: list[tuple[int, int, bool]] = []
    length = max(2, round(_WINDOW * s.motion.grid.rate))
    at = 0
    for rest in (*s.rests, None):
        stop = len(s.motion.q) if rest is None else rest.begin
        out += [
            (begin, begin + length, False)
            for begin in range(at, stop - length + 1, length)
            if s.motion.valid[begin : begin + length].all()
        ]
        if rest is not None:
            trim = min(12, (rest.end - rest.begin) // 4)
            out.append((rest.begin + trim, rest.end - trim, True))
            at = rest.end
    return out


def gravity_features(windows: GravityWindows, sampled: Sequence[Sampled]) -> Features:
    """The windows as features of poses without patterns: ``f0`` is all that was measured.

    Args:
        windows: the measurements.
        sampled: the logs that they come from.
    """
    W, U = windows.sd.shape
    n = 1 + 2 * len(windows.dof_names)
    coefficients = np.zeros((W, U, n, 3))
    coefficients[:, :, 0] = windows.reading
    only_gravity = np.zeros((1, n, n))
    only_gravity[0, 0, 0] = 1.0
    position_sd = np.array([np.where(s.motion.named, s.motion.noise, np.inf) for s in sampled])
    return Features(
        su_names=windows.su_names,
        dof_names=windows.dof_names,
        q=windows.q,
        log=windows.log,
        coefficients=coefficients,
        information=Information.of_products(only_gravity, np.zeros((W, U), dtype=np.int64)),
        noise=np.repeat(windows.sd[:, :, None], 3, axis=2),
        latency=np.zeros(U),
        latency_sd=np.full(U, np.inf),
        moves=static_moves(sampled),
        encoders=EncoderNoise(position_sd=position_sd[windows.log]),
    )


@dataclass(frozen=True, eq=False)
class GravityFits:
    """K fits of gravity beyond known segments, of chains of m joints each.

    Attributes:
        axes: (K, m, 3) axes of the joints at position zero, in the frame of the known segment
            (which is turned like the base at position zero).
        R: (K, 3, 3) orientation of the SU in the same frame.
        sensor: (K, 9) bias [m/s^2] and shape [1].
        chi2: (K,) chi-squared, that of the sensor's priors included.
    """

    axes: F64
    R: F64
    sensor: F64
    chi2: F64

    def one(self, k: int) -> GravityFits:
        """Only one of the fits."""
        return GravityFits(self.axes[k : k + 1], self.R[k : k + 1], self.sensor[k : k + 1],
                           self.chi2[k : k + 1])  # fmt: skip


def turned(axis: F64, q: F64, x: F64) -> F64:
    """Vectors x (..., N, 3) of a segment seen beyond a joint: ``Rot(axis, -q) x``.

    Args:
        axis: (..., 3) unit axis.
        q: (..., N) positions [rad].
        x: the vectors.
    """
    c, s = np.cos(q)[..., None], np.sin(q)[..., None]
    k = np.broadcast_to(axis[..., None, :], x.shape)
    along = (k * x).sum(axis=-1, keepdims=True)
    return np.asarray(c * x - s * cross(k, x) + (1 - c) * along * k)


def fit_gravity(
    q: F64, x: F64, y: F64, weight: F64, axes: F64, iterations: int = 12
) -> GravityFits:
    """Fit chains of m joints by Gauss-Newton, many at once.

    Args:
        q: (K, N, m) positions of the joints [rad].
        x: (K, N, 3) upward gravity in the known segment's frame [m/s^2].
        y: (K, N, 3) readings [m/s^2].
        weight: (K, N) inverse variances.
        axes: (K, m, 3) axes to begin from.
        iterations: number of steps at most.
    """
    K, _, m = q.shape
    root = np.sqrt(weight)
    sensor = np.zeros((K, 9))
    z = x
    for i in range(m):
        z = turned(axes[:, i], q[..., i], z)
    gamma = _centring(weight)
    R, _ = wahba(_centred(y, weight, gamma), _centred(z, weight, gamma), weight)
    r, J = _linearised(q, x, y, root, axes, R, sensor)
    cost = np.einsum("kn,kn->k", r, r)
    damping = np.full(K, 1e-4)
    n = J.shape[-1]
    for _ in range(iterations):
        H = np.swapaxes(J, 1, 2) @ J
        g = (np.swapaxes(J, 1, 2) @ r[..., None])[..., 0]
        scale = np.maximum(np.einsum("kii->ki", H), 1e-9)
        H += (damping[:, None] * scale)[..., None] * np.eye(n)
        step = np.asarray(-np.linalg.solve(H, g[..., None])[..., 0])
        trial_axes = np.stack(
            [
                (rotation_exp((tangent(axes[:, i]) @ step[:, 2 * i : 2 * i + 2, None])[..., 0])
                 @ axes[:, i, :, None])[..., 0]
                for i in range(m)
            ],
            axis=1,
        ) if m else axes  # fmt: skip
        trial_R = R @ rotation_exp(step[:, 2 * m : 2 * m + 3])
        trial_sensor = sensor + step[:, 2 * m + 3 :]
        trial_r, trial_J = _linearised(q, x, y, root, trial_axes, trial_R, trial_sensor)
        trial_cost = np.einsum("kn,kn->k", trial_r, trial_r)
        better = trial_cost < cost
        axes = np.where(better[:, None, None], trial_axes, axes)
        R = np.where(better[:, None, None], trial_R, R)
        sensor = np.where(better[:, None], trial_sensor, sensor)
        r = np.where(better[:, None], trial_r, r)
        J = np.where(better[:, None, None], trial_J, J)
        gain = float(np.max((cost - trial_cost) / np.maximum(cost, 1e-300), initial=0.0))
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, damping / 10, damping * 10)
        if gain < 1e-4 and bool((damping < 1e2).all()):
            break
    return GravityFits(axes, R, sensor, cost)


def _centring(weight: F64) -> F64:
    """(...) share of its mean that a series keeps no longer once its bias is anyone's guess."""
    return np.asarray(1 - 1 / np.sqrt(1 + weight.sum(axis=-1) * PRIOR[0] ** 2))


def _centred(v: F64, weight: F64, gamma: F64) -> F64:
    """Vectors (..., N, 3) less the share gamma (...) of their mean."""
    total = np.maximum(weight.sum(axis=-1), 1e-300)[..., None, None]
    mean = (weight[..., None] * v).sum(axis=-2, keepdims=True) / total
    return np.asarray(v - gamma[..., None, None] * mean)


def tangent(k: F64) -> F64:
    """(K, 3, 2) orthonormal bases of the planes perpendicular to k (K, 3)."""
    flat = np.argmin(np.abs(k), axis=1)
    a = cross(k, np.eye(3)[flat])
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    return np.stack([a, cross(k, a)], axis=2)


def _linearised(
    q: F64, x: F64, y: F64, root: F64, axes: F64, R: F64, sensor: F64
) -> tuple[F64, F64]:
    """Weighted residuals (K, 3 N + 9) and their Jacobian in axes, rotation, bias and shape."""
    K, N, m = q.shape
    z = x
    slopes: list[F64] = []
    for i in range(m):
        before, k = z, axes[:, i]
        z = turned(k, q[..., i], before)
        Rt = np.swapaxes(axis_rotation(k[:, None], q[..., i]), -1, -2)
        slopes = [Rt @ slope for slope in slopes]
        # Turning k by delta: exp(delta) Rot exp(-delta).
        slopes.append((Rt @ skew(before) - skew(z)) @ tangent(k)[:, None])
    Rt = np.swapaxes(R, 1, 2)[:, None]
    g = (Rt @ z[..., None])[..., 0]
    M = np.tile(np.eye(3), (K, 1, 1))
    by_shape = np.zeros((K, N, 3, 6))
    for c, (a, b) in enumerate(SHAPE_INDEX):
        M[:, a, b] += sensor[:, 3 + c]
        by_shape[:, :, a, c] += g[..., b]
        if a != b:
            M[:, b, a] += sensor[:, 3 + c]
            by_shape[:, :, b, c] += g[..., a]
    predicted = (M[:, None] @ g[..., None])[..., 0] + sensor[:, None, :3]
    columns = [M[:, None] @ (Rt @ slope) for slope in slopes]
    columns += [M[:, None] @ skew(g), np.broadcast_to(np.eye(3), (K, N, 3, 3)), by_shape]
    J = np.concatenate(columns, axis=-1) * root[..., None, None]
    r = (predicted - y) * root[..., None]
    prior = np.zeros((K, 9, J.shape[-1]))
    prior[:, np.arange(9), J.shape[-1] - 9 + np.arange(9)] = 1 / PRIOR
    return (
        np.concatenate([r.reshape(K, -1), sensor / PRIOR], axis=1),
        np.concatenate([J.reshape(K, 3 * N, -1), prior], axis=1),
    )


def axis_losses(q: F64, x: F64, y: F64, weight: F64, axes: F64) -> F64:
    """Chi-squared of many axes of one joint for many SUs, orientation and bias eliminated.

    Args:
        q: (N,) positions of the joint [rad].
        x: (N, 3) upward gravity in the known segment's frame [m/s^2].
        y: (N, U, 3) readings [m/s^2].
        weight: (N, U) inverse variances.
        axes: (K, 3) candidate axes.

    Returns:
        (U, K) chi-squared; sensors without scale and cross-axis errors.
    """
    N, U = weight.shape
    K = len(axes)
    z = turned(axes, np.broadcast_to(q, (K, N)), np.broadcast_to(x, (K, N, 3)))
    w = weight.T
    total = np.maximum(w.sum(axis=1), 1e-300)
    gamma = _centring(w)
    kept = (2 * gamma - gamma**2) * total
    wy = w[..., None] * y.transpose(1, 0, 2)
    flat = z.transpose(1, 0, 2).reshape(N, -1)
    B = (wy.transpose(0, 2, 1).reshape(-1, N) @ flat).reshape(U, 3, K, 3).transpose(0, 2, 1, 3)
    mean_z = (w @ flat).reshape(U, K, 3) / total[:, None, None]
    mean_y = wy.sum(axis=1) / total[:, None]
    B = B - (kept[:, None, None] * mean_y[:, None])[..., None] * mean_z[..., None, :]
    power = (w * ((y**2).sum(axis=-1).T + (x**2).sum(axis=-1))).sum(axis=1)
    power = power - kept * (mean_y**2).sum(axis=-1)
    total_power = power[:, None] - kept[:, None] * (mean_z**2).sum(axis=-1)
    return np.asarray(np.maximum(total_power - 2 * _best_alignment(B, 0.5 * total_power), 0.0))


def _best_alignment(B: F64, bound: F64) -> F64:
    """(...) largest trace of B R over all rotations R, for B (..., 3, 3), from an upper bound.

    The largest root of Davenport's quartic by Newton's method (Markley's FOAM).
    """
    a, b, c = B[..., 0, :], B[..., 1, :], B[..., 2, :]
    norm2 = (B * B).sum(axis=(-2, -1))
    bc, ca, ab = cross(b, c), cross(c, a), cross(a, b)
    det = (a * bc).sum(axis=-1)
    adjugate2 = (bc * bc + ca * ca + ab * ab).sum(axis=-1)
    top = np.maximum(bound, 1e-300)
    for _ in range(12):
        left = top**2 - norm2
        value = left**2 - 8 * top * det - 4 * adjugate2
        slope = 4 * top * left - 8 * det
        top = top - value / np.where(np.abs(slope) > 1e-300, slope, np.inf)
    return np.asarray(top)


def fibonacci_sphere(n: int) -> F64:
    """(n, 3) nearly uniform unit vectors."""
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    azimuth = np.pi * (1 + np.sqrt(5)) * i
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=1)
