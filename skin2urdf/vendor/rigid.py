"""One SU on one segment, fitted to the moments of its readings: placement, sensor and lag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.geometry.so3 import axis_rotation, rotation_exp, skew
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.vendor.moments import CONSTANT, LEVER, MOVED, N_REGRESSORS, TURNED, Moments

NOISE = 0.05
"""Noise of readings against which priors count [m/s^2]: where to begin is to be found, and what
sensors of 5 mg leave is enough for that."""
_LAG = 0.02
"""Standard deviation of a lag [s]; longer ones were taken off the clocks before."""
_LEAST = 1e-6
"""Deviation of a sensor's error that is taken as none [m/s^2 or 1]."""
_SHAPE = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
_SHAPE_UNITS = np.zeros((6, 3, 3))
for _k, (_a, _b) in enumerate(_SHAPE):
    _SHAPE_UNITS[_k, _a, _b] = _SHAPE_UNITS[_k, _b, _a] = 1.0
_TURN_UNITS = skew(np.eye(3))
_N = 16
"""Turn, place, bias, shape and lag."""
_FREE_RIDGE = NOISE**2 / np.array([100.0] * 9 + [1.0] * 12 + [0.25])
_STEPS = 30
_FIRST, _FOLLOWED = 6, 2
"""Steps from each turn to begin with, and how many of these are then followed to the end: steps
that go anywhere halve what is left at least, and six tell the best."""
_FLAT = 0.5
"""Singular value of a linear fit's Q below which its turn is as good as unknown."""
_TURNS = 8
"""Turns about gravity to begin from where it alone was felt."""


@dataclass(frozen=True, eq=False)
class Fit(Record):
    """An SU on a segment.

    Attributes:
        R: (3, 3) its orientation in the segment's frame.
        r: (3,) its place there [m].
        bias: (3,) [m/s^2].
        shape: (6,) scale errors and cross-axis terms, as in :class:`State`.
        lag: by how much its stamps are late [s].
        rss: (S,) sums of squares that it leaves of each span [m^2/s^4].
        cost: their sum and what priors add.
    """

    R: F64
    r: F64
    bias: F64
    shape: F64
    lag: float
    rss: F64
    cost: float


@dataclass(frozen=True, eq=False)
class Sums:
    """Moments of one SU on one segment, gravity's direction in the base frame known by log.

    Attributes:
        N: (G, 22, 22), c: (G, 22, 3), s: (G, 22, 3) by log; yy, ys, ss: sums of all.
        up: (G, 3) unit vectors.
    """

    N: F64
    c: F64
    s: F64
    yy: float
    ys: float
    ss: float
    up: F64


def sums_of(logs: list[Moments], u: int, up: F64) -> Sums:
    """Moments of one SU, spans added up."""
    return Sums(
        np.stack([m.N[u].sum(axis=0) for m in logs]),
        np.stack([m.c[u].sum(axis=0) for m in logs]),
        np.stack([m.s[u].sum(axis=0) for m in logs]),
        float(sum(m.yy[u].sum() for m in logs)),
        float(sum(m.ys[u].sum() for m in logs)),
        float(sum(m.ss[u].sum() for m in logs)),
        up,
    )


def gravity_known(up: F64) -> F64:
    """(22, 13) how the 22 numbers follow from 13 where gravity's direction (3,) is known."""
    B = np.zeros((N_REGRESSORS, 13))
    B[TURNED, :3] = np.kron(np.eye(3), GRAVITY * up[:, None])
    B[MOVED, :3] = np.eye(3)
    B[LEVER, 3:12] = np.eye(9)
    B[CONSTANT, 12] = 1.0
    return B


def linear_ridge(bias: float) -> F64:
    """(13,) weights that keep the 13 numbers of a linear fit near zero."""
    return NOISE**2 / np.array([4.0] * 3 + [1.0] * 9 + [max(bias, 1e-3) ** 2])


def linear(sums: Sums, bias: float) -> tuple[F64, float]:
    """(13, 3) numbers that fit best, and the sum of squares that they leave."""
    N, c = np.diag(linear_ridge(bias)), np.zeros((13, 3))
    for Ng, cg, up in zip(sums.N, sums.c, sums.up, strict=True):
        B = gravity_known(up)
        N = N + B.T @ Ng @ B
        c = c + B.T @ cg
    x = np.linalg.solve(N, c)
    return np.asarray(x), sums.yy - float((x * c).sum())


def freely_linear(sums: Sums) -> float:
    """The sum of squares that the best 22 numbers of each log leave, whatever gravity does.

    It knows neither rotations nor that all SUs feel the same gravity.
    """
    total = sums.yy
    for N, c in zip(sums.N, sums.c, strict=True):
        x = np.linalg.solve(N + np.diag(_FREE_RIDGE), c)
        total -= float((x * c).sum())
    return total


def fitted(sums: Sums, logs: list[Moments], u: int, priors: Priors) -> Fit:
    """The placement that explains readings best, from the linear fit and turns about gravity.

    Args:
        sums: moments of the SU on the segment.
        logs: the same by span.
        u: the SU.
        priors: of the sensor.
    """
    x, _ = linear(sums, priors.bias)
    Q = x[:3].T
    left, size, right = np.linalg.svd(Q)
    Rt = left @ np.diag([1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)]) @ right
    starts = [Rt.T]
    if size[2] < _FLAT:
        # About the mean of gravity in the segment's frame, which alone was felt.
        both = sums.N, sums.up
        about = sum(Ng[CONSTANT, TURNED].reshape(3, 3) @ up for Ng, up in zip(*both, strict=True))
        length = float(np.linalg.norm(about))
        if length > 0:
            axis = np.asarray(about) / length
            starts += [
                axis_rotation(axis, np.array(2 * np.pi * k / _TURNS)) @ Rt.T
                for k in range(1, _TURNS)
            ]
    B = len(starts)
    points = _Points(np.stack(starts), np.zeros((B, _N - 3)), np.full(B, np.inf))
    points = _descended(points, [sums] * B, priors, _FIRST)
    points = points[np.argsort(points.cost, kind="stable")[:_FOLLOWED]]
    points = _descended(points, [sums] * len(points.x), priors)
    return points.fit(int(points.cost.argmin()), sums, logs, u)


def again(
    fits: Sequence[Fit], sums: Sequence[Sums], logs: Sequence[list[Moments]], priors: Priors
) -> list[Fit]:
    """The fits that earlier ones lead to when gravity's direction has changed a little.

    Args:
        fits: of U SUs.
        sums: U moments on their segments.
        logs: the same by span.
        priors: of the sensors.
    """
    found = _descended(_points_of(fits), sums, priors)
    return [found.fit(u, sums[u], logs[u], u) for u in range(len(fits))]


def place_deviations(fit: Fit, sums: Sums, priors: Priors, noise: float) -> F64:
    """(3,) standard deviations of an SU's place along its principal directions, least first [m].

    Args:
        fit: the SU.
        sums: its moments.
        priors: of the sensor.
        noise: of a sample [m/s^2].
    """
    H, _, _ = _equations(_points_of([fit]), [sums], _prior(priors))
    covariance = noise**2 * np.linalg.inv(H[0] + 1e-12 * np.eye(_N))
    return np.asarray(np.sqrt(np.linalg.eigvalsh(covariance[3:6, 3:6]).clip(min=0.0)))


def sensor_chi2(fit: Fit, priors: Priors) -> float:
    """Squared errors of an SU's sensor over what is known of them before; of 9 numbers."""
    errors = np.concatenate([fit.bias, fit.shape])
    return float(((errors / np.maximum(priors.deviations, _LEAST)) ** 2).sum())


def up_equations(fit: Fit, sums: Sums, axes: F64, priors: Priors) -> tuple[F64, F64]:
    """Information on turns of each log's gravity, and its gradient, whatever the SU's numbers are.

    Args:
        fit: the SU.
        sums: its moments.
        axes: (G, 3, 2) axes of the turns.
        priors: of the sensor.

    Returns:
        (2 G, 2 G) and (2 G,).
    """
    G = len(sums.up)
    point = _points_of([fit])
    H, g = np.zeros((_N + 2 * G, _N + 2 * G)), np.zeros(_N + 2 * G)
    Q = _matrix(fit.shape) @ fit.R.T
    own_H, own_g, _ = _equations(point, [sums], _prior(priors))
    H[:_N, :_N], g[:_N] = own_H[0], own_g[0]
    for k, (N, c, s, up) in enumerate(zip(sums.N, sums.c, sums.s, sums.up, strict=True)):
        (theta,), (J,) = _numbers(point, up)
        turned = np.cross(axes[k].T, up) * GRAVITY
        D = np.zeros((N_REGRESSORS, 3, 2))
        D[TURNED] = np.einsum("ic,tj->cjit", Q, turned).reshape(9, 3, 2)
        at = slice(_N + 2 * k, _N + 2 * k + 2)
        ND = (N @ D.reshape(N_REGRESSORS, -1)).reshape(D.shape)
        H[at, at] += np.einsum("rit,riv->tv", D, ND)
        cross = np.einsum("rip,rit->pt", J, ND)
        lagged = -np.einsum("ri,rit->t", s, D)
        H[: _N - 1, at] += cross
        H[at, : _N - 1] += cross.T
        H[_N - 1, at] += lagged
        H[at, _N - 1] += lagged
        g[at] += np.einsum("rit,ri->t", D, c + fit.lag * s - N @ theta)
    inner = np.linalg.solve(
        H[:_N, :_N] + 1e-12 * np.eye(_N), np.column_stack([H[:_N, _N:], g[:_N]])
    )
    return (
        H[_N:, _N:] - H[_N:, :_N] @ inner[:, :-1],
        g[_N:] - H[_N:, :_N] @ inner[:, -1],
    )


@dataclass(frozen=True, eq=False)
class _Points:
    """B placements and sensors: turns (B, 3, 3), other numbers (B, 13), what they leave (B,)."""

    R: F64
    x: F64
    cost: F64

    def __getitem__(self, at: Int | Bool | slice) -> _Points:
        return _Points(self.R[at], self.x[at], self.cost[at])

    def fit(self, at: int, sums: Sums, logs: list[Moments], u: int) -> Fit:
        """One of them, as an SU's."""
        x = self.x[at]
        lag, cost = float(x[12]), float(self.cost[at])
        rss = _by_span(self[at : at + 1], sums.up, logs, u)
        return Fit(self.R[at], x[:3], x[3:6], x[6:12], lag, rss, cost)


def _points_of(fits: Sequence[Fit]) -> _Points:
    """Those of SUs on their segments."""
    x = [np.concatenate([fit.r, fit.bias, fit.shape, [fit.lag]]) for fit in fits]
    return _Points(np.stack([fit.R for fit in fits]), np.stack(x), np.full(len(fits), np.inf))


def _matrix(shape: F64) -> F64:
    """(B, 3, 3) what sensors' shapes make of specific force."""
    return np.asarray(np.eye(3) + np.tensordot(shape, _SHAPE_UNITS, 1))


def _numbers(points: _Points, up: F64) -> tuple[F64, F64]:
    """(B, 22, 3) numbers of placements, and (B, 22, 3, 15) their derivatives, lags' left out."""
    B, r, bias = len(points.x), points.x[:, :3], points.x[:, 3:6]
    S, Rt = _matrix(points.x[:, 6:12])[:, None], points.R.swapaxes(1, 2)[:, None]
    Q = S @ Rt
    # All that Q turns into: itself, and its derivatives in the turn and in the shape.
    all_Q = np.concatenate([Q, -S @ _TURN_UNITS @ Rt, _SHAPE_UNITS @ Rt], axis=1)
    by_axis = all_Q.transpose(0, 3, 2, 1)  # (B, c, i, k)
    out = np.zeros((B, N_REGRESSORS, 3, all_Q.shape[1]))
    out[:, TURNED] = (by_axis[:, :, None] * (GRAVITY * up)[:, None, None]).reshape(B, 9, 3, -1)
    out[:, MOVED] = by_axis
    out[:, LEVER] = (by_axis[:, :, None] * r[:, None, :, None, None]).reshape(B, 9, 3, -1)
    theta = out[..., 0]
    theta[:, CONSTANT] = bias
    J = np.zeros((B, N_REGRESSORS, 3, _N - 1))
    J[..., :3], J[..., 9:] = out[..., 1:4], out[..., 4:]
    lever = J[:, LEVER].reshape(B, 3, 3, 3, _N - 1)
    for k in range(3):
        lever[:, :, k, :, 3 + k] = by_axis[..., 0]
    J[:, LEVER] = lever.reshape(B, 9, 3, _N - 1)
    J[:, CONSTANT, range(3), range(6, 9)] = 1.0
    return theta, J


def _prior(priors: Priors) -> F64:
    """(16,) information of what is known before, times the noise's variance."""
    deviations = np.concatenate(
        [[np.inf] * 3, [priors.position] * 3, np.maximum(priors.deviations, _LEAST), [_LAG]]
    )
    return np.asarray(NOISE**2 / deviations**2)


def _equations(points: _Points, sums: Sequence[Sums], weight: F64) -> tuple[F64, F64, F64]:
    """Normal equations (B, 16, 16), half the slope with its sign turned (B, 16), costs (B,).

    Args:
        points: B of them.
        sums: B of the SUs, of the same logs.
        weight: (16,) of what is known before.
    """
    B, lag = len(sums), points.x[:, 12]
    value = np.concatenate([np.zeros((B, 3)), points.x], axis=1)
    H, g = np.tile(np.diag(weight), (B, 1, 1)), -weight * value
    yy, ys, ss = (np.array([getattr(each, name) for each in sums]) for name in ("yy", "ys", "ss"))
    cost = yy + 2 * lag * ys + lag**2 * ss + value**2 @ weight
    H[:, -1, -1] += ss
    g[:, -1] -= ys + lag * ss
    for k, up in enumerate(sums[0].up):
        N, c, s = (np.stack([getattr(each, name)[k] for each in sums]) for name in ("N", "c", "s"))
        theta, J = _numbers(points, up)
        target = c + lag[:, None, None] * s
        Nt = N @ theta
        flat = J.reshape(B, -1, _N - 1)
        both = (N @ J.reshape(B, N_REGRESSORS, -1)).reshape(flat.shape)
        H[:, :-1, :-1] += flat.swapaxes(1, 2) @ both
        g[:, :-1] += ((target - Nt).reshape(B, 1, -1) @ flat)[:, 0]
        lagged = -(s.reshape(B, 1, -1) @ flat)[:, 0]
        H[:, :-1, -1] += lagged
        H[:, -1, :-1] += lagged
        g[:, -1] += (s * theta).sum(axis=(1, 2))
        cost += (theta * (Nt - 2 * target)).sum(axis=(1, 2))
    return H, g, cost


def _descended(
    points: _Points, sums: Sequence[Sums], priors: Priors, steps: int = _STEPS
) -> _Points:
    """Levenberg-Marquardt of each, side by side.

    Args:
        points: B of them.
        sums: B of the SUs, of the same logs.
        priors: of the sensors.
        steps: at most.
    """
    weight = _prior(priors)
    H, g, cost = _equations(points, sums, weight)
    R, x = np.array(points.R), np.array(points.x)
    damping, on = np.full(len(x), 1e-4), np.arange(len(x))
    for _ in range(steps):
        size = np.einsum("bii->bi", H[on])
        damped = H[on] + (damping[on, None] * size + 1e-12)[:, :, None] * np.eye(_N)
        step = np.linalg.solve(damped, g[on][:, :, None])[:, :, 0]
        trial = _Points(R[on] @ rotation_exp(step[:, :3]), x[on] + step[:, 3:], cost[on])
        H_there, g_there, there = _equations(trial, [sums[int(i)] for i in on], weight)
        less = there <= trial.cost
        gain = (trial.cost - there) / np.maximum(trial.cost, 1e-12)
        better = on[less]
        R[better], x[better], cost[better] = trial.R[less], trial.x[less], there[less]
        H[better], g[better] = H_there[less], g_there[less]
        damping[on] = np.where(less, np.maximum(damping[on] / 10, 1e-9), damping[on] * 10)
        on = on[np.where(less, gain >= 1e-8, damping[on] <= 1e8)]
        if not len(on):
            break
    return _Points(R, x, cost)


def _by_span(point: _Points, up: F64, logs: list[Moments], u: int) -> F64:
    """(S,) sums of squares that one placement leaves of each span of all logs."""
    lag = float(point.x[0, 12])
    out = []
    for m, direction in zip(logs, up, strict=True):
        theta = _numbers(point, direction)[0][0]
        rss = m.yy[u] + 2 * lag * m.ys[u] + lag**2 * m.ss[u]
        rss = rss - 2 * np.einsum("nri,ri->n", m.c[u] + lag * m.s[u], theta)
        out.append(rss + ((m.N[u] @ theta) * theta).sum(axis=(1, 2)))
    return np.asarray(np.maximum(np.concatenate(out), 0.0))
