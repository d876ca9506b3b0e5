"""Joints that are read at other times than their common stamp says, or smoothed before they are.

Servos on a bus are asked for their positions one after another, and one stamp is put on all of
them. A joint that is read late by T seems to be where it was, ``q = theta + T theta'`` to first
order: motion that encoders do not see, with one number for each joint, the same in all logs. What
all joints are late by alike is what all SUs are early by: lags are about their mean.

Drivers smooth what they read, by low-passes or means, each joint by its own. That makes joints late
as well, and takes from fast motion. What it takes is a series in derivatives of what it leaves:
beside its delay, a pole at 1 / tau takes ``tau^2 / 2 theta''``, ``-tau^3 / 3 theta'''`` and
``tau^4 / 8 theta''''``, a mean over a time W ``W^2 / 24 theta''`` and
``-7 W^4 / 5760 theta''''``.

Every step is taken from positions that are set right by the ones before, so that what is left in
the end is of first order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import helmert

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.estimation.trajectory.fit import Fitted, fit, held
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import with_products
from skin2urdf.estimation.trajectory.slack import CERTAIN, lacking, with_unseen
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.trajectory import Trajectory, higher_derivatives

_STEPS = 8
"""Times that positions are set right, at most; each leaves a hundredth of 10 ms."""
_SETTLED = 0.01
"""Last step over all of them from which positions are right: what is left of it is as small a part
of the step."""
_TIME = 0.02
"""Unit of the times that filters have [s], which says how many numbers of a derivative are as many
as one of the next: those of a pole at 8 Hz are of one size then, and of others nearly so."""
_FIRST, _LAST = 4, 10
"""Orders of the derivatives that a filter is told by: of the highest at first, and of the highest
where the readings show more. What is beyond 4 is a hundredth of the motion, of a pole at 5 Hz and
patterns of 4 Hz, or of a mean over 100 ms; what is beyond 8 of that a thousandth."""


class ReadingTimes(ABC):
    """A way in which joints are read otherwise than their stamps say, as a few numbers."""

    @abstractmethod
    def unseen(self, logs: Sequence[Trajectory]) -> Unseen | None:
        """What joints are beyond their positions per unit of each number; None of too few joints.

        Args:
            logs: trajectories.
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

    def told_by(self, logs: Sequence[Trajectory]) -> Unseen | None:
        """The part of it that nothing else looks like, which tells whether there is any of it.

        Args:
            logs: trajectories.
        """
        return self.unseen(logs)

    def is_possible(self, numbers: F64, n_joints: int) -> bool:
        """Whether anything reads joints like that."""
        del numbers, n_joints
        return True

    def finer(self) -> ReadingTimes | None:
        """The same by more numbers, of which the first are those it has; None where it has all."""
        return None

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
        way, as_read, numbers = self, problem.logs, np.zeros(0)
        while True:
            found = way._step_by_step(problem, fitted, as_read, numbers, size)
            if found is None:
                return None
            problem, fitted, numbers = found
            finer = way.finer()
            if finer is None or not finer._shows_more(problem, fitted, len(numbers), size):
                return problem, fitted, Read(way, numbers)
            way = finer

    def _step_by_step(
        self,
        problem: MotionProblem,
        fitted: Fitted,
        as_read: Sequence[Trajectory],
        numbers: F64,
        size: float,
    ) -> tuple[MotionProblem, Fitted, F64] | None:
        """The problem with positions set right, its fit, and the numbers (S,).

        Args:
            problem: with positions as numbers so far have them.
            fitted: its fit.
            as_read: logs without them.
            numbers: the first of them as far as they are known; all others are 0 so far.
            size: standard deviation of the numbers.
        """
        state, predicted = fitted.state, fitted.predicted
        for _ in range(_STEPS):
            more = self.unseen(problem.logs)
            if more is None:
                break
            n = more.n_numbers
            begin = replace(state, unseen=np.append(state.unseen, np.zeros(n)))
            found = fit(with_unseen(problem, more, size), begin, near=True, predicted=predicted)
            step = found.state.unseen[-n:]
            numbers = np.pad(numbers, (0, n - len(numbers))) + step
            state = replace(found.state, unseen=found.state.unseen[:-n])
            # Products of motions were known of positions as they were before.
            right = [replace(self.set_right(log, numbers), beyond=None) for log in as_read]
            problem = problem.again(logs=right)
            problem, predicted = with_products(problem, held(problem, state))
            if not self.is_possible(numbers, problem.tree.n_joints):
                return None
            if np.abs(step).max() <= _SETTLED * np.abs(numbers).max():
                break
        return problem, fit(problem, state, near=True, predicted=predicted), numbers

    def _shows_more(self, problem: MotionProblem, fitted: Fitted, known: int, size: float) -> bool:
        """Whether readings show for certain more than the first of the numbers say.

        Args:
            problem: with positions set right by these.
            fitted: its fit.
            known: how many these are.
            size: standard deviation of the numbers.
        """
        every = self.unseen(problem.logs)
        if every is None:
            return False
        more = every.number >= known
        first, last = (
            replace(
                every,
                joint=every.joint[which],
                column=every.columns[which],
                unit=every.units[which],
                number=every.number[which] - least,
                origin=np.zeros(0),
                derivative=every.derivatives[which],
            )
            for which, least in ((~more, 0), (more, known))
        )
        # What the first leave open is no sign of more.
        wider = with_unseen(problem, first, size)
        state = replace(fitted.state, unseen=np.append(fitted.state.unseen, np.zeros(known)))
        open_ = held(wider, state)
        return lacking(wider, open_, [last]).size(0).gain > CERTAIN


@dataclass(frozen=True, eq=False)
class Read(Record):
    """How joints were read.

    Attributes:
        way: in which way.
        numbers: (S,) and how much.
    """

    way: ReadingTimes
    numbers: F64


class _Late(ReadingTimes):
    """Joints that are read late, by so many seconds, about their mean."""

    def unseen(self, logs: Sequence[Trajectory]) -> Unseen | None:
        mix = _about_their_mean(logs[0].q.shape[1])
        if not mix.size:
            return None
        joint, number = np.indices(mix.shape).reshape(2, -1)
        motions = tuple(log.qd for log in logs)
        return Unseen(joint, motions, column=joint, unit=mix.ravel(), number=number)

    def set_right(self, log: Trajectory, numbers: F64) -> Trajectory:
        return log.each_joint_taken(self.ages(numbers, log.q.shape[1]))

    def ages(self, numbers: F64, n_joints: int) -> F64:
        return np.asarray(_about_their_mean(n_joints) @ numbers)


@dataclass(frozen=True)
class _Smoothed(ReadingTimes):
    """Joints that are late, by so much per time that filters have, and smoothed [s^2].

    Attributes:
        last: derivative of the highest order that filters take.
    """

    last: int = _FIRST

    def unseen(self, logs: Sequence[Trajectory]) -> Unseen | None:
        read = [log.smoothed if len(log.smoothed) else log.q for log in logs]
        taken = [
            np.hstack(list(higher_derivatives(q, log.rate, self.last)))
            for q, log in zip(read, logs, strict=True)
        ]
        return _late_and(taken, logs)

    def finer(self) -> ReadingTimes | None:
        # Means have even ones alone.
        return _Smoothed(self.last + 2) if self.last < _LAST else None

    def told_by(self, logs: Sequence[Trajectory]) -> Unseen | None:
        # What play does where joints start has more of higher derivatives.
        return _late_and([log.qdd for log in logs], logs)

    def set_right(self, log: Trajectory, numbers: F64) -> Trajectory:
        D = log.q.shape[1]
        log = log.each_joint_taken(self.ages(numbers, D))
        of_orders = numbers[D - 1 :].reshape(-1, D)
        return log.with_joints_further(of_orders * _units(2 + np.arange(len(of_orders)))[:, None])

    def ages(self, numbers: F64, n_joints: int) -> F64:
        return LATE.ages(numbers[: n_joints - 1] / _TIME, n_joints)

    def smoothing(self, numbers: F64, n_joints: int) -> F64:
        return numbers[n_joints - 1 : 2 * n_joints - 1]

    def is_possible(self, numbers: F64, n_joints: int) -> bool:
        """Whether joints have less of fast motion, never more."""
        return bool(self.smoothing(numbers, n_joints).sum() < 0)


def _late_and(taken: Sequence[F64], logs: Sequence[Trajectory]) -> Unseen:
    """Motion of joints that are late, and by so many units more of their derivatives.

    Args:
        taken: per log (N, k D) second and higher derivatives of all joints.
        logs: trajectories.
    """
    D = logs[0].q.shape[1]
    order, joint = np.divmod(np.arange(taken[0].shape[1]), D)
    derivative = 2 + order
    unit = _units(derivative)
    late = LATE.unseen(logs)
    if late is None:
        return Unseen(joint, tuple(taken), unit=unit, derivative=derivative)
    return Unseen(
        np.append(late.joint, joint),
        tuple(map(np.hstack, zip(late.motions, taken, strict=True))),
        column=np.append(late.column, D + np.arange(len(joint))),
        unit=np.append(late.unit / _TIME, unit),
        number=np.append(late.number, D - 1 + np.arange(len(joint))),
        derivative=np.append(late.derivatives, derivative),
    )


def _units(order: Int) -> F64:
    """Units of numbers of derivatives of some orders, over that of the second."""
    return np.asarray(_TIME ** (order - 2.0))


def _about_their_mean(n_joints: int) -> F64:
    """(D, D - 1) orthonormal directions of lags whose mean is 0."""
    return np.asarray(helmert(n_joints).T if n_joints > 1 else np.zeros((n_joints, 0)))


LATE, SMOOTHED = _Late(), _Smoothed()
"""Joints that are late alone, and those that are late and smoothed."""
