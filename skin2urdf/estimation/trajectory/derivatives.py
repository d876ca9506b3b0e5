"""Derivatives of all that SUs are predicted to read along the logs, in all coordinates of a fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.polynomial.legendre import legvander

from skin2urdf.arrays import F32, F64, Bool, Int
from skin2urdf.estimation.problem.state import (
    JOINT_COORDINATES,
    N_JOINT,
    N_PLACEMENT,
    N_SU,
)
from skin2urdf.estimation.trajectory.blueprint import ALONG_AXIS, further_columns, turn_axes
from skin2urdf.estimation.trajectory.front_end import Spectrum, front_end_slopes
from skin2urdf.estimation.trajectory.gyro import rate_columns, with_gyros
from skin2urdf.estimation.trajectory.kinematics import (
    FrameMotion,
    Path,
    frame_motions,
    joint_columns,
    placed,
    placement_columns,
    seen_before_joint,
    seen_from_parent,
)
from skin2urdf.estimation.trajectory.links import LinkRows
from skin2urdf.estimation.trajectory.points import SharedPoints, shared_points
from skin2urdf.estimation.trajectory.priors import (
    MotionPriors,
    sense,
)
from skin2urdf.estimation.trajectory.records import Predicted, Turned
from skin2urdf.estimation.trajectory.rows import Beyond, Rows
from skin2urdf.estimation.trajectory.skeleton import Skeleton
from skin2urdf.estimation.trajectory.state import N_WARMING, Layout, MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree
from skin2urdf.threads import each


@dataclass(frozen=True, eq=False)
class Carried:
    """The SUs of a link in a log, and what their own derivatives are made of.

    Attributes:
        link: the link with its points.
        frames: motion of the frames in which joints are placed, and of those that they carry.
        predicted: the log held against the state.
        weights: (K, U, 3) information of each of its samples; gyroscopes' behind it.
    """

    link: SharedPoints
    frames: tuple[list[FrameMotion], list[FrameMotion]]
    predicted: Predicted
    weights: F64


_SHAPE = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


class Derivatives:
    """Logs, what is estimated of them, and derivatives of what is predicted.

    Args:
        tree: D joints and U SUs.
        logs: trajectories, with columns in the tree's order.
        priors: what is known before.
        n_knots: moments between which biases are linear in each log.
        unseen: what encoders do not see; of as many numbers as ``priors.unseen`` has.
    """

    def __init__(
        self,
        tree: KinematicTree,
        logs: Sequence[Trajectory],
        priors: MotionPriors,
        n_knots: Sequence[int] | None = None,
        unseen: Unseen | None = None,
    ) -> None:
        self.tree, self.logs, self.priors = tree, tuple(logs), priors
        self.unseen = unseen
        self.skeleton = Skeleton.of(tree, unseen.joint if unseen else ())
        self._seconds = tuple(float(log.time[-1] - log.time[0]) for log in self.logs)
        knots = tuple(n_knots or [0] * len(self.logs))
        self.gyros = with_gyros(tree, self.logs)
        # Of a known robot, those whose placements are estimated.
        blueprint = priors.blueprint
        self._estimated = (
            np.any(blueprint.deviations > 0, axis=1)
            if blueprint
            else np.ones(tree.n_joints, dtype=bool)
        )
        self.layout = Layout(
            tree.n_joints,
            len(self.logs),
            knots,
            len(priors.unseen),
            any(log.rates is not None for log in self.logs),
            priors.blueprint.n_coordinates if priors.blueprint else 0,
            curves=priors.curvature > 0,
            warms=priors.warming > 0,
        )

    @cached_property
    def _motions(self) -> tuple[F32, ...]:
        """Per log what each number moves; steps that fail never ask."""
        return self.unseen.at_kept(self.logs) if self.unseen else ()

    def knot_shares(self, g: int) -> F64:
        """(K, B) how much each knot counts at the kept samples of a log; linear in between."""
        n, time = self.layout.n_knots[g], self.logs[g].time
        if not n:
            return np.zeros((len(time), 0))
        at = (time - time[0]) / (time[-1] - time[0]) * (n - 1)
        return np.asarray(np.maximum(0.0, 1 - np.abs(at[:, None] - np.arange(n))))

    def course(self, g: int) -> F64:
        """(K, 2) what goes with time at the kept samples of a log, and with its square.

        (K, 0) where scales are steady.
        """
        time = self.logs[g].time
        if not self.layout.warms:
            return np.zeros((len(time), 0))
        part = 2 * (time - time[0]) / max(float(time[-1] - time[0]), 1e-12) - 1
        return np.asarray(legvander(part, N_WARMING)[:, 1:])

    def points(self, state: MotionState) -> tuple[SharedPoints, ...]:
        """The links of the tree with hinges that carry SUs, and the points that stand for them."""
        T = self.skeleton.su_placements(state.placements.T_joint_su)
        return shared_points(self.skeleton.tree.su_joint, T)

    def moved(self, state: MotionState, g: int) -> Trajectory:
        """A log with the motion of the links, of which encoders do not see all."""
        log = self.logs[g]
        return self.unseen.moved(log, g, state.unseen) if self.unseen else log

    def lags(self, state: MotionState, g: int) -> F64:
        """(K, U) by how much the readings of a log are late [s]."""
        lag, drift = state.clock[g].T
        return np.asarray(lag + drift * self._since_middle(g)[:, None])

    def read_at(self, state: MotionState, g: int) -> F64:
        """(K, U) where on the grid of a log each SU took what is compared, in samples."""
        log = self.logs[g]
        return np.asarray(log.kept[:, None] + log.rate * self.lags(state, g))

    def _since_middle(self, g: int) -> F64:
        """(K,) times since the middle of a log [s]."""
        time = self.logs[g].time
        return np.asarray(time - 0.5 * (time[0] + time[-1]))

    def _frames(
        self, state: MotionState, g: int
    ) -> tuple[tuple[F64, F64, F64], tuple[list[FrameMotion], list[FrameMotion]]]:
        """Motion (H + D, K) of hinges and joints at the samples compared, and of their frames."""
        log, skeleton = self.moved(state, g), self.skeleton
        at = np.ix_(log.kept, skeleton.numbers)
        q, qd, qdd = (np.ascontiguousarray(x[at].T) for x in (log.q, log.qd, log.qdd))
        up = state.placements.up[g] * state.gravity
        T = skeleton.placements(state.placements.T_parent_joint)
        return (q, qd, qdd), frame_motions(skeleton.tree, T, up, q, qd, qdd)

    def links(
        self, state: MotionState, predicted: Sequence[Predicted], weights: Sequence[F64]
    ) -> Iterator[tuple[LinkRows, Carried]]:
        """Every log and link whose SUs count, and what the rest of their derivatives is made of."""
        matrices = state.placements.sensor_matrix() * sense(self.priors, state)
        for g, (p, w) in enumerate(zip(predicted, weights, strict=True)):
            motion, frames = self._frames(state, g)
            for link in self.points(state):
                if not w[:, link.sus].any():
                    continue
                left = np.where(p.measured[:, link.sus, None], p.residual[:, link.sus], 0.0)
                yield (
                    LinkRows(
                        log=g,
                        sus=link.sus,
                        columns=self._joint_columns(int(link.sus[0]), g),
                        of_points=self._columns_of_points(state, g, link, frames, motion),
                        joints=self._yielding(int(link.sus[0])),
                        sensed=link.sensed(matrices[link.sus]),
                        weights=np.ascontiguousarray(np.moveaxis(w[:, link.sus, :3], 0, 2)),
                        residual=np.ascontiguousarray(np.moveaxis(left, 0, 2)),
                    ),
                    Carried(link, frames, p, w),
                )

    def rows(
        self, state: MotionState, predicted: Sequence[Predicted], weights: Sequence[F64]
    ) -> Iterator[Rows]:
        """Whitened derivatives and residuals of every log and SU.

        Args:
            state: where.
            predicted: residuals of each log there.
            weights: per log (K, U, 3) information of each sample [s^4/m^2].
        """
        for link, carried in self.links(state, predicted, weights):
            yield from self._rows_of(state, link, carried)

    def _rows_of(self, state: MotionState, link: LinkRows, carried: Carried) -> Iterator[Rows]:
        """The rows of the SUs of a link."""
        C, K = len(link.columns), link.weights.shape[2]
        of_points = link.of_points.reshape(len(link.of_points), -1)
        every = (
            pair
            for at, each in self.own(state, link, carried)
            for pair in zip(range(at.start, at.stop), each, strict=True)
        )
        for i, own in every:
            root = np.sqrt(link.weights[i])
            by_joints = (link.sensed[i] @ of_points).reshape(3, -1, K).swapaxes(0, 1)
            A = np.empty((C + self.layout.n_su, 3, K))
            np.multiply(by_joints[:C], root, out=A[:C])
            np.multiply(own, root, out=A[C:])
            by_motion = (by_joints[C:] * root).reshape(len(link.joints), 3, 3, K)
            u = int(link.sus[i])
            yield Rows(
                link.log, u, link.columns, A, link.residual[i] * root, link.joints, by_motion
            )
            yield from self.gyro_rows(state, link.log, u, carried)

    def own(
        self, state: MotionState, link: LinkRows, carried: Carried
    ) -> Iterator[tuple[slice, F64]]:
        """Of some SUs of a link at a time, by their places there, derivatives (s, n, 3, K)."""
        parts = self.own_parts(state, link, carried)
        return each(lambda part: (part[0], part[1]()), parts, len(link.sus))

    def own_parts(
        self, state: MotionState, link: LinkRows, carried: Carried
    ) -> Iterator[tuple[slice, Callable[[], F64]]]:
        """The same places, and what works the derivatives out: for several at a time, if wanted."""
        K = link.weights.shape[2]
        motion = carried.frames[1][carried.link.joint]
        felt = np.concatenate([motion.A.reshape(9, K), motion.f])
        predicted, (within, rate, margin) = carried.predicted, compared(self.logs[link.log])
        of_points = [
            Spectrum.of(carried.link.series(x), rate, margin)
            for x in np.split(predicted.felt, 2, axis=1)
            if predicted.rates is None
        ]

        def of(some: SharedPoints) -> F64:
            if predicted.rates is not None:
                rates = predicted.rates[:, :, some.sus].transpose(2, 0, 3, 1)
            else:
                rates = self._rates(state, some, of_points)[..., within]
            own = np.empty((len(some.sus), self.layout.n_su, 3, K))
            weight = self._own_weights(state, some.sus)
            flat = own.reshape(len(own), -1, K)
            np.matmul(weight, felt, out=flat[:, : weight.shape[1]])
            for rate, out in zip(rates, own, strict=True):
                self._further_columns(link.log, rate, out)
            self._reading_columns(link.log, own)
            return own

        first = 0
        for some in carried.link.parts():
            yield slice(first, first + len(some.sus)), partial(of, some)
            first += len(some.sus)

    def _reading_columns(self, g: int, own: F64) -> None:
        """Derivatives in what goes with an axis' own reading: its curvature, and its scale's drift.

        Args:
            g: number of the log.
            own: (S, n, 3, K) derivatives in what SUs have of their own, of which these are filled.
        """
        if not (self.layout.curves or self.layout.warms):
            return
        # What axes read in a straight line is all but what a perfect sensor does.
        axes = np.arange(3)
        perfect = own[:, N_PLACEMENT + 3 + axes, axes]
        if self.layout.curves:
            own[:, self.layout.curvature.start + axes, axes] = perfect**2
        begin = self.layout.warming(g).start
        for n, part in enumerate(self.course(g).T):
            own[:, begin + 3 * n + axes, axes] = part * perfect

    def gyro_rows(self, state: MotionState, g: int, u: int, carried: Carried) -> Iterator[Rows]:
        """The rows of an SU's gyroscope, if it has one."""
        turned = carried.predicted.turned
        if turned is None or not self.gyros[u]:
            return
        A = self._gyro_columns(state, g, u, carried.frames, turned)
        root = np.sqrt(carried.weights[:, u, 3:].T)
        none = np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3, root.shape[1]))
        yield Rows(g, u, self.all_columns(u, g), A * root, turned.residual[:, u].T * root, *none)

    def _rates(self, state: MotionState, some: SharedPoints, of_points: Sequence[Spectrum]) -> F64:
        """(S, 3, 3, M) derivatives of the readings of some SUs in time and in their front ends.

        Args:
            state: where.
            some: the SUs.
            of_points: what the points of their link feel, and its derivative in time.
        """
        sensed = some.sensed(state.placements.sensor_matrix()[some.sus])
        read, slope = (each.mixed(sensed) for each in of_points)
        in_time, by_front = front_end_slopes(read, slope, state.front[some.sus])
        return np.concatenate([in_time[None], by_front]).swapaxes(0, 1)

    def _joint_columns(self, u: int, g: int) -> list[int]:
        """Columns of the joint part that an SU's readings depend on, but for what is unseen."""
        layout, chain = self.layout, self._estimated_before(u)
        columns = [N_JOINT * k + i for k in chain for i in range(N_JOINT)]
        if g > 0:
            columns += range(layout.logs.start + 2 * (g - 1), layout.logs.start + 2 * g)
        columns.append(layout.gravity)
        if self.priors.blueprint:
            columns += further_columns(layout.further.start, chain, g)
        return columns

    def all_columns(self, u: int, g: int) -> list[int]:
        """Columns of the joint part that an SU depends on, those of what is unseen as well.

        Args:
            u: number of the SU.
            g: number of the log.
        """
        layout, columns = self.layout, self._joint_columns(u, g)
        behind = columns.index(layout.gravity) + 1
        return [*columns[:behind], *(layout.unseen.start + self._moving(u)), *columns[behind:]]

    def beyond(self) -> tuple[Beyond, ...]:
        """Per log what encoders do not see; () where they see all."""
        first = self.layout.unseen.start
        return tuple(Beyond(self.unseen, each, first) for each in self._motions if self.unseen)

    def _yielding(self, u: int) -> Int:
        """(m,) numbers of what carries an SU and moves beyond its encoder."""
        if self.unseen is None:
            return np.zeros(0, dtype=np.int64)
        return np.unique(self.unseen.joint[self._felt(self.unseen, u)])

    def _estimated_before(self, u: int) -> list[int]:
        """Joints before an SU, from the ground on, whose placements are estimated."""
        chain = self.tree.chain(int(self.tree.su_joint[u]))
        return [k for k in chain if self._estimated[k]]

    def _moving(self, u: int) -> Int:
        """Which of the numbers that make unseen motion an SU feels."""
        if self.unseen is None:
            return np.zeros(0, dtype=np.int64)
        return np.unique(self.unseen.number[self._felt(self.unseen, u)])

    def _felt(self, unseen: Unseen, u: int) -> Bool:
        """(E,) entries of unseen motion that an SU feels."""
        carried_by = self.skeleton.numbers[list(self._chain(u))]
        return np.asarray(np.isin(unseen.joint, carried_by))

    def _chain(self, u: int) -> tuple[int, ...]:
        """What carries an SU, from the ground on: places in the tree with hinges."""
        return self.skeleton.tree.chain(int(self.skeleton.tree.su_joint[u]))

    def _gyro_columns(
        self,
        state: MotionState,
        g: int,
        u: int,
        frames: tuple[list[FrameMotion], list[FrameMotion]],
        turned: Turned,
    ) -> F64:
        """(C + n, 3, K) derivatives of what an SU's gyroscope is predicted to read."""
        fixed, carried = frames
        tree, numbers = self.skeleton.tree, self.skeleton.numbers
        T = self.skeleton.su_placements(state.placements.T_joint_su)[u]
        here = placed(carried[int(tree.su_joint[u])], T)
        none = np.zeros(0, dtype=np.int64)
        unseen = none, none, np.zeros((2, 0, here.w.shape[1]))
        if self.unseen:
            felt = self._felt(self.unseen, u)
            number = np.searchsorted(self._moving(u), self.unseen.number[felt])
            motions = self._motions[g][:2, self.unseen.columns[felt]]
            unseen = self.unseen.joint[felt], number, motions * self.unseen.units[felt, None]
        slides = dict(zip(numbers.tolist(), tree.prismatic.tolist(), strict=True))
        of_number = dict(zip(numbers.tolist(), fixed, strict=True)), here
        slopes = turned.slope[:, u], turned.bend[:, u], self._since_middle(g)
        before = self._estimated_before(u)
        return rate_columns(before, state, self.layout, g, u, of_number, slides, unseen, slopes)

    def _columns_of_points(
        self,
        state: MotionState,
        g: int,
        link: SharedPoints,
        frames: tuple[list[FrameMotion], list[FrameMotion]],
        motion: tuple[F64, F64, F64],
    ) -> F64:
        """Derivatives of what a link's points feel in the joint part, in its frame.

        Returns:
            (3 p, C + 3 m, K) in C coordinates, and in position, velocity and acceleration of each
            of m joints that move beyond their encoders.
        """
        u, (fixed, carried) = int(link.sus[0]), frames
        pull = np.einsum(
            "ijk,j->ik", carried[link.joint].R_frame_base, state.placements.up[g] * state.gravity
        )
        C, K = len(self._joint_columns(u, g)) + 3 * len(self._yielding(u)), pull.shape[1]
        out = np.empty((len(link.arms), 3, C, K))
        for i, arm in enumerate(link.arms):
            T = np.eye(4)
            T[:3, 3] = arm
            here = placed(carried[link.joint], T)
            before, behind = self._columns_of_path(state, g, u, fixed, motion, here.R_frame_base, T)
            # With gravity grow the accelerations that a reading stands for.
            rows = [*before, (pull - here.f)[None], *behind]
            np.concatenate(rows, out=out[i].swapaxes(0, 1))
        return out.reshape(-1, C, K)

    def _columns_of_path(
        self,
        state: MotionState,
        g: int,
        u: int,
        fixed: list[FrameMotion],
        motion: tuple[F64, F64, F64],
        R_link_base: F64,
        T: F64,
    ) -> tuple[list[F64], list[F64]]:
        """Derivatives (c, 3, K) of what is felt at T (4, 4) of an SU's link, in its frame.

        Returns:
            In the coordinates before the size of gravity, and in those behind it and in the motion
            that encoders do not see.
        """
        places = state.placements
        tree, numbers = self.skeleton.tree, self.skeleton.numbers
        q, qd, qdd = motion
        rows: list[F64] = []
        yielding = set(self._yielding(u).tolist())
        by_motion: dict[int, F64] = {}
        path = fixed_path(T, q.shape[1])
        # A known robot may also deviate along and about its axes.
        known = self.priors.blueprint is not None
        wanted = JOINT_COORDINATES + ALONG_AXIS if known else JOINT_COORDINATES
        along_axis: list[F64] = []
        placements = self.skeleton.placements(places.T_parent_joint)
        estimated = set(self._estimated_before(u))
        for j in reversed(self._chain(u)):
            if not yielding and not estimated:
                break
            slides, number = bool(tree.prismatic[j]), int(numbers[j])
            path = seen_before_joint(path, slides, q[j], qd[j], qdd[j])
            if number in estimated:
                estimated.remove(number)
                columns = placement_columns(fixed[j], path, wanted)
                rows.append(columns[: len(JOINT_COORDINATES)])
                along_axis.append(columns[len(JOINT_COORDINATES) :])
            if number in yielding:
                yielding.remove(number)
                by_motion[number] = joint_columns(fixed[j], path, slides)
            path = seen_from_parent(path, placements[j])
        rows.reverse()
        if g > 0:
            turn = np.cross(np.eye(3)[:2], places.up[g]) * state.gravity
            rows.append(np.einsum("ijk,cj->cik", R_link_base, turn))
        behind: list[F64] = []
        if known:
            if g == 0:
                turn = np.cross(turn_axes(places.up[0]).T, places.up[0]) * state.gravity
                behind.append(np.einsum("ijk,cj->cik", R_link_base, turn))
            behind += reversed(along_axis)
        behind += [by_motion[number] for number in sorted(by_motion)]
        return rows, behind

    def _own_weights(self, state: MotionState, sus: Int) -> F64:
        """(S, 3 N_SU, 12) what makes derivatives in placements, biases and shapes of SUs.

        All of them are linear in what their link feels: in A (9), its specific force per position,
        and in that of its origin (3). Where SUs on a link are many, one product is all it takes.

        Args:
            state: where.
            sus: (S,) the SUs, all on one link.
        """
        T = self.skeleton.su_placements(state.placements.T_joint_su)[sus]
        sensed = sense(self.priors, state)
        matrix = state.placements.sensor_matrix()[sus] * sensed
        R, S = T[:, :3, :3], len(sus)
        # A force at an SU is R' (f + A r), and its A is R' A R.
        by_A = np.einsum("spm,sq->smpq", R, T[:, :3, 3]).reshape(S, 3, 9)
        force = np.concatenate([by_A, np.swapaxes(R, 1, 2)], axis=2)
        out = np.zeros((S, N_SU, 3, 12))
        turned = matrix @ np.swapaxes(R, 1, 2)
        out[:, :3, :, :9] = np.einsum("snp,sqi->sinpq", turned, R).reshape(S, 3, 3, 9)
        out[:, 3:N_PLACEMENT] = np.einsum("snm,iml,slx->sinx", matrix, _TURNED, force)
        out[:, N_PLACEMENT + 3 :] = np.einsum("ncl,slx->scnx", SENSES[:, 3:, 1:], force * sensed)
        return out.reshape(S, 3 * N_SU, 12)

    def _further_columns(self, g: int, rates: F64, out: F64) -> None:
        """Derivatives of an SU's prediction in its own coordinates but for those of placement.

        Args:
            g: number of the log.
            rates: (3, 3, K) derivatives in time and in its front end.
            out: (n, 3, K) is filled, shapes aside.
        """
        layout = self.layout
        out[N_PLACEMENT + np.arange(3), np.arange(3)] = 1.0
        out[N_SU:] = 0.0
        out[layout.front] = rates[1:]
        out[layout.clock(g)] = -rates[0], self._since_middle(g) * -rates[0]
        knots = out[layout.knots(g)]
        if len(knots):
            shares = self.knot_shares(g).T
            for i in range(3):
                knots[i::3, i] = shares


def _senses() -> F64:
    out = np.zeros((3, 9, 4))
    out[range(3), range(3), 0] = 1.0
    for i, (a, b) in enumerate(_SHAPE):
        out[a, 3 + i, 1 + b] = 1.0
        out[b, 3 + i, 1 + a] = 1.0
    return out


SENSES = _senses()
"""(3, 9, 4) by axis, what bias and shape make of 1 and what a perfect sensor would read."""


def _turned() -> F64:
    out = np.zeros((3, 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[i, j, k], out[i, k, j] = 1.0, -1.0
    return out


_TURNED = _turned()
"""(3, 3, 3) by axis, what a turn of an SU about it makes of the force that it feels."""


def fixed_path(T: F64, n: int) -> Path:
    """Path of n samples of an SU that is fixed to a frame by T (4, 4)."""
    still = np.zeros((3, n))
    return Path(still + T[:3, 3:4], still, still, np.repeat(T[:3, :3, None], n, axis=2))


def compared(log: Trajectory) -> tuple[slice, float, int]:
    """Of samples from end to end of a log at the rate of those that are compared: which these are.

    Returns:
        Where they are, their rate [Hz], and for how many of them the low-pass is felt.
    """
    first = int(log.kept[0]) // log.every
    margin = -(-len(log.taps) // log.every)
    within = slice(first, first + log.thin * len(log.kept), log.thin)
    return within, log.rate / log.every, margin
