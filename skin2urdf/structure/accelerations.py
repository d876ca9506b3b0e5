"""What the accelerations of moves say of an SU's chain, for what gravity can not show.

With the directions of a chain known, the reading along a whole move is linear in all offsets::

    f = R_n^T [ g up + sum_i (skew(alpha_i) + skew(omega_i)^2) R_i l_i ]

with omega_i, alpha_i the motion of segment i and l_i the offset it carries. A sliding joint beyond
segment i adds ``(q'' + 2 skew(omega_i) q' + (skew(alpha_i) + skew(omega_i)^2) q) R_i b`` with its
direction b. Small errors of directions, sensors and clocks are further columns. So any chain is
judged by one linear regression: how well what it leaves open, fitted to some stretches of time,
predicts the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.geometry.series import applied, cross, per_metre, rotations
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.filters import (
    eroded,
    filtered,
    first_derivative,
    low_pass,
    second_derivative,
)
from skin2urdf.signals.sampling import Sampled
from skin2urdf.signals.turning import Turning
from skin2urdf.structure.chain_fit import PRIOR, fill_shape_columns, sensor_matrix, tangent
from skin2urdf.structure.records import JointType

_CUTOFF = 4.0
"""Low-pass [Hz] of both sides: moves from pose to pose hold little beyond."""
_STRETCH = 4.0
"""Length of a stretch of time [s] that is predicted from the others: longer than most moves."""
_ROUGH = 0.1
"""Error [m/s^2] of a sample by which priors are weighed against samples."""
_ROUGH_RATE, _RATE_BIAS = 0.02, 0.1
"""The same of a rate, and the standard deviation of a gyroscope's bias [rad/s]."""
_TURN, _OFFSET, _LAG = 0.05, 1.0, 0.05
"""Standard deviations of directions from gravity [rad], of offsets [m], and of clocks [s], as a
constant and as what they drift in half a log."""
_WARMTH = 0.05
"""The same of what a bias drifts in half a log, in proportion to time and to its square [m/s^2],
5 mg: that of sensors that warm up. Where joints stay for a while, functions of their positions
would foretell a drift."""

_REMEMBERED = 16
"""Chains whose motion is kept for the next SU: as many as a branch has segments, of a MB
each in logs of a minute and a half. It is of time and memory alone."""

PARALLEL = 0.9962
"""Cosine of the angle up to which neighbouring axes turn gravity alike: 5 deg."""


@dataclass(frozen=True)
class ChainJoint:
    """A joint of an SU's chain.

    Attributes:
        dof: index of the joint.
        kind: revolute or prismatic.
        axis: unit axis at position zero in the base frame; without meaning for a prismatic one,
            whose direction is estimated.
    """

    dof: int
    kind: JointType
    axis: tuple[float, float, float]

    def turned_to(self, axis: F64) -> ChainJoint:
        """The same about another axis (3,)."""
        x, y, z = (float(part) for part in axis)
        return replace(self, axis=(x, y, z))

    @property
    def is_upright(self) -> bool:
        """Whether it turns gravity next to nothing: it slides, or is vertical or nearly so."""
        return self.kind == "prismatic" or abs(self.axis[2]) > PARALLEL

    @property
    def is_hidden(self) -> bool:
        """Whether it leaves gravity as it is: it slides, or was put in as vertical."""
        return self.kind == "prismatic" or self.axis[:2] == (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Along(Record):
    """Low-passed samples along all logs.

    Attributes:
        q: (N, D) positions, and their derivatives
        qd: (N, D) and
        qdd: (N, D).
        readings: (N, U, 3) [m/s^2], and
        change: (N, U, 3) their derivatives [m/s^3].
        valid: (N, U) where they are whole.
        log: (N,) which log, or which span of time in which gravity has one direction.
        time: (N,) time in its log, from -1 at its begin to 1 at its end.
        stretch: (N,) which stretch of time, rising: every second one through all logs first, so
            that those that are predicted from the others lie together.
        rates: (N, U, 3) what gyroscopes read [rad/s]; None where no SU has one.
        turning: (N, U) where those are whole.
    """

    q: F64
    qd: F64
    qdd: F64
    readings: F64
    change: F64
    valid: Bool
    log: Int
    time: F64
    stretch: Int
    rates: F64 | None = None
    turning: Bool | None = None

    @property
    def n_stretches(self) -> int:
        """Number of stretches."""
        return int(self.stretch.max(initial=-1)) + 1

    @cached_property
    def _judged(self) -> dict[object, Judged]:
        """What was judged already: trees that are tried share most of their chains."""
        return {}

    @cached_property
    def _moved(self) -> dict[object, _ChainMotion]:
        """How the last chains moved: SUs share those of their segments."""
        return {}

    def stays(self, joint: int, while_moves: int) -> float:
        """Where a joint is while another one moves, in the mean [rad or m].

        Args:
            joint: the joint.
            while_moves: the other one.
        """
        weights = self.qd[:, while_moves] ** 2
        return float(weights @ self.q[:, joint] / max(weights.sum(), 1e-300))

    def moved_by(self, chain: tuple[ChainJoint, ...], up: F64) -> _ChainMotion:
        """How a chain moves what it carries; made once for SUs that follow each other."""
        case = chain, up.tobytes()
        if case not in self._moved:
            while len(self._moved) >= _REMEMBERED:
                del self._moved[next(iter(self._moved))]
            self._moved[case] = _motion_of(self, chain, up)
        return self._moved[case]

    def judge(self, su: int, chain: tuple[ChainJoint, ...], R: F64, sensor: F64, up: F64) -> Judged:
        """Fit a chain to half of the stretches, predict the other half, and the other way round.

        Args:
            su: which SU.
            chain: its joints from the RS outwards.
            R: (3, 3) the SU's orientation at position zero in the base frame.
            sensor: (9,) its bias and shape.
            up: (G, 3) unit vectors opposite to gravity, per log.
        """
        case = su, chain, R.tobytes(), sensor.tobytes(), up.tobytes()
        if case not in self._judged:
            self._judged[case] = _judge(self, su, self.moved_by(chain, up), R, sensor)
        return self._judged[case]


def along(sampled: Sequence[Sampled], spans: Sequence[Int] = ()) -> Along:
    """All logs, low-passed and thinned out.

    Args:
        sampled: the logs on their grids.
        spans: per log (N,) number of the span of time of each sample of its grid, which stands for
            that of the log where gravity has its own direction in each; () for logs as they are.
    """
    parts, turns = [], []
    stretches = 0
    for g, s in enumerate(sampled):
        rate = s.motion.grid.rate
        taps = low_pass(_CUTOFF, rate)
        half = len(taps) // 2
        q, y = filtered(s.motion.q, taps), filtered(s.readings, taps)
        whole = s.valid & s.motion.valid[:, None]
        ok = np.stack([eroded(column, half) for column in whole.T], axis=1)
        kept = np.arange(0, len(q), max(1, int(rate / (3 * _CUTOFF))))
        stretch = stretches + (kept / (rate * _STRETCH)).astype(np.int64)
        stretches = int(stretch.max(initial=stretches - 1)) + 1
        turns.append(_turned(s.turning, s.motion.valid, taps, kept))
        parts.append(
            (
                q[kept],
                first_derivative(q, rate)[kept],
                second_derivative(q, rate)[kept],
                y[kept],
                first_derivative(y, rate)[kept],
                ok[kept],
                spans[g][kept] if spans else np.full(len(kept), g),
                2 * kept / max(len(q) - 1, 1) - 1,
                stretch,
            )
        )
    counted = np.concatenate([p[8] for p in parts])
    order = np.argsort(counted % 2, kind="stable")
    q, qd, qdd, y, yd, ok, log, time = (
        np.concatenate([p[i] for p in parts])[order] for i in range(8)
    )
    stretch = (counted // 2 + counted % 2 * _first_half(stretches))[order]
    if all(t is None for t in turns):
        return Along(q, qd, qdd, y, yd, ok, log, time, stretch)
    shape = y.shape[1:]
    rates, turning = (
        np.concatenate(
            [
                np.zeros((len(p[0]), *shape[:n])) if t is None else t[i]
                for p, t in zip(parts, turns, strict=True)
            ]
        )[order]
        for i, n in ((0, 2), (1, 1))
    )
    return Along(q, qd, qdd, y, yd, ok, log, time, stretch, rates, turning > 0)


def _first_half(stretches: int) -> int:
    """How many of so many stretches are every second one, from the first on."""
    return (stretches + 1) // 2


def _turned(turning: Turning | None, valid: Bool, taps: F64, kept: Int) -> tuple[F64, Bool] | None:
    """Rates (K, U, 3) at the samples that are kept, and (K, U) where they are whole."""
    if turning is None:
        return None
    half = len(taps) // 2
    whole = turning.valid & valid[:, None]
    ok = np.stack([eroded(column, half) for column in whole.T], axis=1)
    return filtered(turning.rates, taps)[kept], ok[kept]


@dataclass(frozen=True, eq=False)
class Judged(Record):
    """How well a chain predicts an SU's readings in stretches that it was not fitted to.

    Attributes:
        loss: (B,) sum of squared errors in each stretch [m^2/s^4].
        count: (B,) measurements in each.
        slide: (k, 3) directions b of the sliding joints, in the order of the chain; of length 1
            where they are what they are taken for.
        slide_sd: (k,) standard deviations of their lengths.
        lever: distance of the SU from the chain's last revolute axis [m].
        turn_loss: (B,) the same of its gyroscope's rates [rad^2/s^2], and
        turn_count: (B,) measurements; 0 where it has none.
        turn_left: what these leave of the rates of a gyroscope that is right about its axes
            [rad^2/s^2].
    """

    loss: F64
    count: F64
    slide: F64
    slide_sd: F64
    lever: float
    turn_loss: F64
    turn_count: F64
    turn_left: float


def _judge(samples: Along, su: int, motion: _ChainMotion, R: F64, sensor: F64) -> Judged:
    """How well a motion predicts an SU, see :meth:`Along.judge`."""
    use = samples.valid[:, su]
    A, y, prior = _regression(samples, su, use, motion, R, sensor)
    slides, last = motion.slides, motion.last
    rows = samples.stretch[use]
    ridge = np.diag((_ROUGH / prior) ** 2)
    loss, count, H, Aty = _held_out(A, y, rows, samples.n_stretches, ridge)
    x = np.linalg.solve(H, Aty)
    total = max(float(count.sum()), 1.0)
    covariance = np.linalg.inv(H) * max(float(loss.sum()) / total, 1e-12)
    slide = np.array([x[s : s + 3] for s in slides]).reshape(-1, 3)
    slide_sd = np.array([np.sqrt(np.trace(covariance[s : s + 3, s : s + 3])) for s in slides])
    offset = x[last[0] : last[0] + 3]
    lever = float(np.linalg.norm(np.cross(last[1], offset))) if last[0] >= 0 else 0.0
    return Judged(loss, count, slide, slide_sd, lever, *_turning(samples, su, motion, R))


def _held_out(
    A: F64, y: F64, stretch: Int, n_stretches: int, ridge: F64
) -> tuple[F64, F64, F64, F64]:
    """Fit columns to half of the stretches, predict the other half, and the other way round.

    Args:
        A: (3, n, N) columns.
        y: (3, N) what they have to explain.
        stretch: (N,) which of the B stretches of time, rising; the first half of them is one fold.
        n_stretches: B.
        ridge: (n, n) information on the coefficients before.

    Returns:
        (B,) squared errors of prediction and (B,) measurements, and (n, n) and (n,) the normal
        equations of all stretches together.
    """
    cut = int(np.searchsorted(stretch, _first_half(n_stretches)))
    halves = [(A[..., half], y[:, half]) for half in (slice(None, cut), slice(cut, None))]
    normal = [(columns @ columns.swapaxes(1, 2)).sum(axis=0) for columns, _ in halves]
    right = [(columns @ values[..., None]).sum(axis=(0, 2)) for columns, values in halves]
    left = []
    for (columns, values), of_others, by_others in zip(
        halves, reversed(normal), reversed(right), strict=True
    ):
        left.append(values - np.linalg.solve(of_others + ridge, by_others) @ columns)
    square = (np.concatenate(left, axis=1) ** 2).sum(axis=0)
    loss, count = (
        np.asarray(np.bincount(stretch, each, n_stretches), dtype=np.float64)
        for each in (square, np.full(len(stretch), 3.0))
    )
    return loss, count, normal[0] + normal[1] + ridge, right[0] + right[1]


def _turning(samples: Along, su: int, motion: _ChainMotion, R: F64) -> tuple[F64, F64, float]:
    """How well a chain predicts how an SU turns.

    An axis that is vertical is seen as gravity is, whatever the SU's turn about it.

    Returns:
        (B,) squared errors and (B,) measurements, and the sum of the errors where nothing but bias
        and clock is open.
    """
    B = samples.n_stretches
    if samples.rates is None or samples.turning is None or not samples.turning[:, su].any():
        return np.zeros(B), np.zeros(B), 0.0
    use = samples.turning[:, su]
    w, slope = R.T @ motion.omega[:, use], R.T @ motion.alpha[:, use]
    N = w.shape[1]
    # The gyroscope's bias, its clock, and nine numbers for its axes and for directions that are
    # not known any better yet.
    A = np.zeros((3, 14, N))
    A[range(3), range(3)] = 1.0
    for i in range(3):
        A[i, 3 + 3 * i : 6 + 3 * i] = w
    A[:, 12], A[:, 13] = slope, slope * samples.time[use]
    prior = np.array([_RATE_BIAS] * 3 + [_TURN] * 9 + [_LAG] * 2)
    ridge = np.diag((_ROUGH_RATE / prior) ** 2)
    rows, left = samples.stretch[use], samples.rates[use, su].T - w
    loss, count, _, _ = _held_out(A, left, rows, B, ridge)
    # Free axes would hide a turn that a gyroscope does not read at all.
    few = [0, 1, 2, 12, 13]
    plain, _, _, _ = _held_out(A[:, few], left, rows, B, ridge[np.ix_(few, few)])
    return loss, count, float(plain.sum())


@dataclass(frozen=True, eq=False)
class _ChainMotion(Record):
    """How a chain moves what it carries at N samples, in the frame that its last segment carries.

    At position zero that is the base frame.

    Attributes:
        columns: (3, n, N) what each number that the chain leaves open adds to the specific force:
            offsets [s^-2], pushes [m/s^2], and turns of axes [m/s^2 per rad].
        prior: (n,) standard deviations of these.
        gravity: (3, N) what rests feel of it [m/s^2].
        omega: (3, N) [rad/s], and
        alpha: (3, N) its derivative [rad/s^2].
        slides: where the pushes of sliding joints begin among the columns.
        last: where the last offset begins, -1 if there is none, and the axis it turns about.
    """

    columns: F64
    prior: F64
    gravity: F64
    omega: F64
    alpha: F64
    slides: tuple[int, ...]
    last: tuple[int, tuple[float, float, float]]


def _motion_of(samples: Along, chain: Sequence[ChainJoint], up: F64) -> _ChainMotion:
    """How a chain moves what it carries."""
    q, qd, qdd = (np.ascontiguousarray(x.T) for x in (samples.q, samples.qd, samples.qdd))
    N = q.shape[1]
    # All is in the base frame until it is seen from the SU: ``turn`` are the segment's axes there.
    turn = np.repeat(np.eye(3)[..., None], N, axis=2)
    omega, alpha, spin = np.zeros((3, N)), np.zeros((3, N)), np.zeros((3, 3, N))
    upward = (up[samples.log] * GRAVITY).T
    columns: list[F64] = []
    priors: list[float] = []
    slides: list[int] = []
    slopes: list[F64] = []
    last, about = (-1, (0.0, 0.0, 0.0)), (0.0, 0.0, 0.0)
    at = 0
    for i, joint in enumerate(chain):
        d, axis = joint.dof, np.array(joint.axis)
        if joint.kind == "prismatic":
            along_offset = applied(spin.swapaxes(0, 1), turn)
            columns.append(qdd[d] * turn + 2 * qd[d] * cross(omega, turn) + q[d] * along_offset)
            priors += [_OFFSET] * 3
            slides.append(at)
            at += 3
        else:
            about = joint.axis
            a = np.tensordot(axis, turn, 1)
            alpha = alpha + a * qdd[d] + cross(omega, a) * qd[d]
            omega = omega + a * qd[d]
            spin = per_metre(omega, alpha)
            before = turn
            turn = np.einsum("ian,ijn->jan", before, rotations(axis, q[d]))
            # Turning the axis turns all beyond it there and back: gravity is seen from between.
            across = np.tensordot(tangent(axis[None])[0].T, before - turn, 1)
            slopes.append(cross(upward, across))
        carried = i + 1 == len(chain) or chain[i + 1].kind == "revolute"
        if carried and omega.any():
            columns.append(applied(spin.swapaxes(0, 1), turn))
            priors += [_OFFSET] * 3
            last = (at, about)
            at += 3
    open_ = [*columns, *slopes]
    seen = applied(turn, np.concatenate(open_)) if open_ else np.zeros((0, 3, N))
    return _ChainMotion(
        columns=np.ascontiguousarray(seen.swapaxes(0, 1)),
        prior=np.array([*priors, *[_TURN] * (2 * len(slopes))]),
        gravity=applied(turn, upward),
        omega=applied(turn, omega),
        alpha=applied(turn, alpha),
        slides=tuple(slides),
        last=last,
    )


def _regression(
    samples: Along, su: int, use: Bool, motion: _ChainMotion, R: F64, sensor: F64
) -> tuple[F64, F64, F64]:
    """Columns (3, n, N), what they have to explain (3, N), and the columns' priors (n,)."""
    n, M = motion.columns.shape[1], sensor_matrix(sensor[3:])
    g = R.T @ motion.gravity[:, use]
    N = g.shape[1]
    A = np.zeros((3, n + 20, N))
    moved = motion.columns if len(use) == N else motion.columns[..., use]
    np.matmul(M @ R.T, moved.reshape(3, -1), out=A.reshape(3, -1)[:, : n * N])
    tilted = np.ascontiguousarray(cross(g, np.eye(3)[..., None]).swapaxes(0, 1))
    A[:, n : n + 3] = (M @ tilted.reshape(3, -1)).reshape(3, 3, N)
    A[range(3), range(n + 3, n + 6)] = 1.0
    fill_shape_columns(A[:, n + 6 : n + 12].swapaxes(0, 1), g)
    A[:, n + 12] = samples.change[use, su].T
    A[:, n + 13] = A[:, n + 12] * samples.time[use]
    A[range(3), range(n + 14, n + 17)] = samples.time[use]
    A[range(3), range(n + 17, n + 20)] = samples.time[use] ** 2
    prior = np.array([*motion.prior, *[_TURN] * 3, *PRIOR, _LAG, _LAG, *[_WARMTH] * 6])
    y = samples.readings[use, su].T - sensor[:3, None] - M @ g
    return A, y, prior
