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
from dataclasses import replace

import numpy as np
from scipy.linalg import helmert

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.fit import Fitted, fit, held
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import with_products
from skin2urdf.estimation.trajectory.slack import with_unseen
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import first_derivative, second_derivative
from skin2urdf.signals.trajectory import Trajectory

_STEPS = 8
"""Times that positions are set right, at most; each leaves a hundredth of 10 ms."""
_SETTLED = 0.01
"""Last step over all of them from which positions are right: what is left of it is as small a part
of the step."""
_TIME = 0.02
"""Unit of the times that filters have [s], which says how many numbers of a derivative are as many
as one of the next: those of a pole at 8 Hz are of one size then, and of others nearly so."""
_ORDERS = (2, 3, 4)
"""Derivatives that a filter takes from motion: what is beyond them is a hundredth of it, of a pole
at 5 Hz and patterns of 4 Hz."""


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

    def followed(
        self, problem: MotionProblem, fitted: Fitted, size: float
    ) -> tuple[MotionProblem, Fitted, F64] | None:
        """The fit with positions set right; None where nothing reads joints like that.

        Args:
            problem: what was fitted, of as many joints as it takes.
            fitted: the fit.
            size: standard deviation of the numbers.

        Returns:
            The problem with positions where joints are, its fit, and the numbers (S,).
        """
        read, state, numbers = problem.logs, fitted.state, np.zeros(0)
        for _ in range(_STEPS):
            more = self.unseen(problem.logs)
            if more is None:
                break
            numbers = numbers if numbers.size else np.zeros(more.n_numbers)
            begin = replace(state, unseen=np.append(state.unseen, np.zeros(len(numbers))))
            wider = with_unseen(problem, more, size)
            found = fit(wider, begin, near=True)
            step = found.state.unseen[-len(numbers) :]
            numbers = numbers + step
            problem = problem.again(logs=[self.set_right(log, numbers) for log in read])
            state = replace(found.state, unseen=found.state.unseen[: -len(numbers)])
            if not self.is_possible(numbers, problem.tree.n_joints):
                return None
            if np.abs(step).max() <= _SETTLED * np.abs(numbers).max():
                break
        # Products of motions were known of positions as they were read.
        problem = problem.again(logs=[replace(log, beyond=None) for log in problem.logs])
        problem, predicted = with_products(problem, held(problem, state))
        return problem, fit(problem, state, near=True, predicted=predicted), numbers


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


class _Smoothed(ReadingTimes):
    """Joints that are late, by so much per time that filters have, and smoothed [s^2]."""

    def unseen(self, logs: Sequence[Trajectory]) -> Unseen | None:
        return _late_and([_taken_by_filters(log) for log in logs], logs)

    def told_by(self, logs: Sequence[Trajectory]) -> Unseen | None:
        # What play does where joints start has more of higher derivatives.
        return _late_and([log.qdd for log in logs], logs)

    def set_right(self, log: Trajectory, numbers: F64) -> Trajectory:
        D = log.q.shape[1]
        log = log.each_joint_taken(self.ages(numbers, D))
        taken = _taken_by_filters(log) * numbers[D - 1 :]
        return log.with_joints_further(taken.reshape(len(taken), len(_ORDERS), D).sum(axis=1))

    def ages(self, numbers: F64, n_joints: int) -> F64:
        return LATE.ages(numbers[: n_joints - 1] / _TIME, n_joints)

    def smoothing(self, numbers: F64, n_joints: int) -> F64:
        return numbers[n_joints - 1 : 2 * n_joints - 1]

    def is_possible(self, numbers: F64, n_joints: int) -> bool:
        """Whether joints have less of fast motion, never more."""
        return bool(self.smoothing(numbers, n_joints).sum() < 0)


def _late_and(taken: Sequence[F64], logs: Sequence[Trajectory]) -> Unseen:
    """Motion of joints that are late, and by so many units more of what filters take.

    Args:
        taken: per log (N, k D) of all joints, k times.
        logs: trajectories.
    """
    D = logs[0].q.shape[1]
    joint = np.arange(taken[0].shape[1]) % D
    late = LATE.unseen(logs)
    if late is None:
        return Unseen(joint, tuple(taken))
    return Unseen(
        np.append(late.joint, joint),
        tuple(map(np.hstack, zip(late.motions, taken, strict=True))),
        column=np.append(late.column, D + np.arange(len(joint))),
        unit=np.append(late.unit / _TIME, np.ones(len(joint))),
        number=np.append(late.number, D - 1 + np.arange(len(joint))),
    )


def _about_their_mean(n_joints: int) -> F64:
    """(D, D - 1) orthonormal directions of lags whose mean is 0."""
    return np.asarray(helmert(n_joints).T if n_joints > 1 else np.zeros((n_joints, 0)))


def _taken_by_filters(log: Trajectory) -> F64:
    """(N, 3 D) derivatives of the second to fourth order of all joints, as accelerations."""
    rate = log.rate
    both = first_derivative(log.qdd, rate), second_derivative(log.qdd, rate)
    parts = zip((log.qdd, *both), _ORDERS, strict=True)
    return np.hstack([x * _TIME ** (order - _ORDERS[0]) for x, order in parts])


LATE, SMOOTHED = _Late(), _Smoothed()
"""Joints that are late alone, and those that are late and smoothed."""
