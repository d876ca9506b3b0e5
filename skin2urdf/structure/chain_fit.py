"""Chains of joints that explain the gravity that an SU feels, and where there are moves, the rest.

All chains are fitted beyond a segment whose rotation is known. :func:`axis_losses` ranks many axes
of one joint by gravity alone; :func:`fit_gravity` fits any number of joints by Gauss-Newton, with
the offsets that accelerations of moves show where they are given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.geometry import series
from skin2urdf.geometry.so3 import cross, rotation_exp, wahba

PRIOR = np.array([0.5] * 3 + [0.03] * 3 + [0.02] * 3)
"""Standard deviations of bias [m/s^2], scale and cross-axis errors of common accelerometers."""
LEVER = 0.5
"""Standard deviation of an offset between joints [m], by which accelerations are felt before any is
known: that of an arm."""
LATE = 0.05
"""Standard deviation of what an SU's clock, bus and filter lag the joints' [s]."""
_AZIMUTHS = 8
"""Turns about gravity from which an orientation is fitted where readings tell more than gravity:
45 deg apart, from half of which Gauss-Newton converges."""
SHAPE_INDEX = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@dataclass(frozen=True, eq=False)
class GravityFits:
    """K fits of gravity beyond known segments, of chains of m joints each.

    Attributes:
        axes: (K, m, 3) axes of the joints at position zero, in the frame of the known segment
            (which is turned like the base at position zero).
        R: (K, 3, 3) orientation of the SU in the same frame.
        sensor: (K, 9) bias [m/s^2] and shape [1].
        chi2: (K,) chi-squared, that of the priors of sensors, offsets and clocks included.
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


def sensor_matrix(shape: F64) -> F64:
    """(..., 3, 3) what makes readings of what is felt, by shape (..., 6)."""
    M = np.broadcast_to(np.eye(3), (*shape.shape[:-1], 3, 3)).copy()
    for c, (a, b) in enumerate(SHAPE_INDEX):
        M[..., a, b] += shape[..., c]
        if a != b:
            M[..., b, a] += shape[..., c]
    return M


def fill_shape_columns(out: F64, g: F64) -> None:
    """Write what each number of an SU's shape makes of what it feels.

    Args:
        out: (..., 6, 3, N) zeros; filled.
        g: (..., 3, N) what it feels, in its own frame.
    """
    for c, (a, b) in enumerate(SHAPE_INDEX):
        out[..., c, a, :] = g[..., b, :]
        out[..., c, b, :] = g[..., a, :]


@dataclass(frozen=True, eq=False)
class Carried(Record):
    """How the known segments of K fits move in N samples, in their own frames.

    Attributes:
        omega: (K, 3, N) angular velocity [rad/s], and
        alpha: (K, 3, N) angular acceleration [rad/s^2].
        columns: (K, c, 3, N) what a metre of each offset up to the segment, and of one on it, adds
            to the specific force [1/s^2]; zero where a segment has fewer than others.
        qd: (K, m, N) velocities of the joints beyond it [rad/s], and
        qdd: (K, m, N) accelerations [rad/s^2].
        change: (K, 3, N) derivatives of the readings [m/s^3].
    """

    omega: F64
    alpha: F64
    columns: F64
    qd: F64
    qdd: F64
    change: F64

    def beyond(self, i: int, axis: F64, back: F64) -> Carried:
        """How what joint number ``i`` carries moves.

        Args:
            i: the joint.
            axis: (K, 3) its unit axis, in the segment's frame at position zero.
            back: (K, 3, 3, N) what of the segment is seen beyond it.
        """
        k = axis[..., None]
        qd, qdd = self.qd[:, i, None], self.qdd[:, i, None]
        alpha = self.alpha + k * qdd + series.cross(self.omega, k) * qd
        omega = self.omega + k * qd
        alpha, omega = series.applied(back, alpha), series.applied(back, omega)
        before = series.applied(back[:, None], self.columns)
        columns = np.concatenate([before, series.per_metre(omega, alpha)], axis=1)
        return replace(self, omega=omega, alpha=alpha, columns=columns)


def seen_beyond(axis: F64, q: F64) -> F64:
    """(..., 3, 3, N) what of a segment is seen beyond a joint at q (..., N) about axis (..., 3)."""
    return series.rotations(axis, -q)


def fit_gravity(
    q: F64,
    x: F64,
    y: F64,
    weight: F64,
    axes: F64,
    iterations: int = 12,
    carried: Carried | None = None,
    rough: F64 | None = None,
) -> GravityFits:
    """Fit chains of m joints by Gauss-Newton, many at once.

    Args:
        q: (K, m, N) positions of the joints [rad].
        x: (K, 3, N) upward gravity in the known segment's frame [m/s^2].
        y: (K, 3, N) readings [m/s^2].
        weight: (K, N) inverse variances.
        axes: (K, m, 3) axes to begin from.
        iterations: number of steps at most.
        carried: how the segments move, where offsets and clocks are fitted as well; else what they
            add to gravity is noise.
        rough: (K, N) inverse variances of readings as gravity alone, which offsets are not known
            to be in at first; None where ``weight`` is that.
    """
    K, m, _ = q.shape
    rough = weight if rough is None else rough
    root = np.sqrt(weight)
    offsets = 0 if carried is None else carried.columns.shape[1] + 3 * m + 1
    # Bias, scale and cross-axis errors; offsets of the chain from its beginning; the clock.
    known = np.concatenate([PRIOR, [LEVER] * (offsets - 1), [LATE]]) if offsets else PRIOR
    linear = np.zeros((K, 9 + offsets))
    z = x
    for i in range(m):
        z = series.applied(seen_beyond(axes[:, i], q[:, i]), z)
    gamma = _centring(rough)
    felt, seen = (_centred(v.swapaxes(1, 2), rough, gamma) for v in (y, z))
    R, _ = wahba(felt, seen, rough)
    data = q, x, y, root, carried
    if carried is not None:
        R = _azimuth(data, axes, R, linear, known, z.mean(axis=-1))
    r, J = _linearised(data, axes, R, linear)
    cost = _chi2(r, linear, known)
    damping = np.full(K, 1e-4)
    n, first = J.shape[1], 2 * m + 3
    for _ in range(iterations):
        H = J @ J.swapaxes(1, 2)
        g = (J @ r[..., None])[..., 0]
        H[:, range(first, n), range(first, n)] += known**-2
        g[:, first:] += linear / known**2
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
        trial_R = R @ rotation_exp(step[:, 2 * m : first])
        trial_linear = linear + step[:, first:]
        trial_r, trial_J = _linearised(data, trial_axes, trial_R, trial_linear)
        trial_cost = _chi2(trial_r, trial_linear, known)
        better = trial_cost < cost
        axes = np.where(better[:, None, None], trial_axes, axes)
        R = np.where(better[:, None, None], trial_R, R)
        linear = np.where(better[:, None], trial_linear, linear)
        r[better], J[better] = trial_r[better], trial_J[better]
        gain = float(np.max((cost - trial_cost) / np.maximum(cost, 1e-300), initial=0.0))
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, damping / 10, damping * 10)
        if gain < 1e-4 and bool((damping < 1e2).all()):
            break
    return GravityFits(axes, R, linear[:, :9], cost)


def _azimuth(data: _Data, axes: F64, R: F64, linear: F64, known: F64, upward: F64) -> F64:
    """Orientations (K, 3, 3), turned about what is upward in the mean as accelerations show them.

    An SU that gravity meets from one side all along shows nothing of that turn at rest.

    Args:
        data: what is fitted.
        axes: (K, m, 3) axes.
        R: (K, 3, 3) orientations as gravity has them.
        linear: (K, p) the rest to begin from.
        known: (p,) standard deviations of these before.
        upward: (K, 3) mean of gravity in the segment's frame.
    """
    first = 2 * axes.shape[1] + 3
    about = upward / np.maximum(np.linalg.norm(upward, axis=1, keepdims=True), 1e-12)
    best, out = np.full(len(R), np.inf), R
    for angle in np.arange(_AZIMUTHS) * 2 * np.pi / _AZIMUTHS:
        trial = rotation_exp(angle * about) @ R
        r, J = _linearised(data, axes, trial, linear)
        J = J[:, first:]
        H = J @ J.swapaxes(1, 2) + np.diag(known**-2)
        g = (J @ r[..., None])[..., 0] + linear / known**2
        gain = (g * np.linalg.solve(H, g[..., None])[..., 0]).sum(axis=1)
        cost = _chi2(r, linear, known) - gain
        better = cost < best
        best, out = np.minimum(best, cost), np.where(better[:, None, None], trial, out)
    return out


def _chi2(r: F64, linear: F64, known: F64) -> F64:
    """(K,) of weighted residuals (K, 3 N), and of the linear coordinates by what was known."""
    prior = linear / known
    return np.asarray(np.einsum("kn,kn->k", r, r) + np.einsum("kp,kp->k", prior, prior))


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


_Data = tuple[F64, F64, F64, F64, Carried | None]
"""Positions, gravity, readings, roots of weights, and motion."""


def _linearised(data: _Data, axes: F64, R: F64, linear: F64) -> tuple[F64, F64]:
    """Weighted residuals (K, 3 N) and their slopes (K, n, 3 N) in axes, rotation and the rest.

    What turning an axis does to the accelerations that its own joint makes is left out of the
    slopes: it is small beside what it does to gravity, and the cost is that of the whole model.
    """
    q, x, y, root, moving = data
    K, m, N = q.shape
    z = x
    offsets = linear[:, 9:-1]
    if moving is not None:
        z = x + _pushed(moving.columns, offsets)
    slopes = np.zeros((K, 0, 3, N))
    for i in range(m):
        before, k = z, axes[:, i]
        back, across = seen_beyond(k, q[:, i]), tangent(k).swapaxes(1, 2)[..., None]
        z = series.applied(back, before)
        # Turning k by delta: exp(delta) Rot exp(-delta).
        new = series.cross(before[:, None], across)
        slopes = series.applied(back[:, None], np.concatenate([slopes, new], axis=1))
        slopes[:, -2:] -= series.cross(z[:, None], across)
        if moving is not None:
            c = moving.columns.shape[1]
            moving = moving.beyond(i, k, back)
            z = z + _pushed(moving.columns[:, c:], offsets[:, c : c + 3])
    Rt, M = np.swapaxes(R, 1, 2), sensor_matrix(linear[:, 3:9])
    g, seen = Rt @ z, (M @ Rt)[:, None]
    predicted = M @ g + linear[:, :3, None]
    s, c = 2 * m, 0 if moving is None else moving.columns.shape[1]
    J = np.zeros((K, s + 12 + (c + 1 if moving is not None else 0), 3, N))
    np.matmul(seen, slopes, out=J[:, :s])
    np.matmul(M[:, None], series.cross(g[:, None], np.eye(3)[..., None]), out=J[:, s : s + 3])
    J[:, range(s + 3, s + 6), range(3)] = 1.0
    fill_shape_columns(J[:, s + 6 : s + 12], g)
    if moving is not None:
        predicted = predicted + moving.change * linear[:, -1:, None]
        np.matmul(seen, moving.columns, out=J[:, s + 12 : -1])
        J[:, -1] = moving.change
    J *= root[:, None, None]
    r = (predicted - y) * root[:, None]
    return r.reshape(K, -1), J.reshape(K, J.shape[1], -1)


def _pushed(columns: F64, offsets: F64) -> F64:
    """(K, 3, N) what offsets (K, c') add, the first c of them, by columns (K, c, 3, N)."""
    K, c, _, N = columns.shape
    return np.asarray((offsets[:, None, :c] @ columns.reshape(K, c, 3 * N)).reshape(K, 3, N))


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
