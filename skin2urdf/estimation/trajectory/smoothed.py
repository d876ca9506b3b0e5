"""Joints that a driver smooths before it logs them.

Drivers low-pass what they read, or average it, each joint by its own. That makes joints late (see
:mod:`reading_times`), and takes from fast motion. What it takes is a series in derivatives of what
it leaves. Beside its delay, a pole at 1 / tau leaves ``(1 + s tau) exp(-s tau)`` to be made up for,
with s the Laplace variable, and a mean over a time W ``(s W / 2) / sinh(s W / 2)``.

Each of the two has one number for each joint, its share of the second derivative. Of any other
filter all derivatives have numbers of their own, as many of them as readings show: the higher a
derivative, the more of it is noise, which numbers then fall for.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import factorial

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.fit import Fitted, cost_with, held
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.reading_times import LATE, Read, ReadingTimes
from skin2urdf.estimation.trajectory.slack import CERTAIN, lacking, with_unseen
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import higher_derivatives, second_derivative
from skin2urdf.signals.trajectory import Trajectory

_TIME = 0.02
"""Unit of the times that filters have [s], which says how many numbers of a derivative are as many
as one of the next: those of a pole at 8 Hz are of one size then, and of others nearly so."""
_FIRST, _LAST = 4, 10
"""Orders of the derivatives that any filter is told by: of the highest at first, and of the highest
where the readings show more. What is beyond 4 is a hundredth of the motion, of a pole at 5 Hz and
patterns of 4 Hz; what is beyond 10 a thousandth, of a mean over 100 ms."""
_ORDERS = np.arange(2, _LAST + 1)


class _Smoothing(ReadingTimes):
    """Joints that are late, by so much per time that filters have, and smoothed by some filter.

    The first of its numbers are ages about their mean, then shares of second derivatives [s^2].
    """

    @abstractmethod
    def further(self, numbers: F64, n_joints: int) -> F64:
        """(O, D) how much of their second and further derivatives joints have lost [s^2, ...]."""

    @abstractmethod
    def slopes(self, logs: Sequence[Trajectory], numbers: F64) -> Unseen:
        """What joints are beyond their positions per unit of each number behind their ages."""

    def unseen(self, logs: Sequence[Trajectory], numbers: F64) -> Unseen | None:
        return _late_and(self.slopes(logs, numbers), logs)

    def told_by(self, logs: Sequence[Trajectory]) -> Unseen | None:
        # What play does where joints start has more of higher derivatives.
        return _late_and(_of_orders(logs, 2, 2), logs)

    def set_right(self, log: Trajectory, numbers: F64) -> Trajectory:
        D = log.q.shape[1]
        log = log.each_joint_taken(self.ages(numbers, D))
        return log.with_joints_further(self.further(numbers, D))

    def ages(self, numbers: F64, n_joints: int) -> F64:
        return LATE.ages(numbers[: n_joints - 1] / _TIME, n_joints)

    def smoothing(self, numbers: F64, n_joints: int) -> F64:
        return numbers[n_joints - 1 : 2 * n_joints - 1]

    def is_possible(self, numbers: F64, n_joints: int) -> bool:
        """Whether joints have less of fast motion, never more."""
        return bool(self.smoothing(numbers, n_joints).sum() < 0)

    def unreached(self, logs: Sequence[Trajectory], numbers: F64) -> float:
        further = self.further(numbers, logs[0].q.shape[1])
        last = int(np.flatnonzero(further.any(axis=1))[-1])
        part = 0.0
        for log in logs:
            of_last = higher_derivatives(log.smoothed, log.rate, last + 2)[-1] * further[last]
            made, whole = second_derivative(of_last, log.rate)[log.kept], log.qdd[log.kept]
            moves = whole.any(axis=0)
            part = max(part, *(made[:, moves].std(axis=0) / whole[:, moves].std(axis=0)), 0.0)
        return part

    def leaves(
        self, found: tuple[MotionProblem, Fitted, Read], first: int, last: int, size: float
    ) -> bool:
        """Whether readings show for certain more of derivatives than it has found.

        Args:
            found: the problem with positions set right, its fit, and how joints were read.
            first: of the derivatives' orders that it may lack, and
            last: of these.
            size: standard deviation of their numbers.
        """
        problem, fitted, read = found
        own = self.unseen(problem.logs, read.numbers)
        if own is None:
            return False
        # What its own numbers leave open is no sign of more.
        wider = with_unseen(problem, own, size)
        numbers = np.append(fitted.state.unseen, np.zeros(own.n_numbers))
        state = replace(fitted.state, unseen=numbers)
        more = _of_orders(problem.logs, first, last)
        return lacking(wider, held(wider, state), [more]).size(0).gain > CERTAIN


@dataclass(frozen=True)
class _Alike(_Smoothing):
    """Filters of one kind, of which each has one number: the share of the second derivative.

    Attributes:
        ratios: of derivatives' numbers and the powers of it, as if it were 1.
    """

    ratios: tuple[float, ...]

    def further(self, numbers: F64, n_joints: int) -> F64:
        size = np.maximum(-self.smoothing(numbers, n_joints), 0.0)
        return np.array(self.ratios)[:, None] * size ** (_ORDERS[:, None] / 2)

    def slopes(self, logs: Sequence[Trajectory], numbers: F64) -> Unseen:
        D = logs[0].q.shape[1]
        all_ = _of_orders(logs, 2, _LAST)
        known = self.smoothing(numbers, D) if len(numbers) else np.zeros(D)
        size, half = np.maximum(-known, 0.0), _ORDERS[:, None] / 2
        unit = -np.array(self.ratios)[:, None] * half * size ** (half - 1)
        return replace(all_, unit=unit.ravel(), number=all_.joint)


@dataclass(frozen=True)
class _Any(_Smoothing):
    """Filters of any kind, with a number for each derivative.

    Attributes:
        last: order of the highest.
    """

    last: int = _FIRST

    def further(self, numbers: F64, n_joints: int) -> F64:
        of_orders = numbers[n_joints - 1 :].reshape(-1, n_joints)
        return of_orders * _units(2 + np.arange(len(of_orders)))[:, None]

    def slopes(self, logs: Sequence[Trajectory], numbers: F64) -> Unseen:
        del numbers  # each goes with its derivative, whatever it is
        return _of_orders(logs, 2, self.last)

    def followed(
        self, problem: MotionProblem, fitted: Fitted, size: float
    ) -> tuple[MotionProblem, Fitted, Read] | None:
        # By a filter of few numbers where that explains as much: fewer follow noise.
        as_read = problem.logs
        found = super().followed(problem, fitted, size)
        if found is None:
            return None
        begin = found[2].numbers[: 2 * problem.tree.n_joints - 1]
        simple = [
            other
            for way in (_POLE, _MEAN)
            if (other := way.followed_from(problem, found[1].state, as_read, begin, size))
            and not way.leaves(other, 3, _FIRST, size)
        ]
        if simple:
            by = simple[0][1]
            return min(simple, key=lambda each: cost_with(by.weights, by.shaken, each[1]))
        way = self
        while way.last < _LAST and way.leaves(found, way.last + 1, way.last + 2, size):
            # Means have even ones alone.
            way, (problem, fitted, read) = _Any(way.last + 2), found
            finer = way.followed_from(problem, fitted.state, as_read, read.numbers, size)
            if finer is None:
                break
            found = finer
        return found


def _late_and(others: Unseen, logs: Sequence[Trajectory]) -> Unseen:
    """Motion of joints that are late, and by other numbers further."""
    late = LATE.unseen(logs, np.zeros(0))
    if late is None:
        return others
    columns, numbers = late.n_columns, late.n_numbers
    return Unseen(
        np.append(late.joint, others.joint),
        tuple(map(np.hstack, zip(late.motions, others.motions, strict=True))),
        column=np.append(late.column, columns + others.columns),
        unit=np.append(late.unit / _TIME, others.units),
        number=np.append(late.number, numbers + others.number),
        derivative=np.append(late.derivatives, others.derivatives),
    )


def _of_orders(logs: Sequence[Trajectory], first: int, last: int) -> Unseen:
    """Derivatives of positions as they were read, each joint's of each order with its number."""
    D = logs[0].q.shape[1]
    order, joint = np.divmod(np.arange((last + 1 - first) * D), D)
    read = [log.smoothed if len(log.smoothed) else log.q for log in logs]
    motions = tuple(
        np.hstack(list(higher_derivatives(q, log.rate, last)[first - 2 :]))
        for q, log in zip(read, logs, strict=True)
    )
    return Unseen(joint, motions, unit=_units(first + order), derivative=first + order)


def _units(order: Int) -> F64:
    """Units of numbers of derivatives of some orders, over that of the second."""
    return np.asarray(_TIME ** (order - 2.0))


_POLE = _Alike(
    tuple(-((-1) ** k) * (k - 1) / factorial(k) * 2 ** (k / 2) for k in map(int, _ORDERS))
)
"""Low-passes with one pole: with ``tau^2 = 2``, what multiplies powers of s."""
_MEAN = _Alike((-1.0, 0.0, 7 / 10, 0.0, -31 / 70, 0.0, 381 / 1400, 0.0, -73 / 440))
"""Means, with ``W^2 = 24``."""
SMOOTHED = _Any()
"""Joints that are late and smoothed."""
