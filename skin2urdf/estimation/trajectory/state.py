"""What a fit of all samples estimates beyond placements: clocks, front ends, drifts, gravity."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.estimation.problem.state import N_JOINT, N_SU, State, Step, screwed
from skin2urdf.estimation.trajectory.blueprint import further_moved
from skin2urdf.estimation.trajectory.front_end import N_FRONT

N_CLOCK = 2
"""Coordinates of an SU's clock in a log: lag and drift."""
N_WARMING = 2
"""Coordinates of what the scale of an axis changes by in a log."""
N_GYRO_MATRIX, N_GYRO, N_GYRO_BIAS = 9, 11, 3
"""Coordinates of a gyroscope: its sensitivity, row by row, with what else it always has (by how
much it is late, and its droop), and its bias in a log."""


@dataclass(frozen=True, eq=False)
class MotionState(Record):
    """All that predicts the readings along G logs of D joints and U SUs.

    Attributes:
        placements: placements, gravity's direction per log, bias and shape of the SUs.
        gravity: magnitude of gravity where the logs were recorded [m/s^2].
        front: (U, 2) front end of each SU, as in :mod:`front_end` [s^2].
        clock: (G, U, 2) by how much an SU's stamps are late in the middle of a log [s], and by how
            much more each second [1].
        knots: per log (B, U, 3) bias of each SU at B moments, above its own [m/s^2]; linear in
            between; none (B = 0) where biases are constant.
        curvature: (U, 3) by how much each axis reads more than a straight line does, over the
            square of what that does [s^2/m]; (0, 0) where all are straight.
        warming: (G, U, 2, 3) by how much the scale of each axis changes along a log, as its parts
            that go with time and with its square [1], polynomials of Legendre from the log's begin
            to its end; (0, 0, 2, 3) where all are steady.
        gyro: (U, 11 + 3 G) of each gyroscope, above a perfect one: sensitivity, row by row [1],
            delay behind the accelerometer [s], droop [s^2], biases in each log [rad/s]; (U, 0)
            where no SU has one.
        unseen: (S,) numbers that make the motion that encoders do not see, as in :mod:`unseen`.
    """

    placements: State
    gravity: float
    front: F64
    clock: F64
    knots: tuple[F64, ...]
    unseen: F64
    gyro: F64 = field(default_factory=lambda: np.zeros((0, 0)))
    curvature: F64 = field(default_factory=lambda: np.zeros((0, 0)))
    warming: F64 = field(default_factory=lambda: MotionState.no_warming())

    @staticmethod
    def no_warming() -> F64:
        """Changes of scales that are steady."""
        return np.zeros((0, 0, N_WARMING, 3))


@dataclass(frozen=True)
class Layout:
    """Where the coordinates of a fit stand: a joint part, and one part of each SU.

    Attributes:
        n_joints: D.
        n_logs: G.
        n_knots: B of each log.
        n_unseen: S.
        gyros: whether any SU has a gyroscope.
        curves: whether the axes of SUs may be curved.
        warms: whether the scales of SUs may drift.
        n_further: coordinates that a robot that is known before has beyond these.
    """

    n_joints: int
    n_logs: int
    n_knots: tuple[int, ...]
    n_unseen: int
    gyros: bool = False
    n_further: int = 0
    curves: bool = False
    warms: bool = False

    @property
    def joints(self) -> slice:
        """tx, ty [m], rx, ry [rad] of each joint."""
        return slice(0, N_JOINT * self.n_joints)

    @property
    def logs(self) -> slice:
        """Turns of gravity about the base x and y axes, from the second log on [rad]."""
        return slice(self.joints.stop, self.joints.stop + 2 * (self.n_logs - 1))

    @property
    def gravity(self) -> int:
        """Relative change of gravity's magnitude [1]."""
        return N_JOINT * self.n_joints + 2 * (self.n_logs - 1)

    @property
    def unseen(self) -> slice:
        """Numbers that make the motion that encoders do not see."""
        return slice(self.gravity + 1, self.gravity + 1 + self.n_unseen)

    @property
    def further(self) -> slice:
        """What may deviate of a robot that is known before, see :mod:`blueprint`."""
        return slice(self.unseen.stop, self.unseen.stop + self.n_further)

    @property
    def n_joint(self) -> int:
        """Number of coordinates of the joint part."""
        return int(self.further.stop)

    @property
    def front(self) -> slice:
        """An SU's front end, behind its placement, bias and shape."""
        return slice(N_SU, N_SU + N_FRONT)

    def clock(self, log: int) -> slice:
        """An SU's clock in a log."""
        begin = self.front.stop + N_CLOCK * log
        return slice(begin, begin + N_CLOCK)

    def knots(self, log: int) -> slice:
        """An SU's bias over time in a log: x, y, z of the first knot, of the second .."""
        begin = self.front.stop + N_CLOCK * self.n_logs + 3 * sum(self.n_knots[:log])
        return slice(begin, begin + 3 * self.n_knots[log])

    @property
    def curvature(self) -> slice:
        """The curvature of an SU's axes, behind its biases over time."""
        begin = self.front.stop + N_CLOCK * self.n_logs + 3 * sum(self.n_knots)
        return slice(begin, begin + 3 * self.curves)

    def warming(self, log: int) -> slice:
        """How an SU's scales change in a log: x, y, z with time, and with its square."""
        begin = self.curvature.stop + 3 * N_WARMING * log * self.warms
        return slice(begin, begin + 3 * N_WARMING * self.warms)

    @property
    def gyro(self) -> slice:
        """An SU's gyroscope, behind all that its accelerometer has."""
        begin = self.curvature.stop + 3 * N_WARMING * self.n_logs * self.warms
        return slice(begin, begin + self.gyros * (N_GYRO + N_GYRO_BIAS * self.n_logs))

    @property
    def n_su(self) -> int:
        """Number of coordinates of each SU."""
        return int(self.gyro.stop)

    def moved(self, state: MotionState, joint: F64, sus: F64) -> MotionState:
        """The state reached by a step.

        Args:
            state: where it begins.
            joint: (J,) step of the joint part.
            sus: (U, n) of the SUs.
        """
        step = Step(
            joint[self.joints].reshape(-1, N_JOINT),
            joint[self.logs].reshape(-1, 2),
            sus[:, :N_SU],
        )
        placements = screwed(state.placements, step)
        if self.n_further:
            placements = further_moved(placements, joint[self.further])
        clock = np.stack([sus[:, self.clock(g)] for g in range(self.n_logs)])
        knots = tuple(
            old + sus[:, self.knots(g)].reshape(len(sus), -1, 3).swapaxes(0, 1)
            for g, old in enumerate(state.knots)
        )
        warming = state.warming
        if self.warms:
            of_logs = [sus[:, self.warming(g)] for g in range(self.n_logs)]
            warming = warming + np.reshape(of_logs, warming.shape)
        return replace(
            state,
            placements=placements,
            gravity=state.gravity * (1 + joint[self.gravity]),
            front=state.front + sus[:, self.front],
            clock=state.clock + clock,
            knots=knots,
            unseen=state.unseen + joint[self.unseen],
            gyro=state.gyro + sus[:, self.gyro] if self.gyros else state.gyro,
            curvature=(
                state.curvature + sus[:, self.curvature] if self.curves else state.curvature
            ),
            warming=warming,
        )
