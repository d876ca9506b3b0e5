"""One SU on one segment, fitted to the moments of its readings: placement, sensor and lag."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, frozen
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
class Fit:
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

    def __post_init__(self) -> None:
        for name in ("R", "r", "bias", "shape", "rss"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


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
    found = [_descended(_Point(R, np.zeros(_N - 3), np.inf), sums, priors, _FIRST) for R in starts]
    found = sorted(found, key=lambda point: point.cost)[:_FOLLOWED]
    best = min((_descended(point, sums, priors) for point in found), key=lambda point: point.cost)
    r, b, shape, lag = best.parts
    return Fit(best.R, r, b, shape, lag, _by_span(best, sums.up, logs, u), best.cost)


def again(fit: Fit, sums: Sums, logs: list[Moments], u: int, priors: Priors) -> Fit:
    """The fit that an earlier one leads to when gravity's direction has changed a little."""
    x = np.concatenate([fit.r, fit.bias, fit.shape, [fit.lag]])
    found = _descended(_Point(fit.R, x, np.inf), sums, priors)
    r, b, shape, lag = found.parts
    return replace(
        fit,
        R=found.R,
        r=r,
        bias=b,
        shape=shape,
        lag=lag,
        rss=_by_span(found, sums.up, logs, u),
        cost=found.cost,
    )


def place_deviations(fit: Fit, sums: Sums, priors: Priors, noise: float) -> F64:
    """(3,) standard deviations of an SU's place along its principal directions, least first [m].

    Args:
        fit: the SU.
        sums: its moments.
        priors: of the sensor.
        noise: of a sample [m/s^2].
    """
    point = _Point(fit.R, np.concatenate([fit.r, fit.bias, fit.shape, [fit.lag]]), np.inf)
    H, _, _ = _equations(point, sums, priors)
    covariance = noise**2 * np.linalg.inv(H + 1e-12 * np.eye(_N))
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
    point = _Point(fit.R, np.concatenate([fit.r, fit.bias, fit.shape, [fit.lag]]), np.inf)
    H, g = np.zeros((_N + 2 * G, _N + 2 * G)), np.zeros(_N + 2 * G)
    S = _matrix(fit.shape)
    Q = S @ fit.R.T
    own_H, own_g, _ = _equations(point, sums, priors)
    H[:_N, :_N], g[:_N] = own_H, own_g
    for k, (N, c, s, up) in enumerate(zip(sums.N, sums.c, sums.s, sums.up, strict=True)):
        theta, J = _numbers(point, up)
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
class _Point:
    """A turn, the other numbers (13,) and what they leave."""

    R: F64
    x: F64
    cost: float

    @property
    def parts(self) -> tuple[F64, F64, F64, float]:
        """Place, bias, shape and lag."""
        return self.x[:3], self.x[3:6], self.x[6:12], float(self.x[12])


def _matrix(shape: F64) -> F64:
    """(3, 3) what a sensor's shape makes of specific force."""
    return np.asarray(np.eye(3) + np.tensordot(shape, _SHAPE_UNITS, 1))


def _numbers(point: _Point, up: F64) -> tuple[F64, F64]:
    """(22, 3) numbers of a placement, and (22, 3, 15) their derivatives, the lag's left out."""
    r, b, shape, _ = point.parts
    S, Rt = _matrix(shape), point.R.T
    Q = S @ Rt
    # All that Q turns into: itself, and its derivatives in the turn and in the shape.
    all_Q = np.concatenate([Q[None], -S @ _TURN_UNITS @ Rt, _SHAPE_UNITS @ Rt])
    by_axis = np.moveaxis(all_Q, (2, 1, 0), (0, 1, 2))  # (c, i, k)
    out = np.zeros((N_REGRESSORS, 3, len(all_Q)))
    out[TURNED] = (by_axis[:, None] * (GRAVITY * up)[:, None, None]).reshape(9, 3, -1)
    out[MOVED] = by_axis
    out[LEVER] = (by_axis[:, None] * r[:, None, None]).reshape(9, 3, -1)
    theta = out[:, :, 0]
    theta[CONSTANT] = b
    J = np.zeros((N_REGRESSORS, 3, _N - 1))
    J[:, :, :3], J[:, :, 9:] = out[:, :, 1:4], out[:, :, 4:]
    lever = J[LEVER].reshape(3, 3, 3, _N - 1)
    for k in range(3):
        lever[:, k, :, 3 + k] = Q.T
    J[LEVER] = lever.reshape(9, 3, _N - 1)
    J[CONSTANT, range(3), range(6, 9)] = 1.0
    return theta, J


def _prior(priors: Priors) -> F64:
    """(16,) information of what is known before, times the noise's variance."""
    deviations = np.concatenate(
        [[np.inf] * 3, [priors.position] * 3, np.maximum(priors.deviations, _LEAST), [_LAG]]
    )
    return np.asarray(NOISE**2 / deviations**2)


def _equations(point: _Point, sums: Sums, priors: Priors) -> tuple[F64, F64, float]:
    """Normal equations (16, 16), half the slope with its sign turned (16,), and the cost."""
    lag = point.parts[3]
    weight = _prior(priors)
    value = np.concatenate([np.zeros(3), point.x])
    H, g = np.diag(weight), -weight * value
    cost = sums.yy + 2 * lag * sums.ys + lag**2 * sums.ss + float(weight @ value**2)
    H[-1, -1] += sums.ss
    g[-1] -= sums.ys + lag * sums.ss
    for N, c, s, up in zip(sums.N, sums.c, sums.s, sums.up, strict=True):
        theta, J = _numbers(point, up)
        target = c + lag * s
        Nt = N @ theta
        flat = J.reshape(-1, _N - 1)
        H[:-1, :-1] += flat.T @ (N @ J.reshape(N_REGRESSORS, -1)).reshape(flat.shape)
        g[:-1] += (target - Nt).ravel() @ flat
        lagged = -(s.ravel() @ flat)
        H[:-1, -1] += lagged
        H[-1, :-1] += lagged
        g[-1] += float((s * theta).sum())
        cost += float((theta * (Nt - 2 * target)).sum())
    return H, g, cost


def _descended(point: _Point, sums: Sums, priors: Priors, steps: int = _STEPS) -> _Point:
    """Levenberg-Marquardt."""
    H, g, cost = _equations(point, sums, priors)
    point = replace(point, cost=cost)
    damping = 1e-4
    for _ in range(steps):
        damped = H + damping * np.diag(np.diag(H)) + 1e-12 * np.eye(_N)
        step = np.asarray(np.linalg.solve(damped, g))
        trial = _Point(point.R @ rotation_exp(step[:3]), point.x + step[3:], np.inf)
        H_there, g_there, there = _equations(trial, sums, priors)
        if there > point.cost:
            damping *= 10
            if damping > 1e8:
                break
            continue
        gain = (point.cost - there) / max(point.cost, 1e-12)
        point, H, g = replace(trial, cost=there), H_there, g_there
        damping = max(damping / 10, 1e-9)
        if gain < 1e-8:
            break
    return point


def _by_span(point: _Point, up: F64, logs: list[Moments], u: int) -> F64:
    """(S,) sums of squares that a placement leaves of each span of all logs."""
    lag = point.parts[3]
    out = []
    for m, direction in zip(logs, up, strict=True):
        theta, _ = _numbers(point, direction)
        rss = m.yy[u] + 2 * lag * m.ys[u] + lag**2 * m.ss[u]
        rss = rss - 2 * np.einsum("nri,ri->n", m.c[u] + lag * m.s[u], theta)
        out.append(rss + ((m.N[u] @ theta) * theta).sum(axis=(1, 2)))
    return np.asarray(np.maximum(np.concatenate(out), 0.0))
