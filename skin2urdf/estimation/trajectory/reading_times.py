"""Joints that are read at other times than their common stamp says.

Servos on a bus are asked for their positions one after another, and one stamp is put on all of
them. A joint that is read late by T seems to be where it was, ``q = theta + T theta'`` to first
order: motion that encoders do not see, with one number for each joint, the same in all logs. What
all joints are late by alike is what all SUs are early by: lags are about their mean.

Every step is taken from positions that are set right by the ones before, so that what is left in
the end is of first order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import helmert

from skin2urdf.arrays import F64, Record
from skin2urdf.estimation.trajectory.fit import Fitted, fit, held
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import with_products
from skin2urdf.estimation.trajectory.records import Predicted
from skin2urdf.estimation.trajectory.slack import with_unseen
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.trajectory import Trajectory

_STEPS = 8
"""Times that positions are set right, at most; each leaves a hundredth of 10 ms."""
_SETTLED = 0.01
"""Last step over all of them from which positions are right: what is left of it is as small a part
of the step."""


@dataclass(frozen=True, eq=False)
class Read(Record):
    """How joints were read.

    Attributes:
        way: in which way.
        numbers: (S,) and how much.
    """

    way: ReadingTimes
    numbers: F64


class ReadingTimes(ABC):
    """A way in which joints are read otherwise than their stamps say, as a few numbers."""

    @abstractmethod
    def unseen(self, logs: Sequence[Trajectory], numbers: F64) -> Unseen | None:
        """What joints are beyond their positions per unit of each number; None of too few joints.

        Args:
            logs: trajectories with positions that were set right.
            numbers: (S,) by which they were; (0,) for none.
        """

    @abstractmethod
    def set_right(self, log: Trajectory, numbers: F64) -> Trajectory:
        """A log with positions where the joints are.

        Args:
            log: as it was read.
            numbers: (S,) how it was.
        """

    @abstractmethod
    def ages(self, numbers: F64, n_joints: int) -> F64:
        """(D,) how much older each joint's positions are than in the mean [s], of (S,) numbers."""

    def smoothing(self, numbers: F64, n_joints: int) -> F64:
        """(D,) by how much each joint is further per acceleration than it was read [s^2]."""
        del numbers  # what is only late has all of its motion
        return np.zeros(n_joints)

    def unreached(self, logs: Sequence[Trajectory], numbers: F64) -> float:
        """Part of a joint's accelerations that the last of a series in its motion makes up.

        The largest of all joints; what is beyond it is not set right.

        Args:
            logs: trajectories with positions that were set right.
            numbers: (S,) by which they were.
        """
        del logs, numbers  # a lag is no series
        return 0.0

    def told_by(self, logs: Sequence[Trajectory]) -> Unseen | None:
        """The part of it that nothing else looks like, which tells whether there is any of it.

        Args:
            logs: trajectories.
        """
        return self.unseen(logs, np.zeros(0))

    def is_possible(self, numbers: F64, n_joints: int) -> bool:
        """Whether anything reads joints like that."""
        del numbers, n_joints
        return True

    def followed(
        self, problem: MotionProblem, fitted: Fitted, size: float
    ) -> tuple[MotionProblem, Fitted, Read] | None:
        """The fit with positions set right; None where nothing reads joints like that.

        Args:
            problem: what was fitted, of as many joints as it takes.
            fitted: the fit.
            size: standard deviation of the numbers.

        Returns:
            The problem with positions where joints are, its fit, and how they were read.
        """
        return self.followed_from(problem, fitted.state, problem.logs, np.zeros(0), size)

    def followed_from(
        self,
        problem: MotionProblem,
        state: MotionState,
        as_read: Sequence[Trajectory],
        numbers: F64,
        size: float,
    ) -> tuple[MotionProblem, Fitted, Read] | None:
        """The same from where some of the numbers are known.

        Args:
            problem: with whatever positions.
            state: where the fit begins.
            as_read: logs as they were read.
            numbers: the first of the numbers, as far as they are known.
            size: standard deviation of the numbers.
        """
        problem, here = self._right(problem, state, as_read, numbers)
        for _ in range(_STEPS):
            more = self.unseen(problem.logs, numbers)
            if more is None:
                return None
            n = more.n_numbers
            begin = replace(state, unseen=np.append(state.unseen, np.zeros(n)))
            found = fit(with_unseen(problem, more, size), begin, near=True, predicted=here)
            step = found.state.unseen[-n:]
            numbers = np.pad(numbers, (0, n - len(numbers))) + step
            state = replace(found.state, unseen=found.state.unseen[:-n])
            problem, here = self._right(problem, state, as_read, numbers)
            if not self.is_possible(numbers, problem.tree.n_joints):
                return None
            if np.abs(step).max() <= _SETTLED * np.abs(numbers).max():
                break
        return problem, fit(problem, state, near=True, predicted=here), Read(self, numbers)

    def _right(
        self,
        problem: MotionProblem,
        state: MotionState,
        as_read: Sequence[Trajectory],
        numbers: F64,
    ) -> tuple[MotionProblem, tuple[Predicted, ...]]:
        """A problem with positions set right, and what a state predicts along these.

        Products of motions were known of positions as they were before.
        """
        right = [self.set_right(log, numbers) if len(numbers) else log for log in as_read]
        problem = problem.again(logs=[replace(log, beyond=None) for log in right])
        return with_products(problem, held(problem, state))


class _Late(ReadingTimes):
    """Joints that are read late, by so many seconds, about their mean."""

    def unseen(self, logs: Sequence[Trajectory], numbers: F64) -> Unseen | None:
        del numbers  # however late they are, it goes with their velocity
        mix = about_their_mean(logs[0].q.shape[1])
        if not mix.size:
            return None
        joint, number = np.indices(mix.shape).reshape(2, -1)
        motions = tuple(log.qd for log in logs)
        return Unseen(joint, motions, column=joint, unit=mix.ravel(), number=number)

    def set_right(self, log: Trajectory, numbers: F64) -> Trajectory:
        return log.each_joint_taken(self.ages(numbers, log.q.shape[1]))

    def ages(self, numbers: F64, n_joints: int) -> F64:
        return np.asarray(about_their_mean(n_joints) @ numbers)


def about_their_mean(n_joints: int) -> F64:
    """(D, D - 1) orthonormal directions of lags whose mean is 0."""
    return np.asarray(helmert(n_joints).T if n_joints > 1 else np.zeros((n_joints, 0)))


LATE = _Late()
"""Joints that are late alone."""
