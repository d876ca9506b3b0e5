"""Clocks of joints and of SUs that wander against each other.

An offset and a drift are all that clocks of good oscillators need. Clocks that are kept by the
network are slewed and stepped, and others warm up: SUs then read the robot now earlier, now later
than its joints say. All SUs read it so alike, and only where it moves, which nothing else does:
a smooth line along a log, whose size is learnt from the readings, says how much later they were
read. A step of a clock is a slope of some seconds in it.

Positions are taken to be stamped rightly, as everywhere. Where it is their clock that wanders, its
pace makes accelerations other than they are, now larger and now smaller, and all samples tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import BSpline

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.fit import Fitted, cost_with, fit
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import size_of, with_unseen
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.trajectory import Trajectory

_APART = 5.0
"""Time between the knots of the line [s]: a slewed clock takes minutes, a move tells the time."""
_MOST = 1 << 24
"""Values of all motions of a log at most, since memory goes with them: 128 MB."""
_STEPS = 5
"""Times at most that readings are taken later: a shift to first order is off by 5 %."""
_SETTLED = 1e-5
"""Change of how late readings are that is none [s]: 10 um at a metre per second."""
_LIKELIER = 20.0
"""Fall of chi-squared from which it is the joints' clock that wanders: chance makes it once in
20,000 times."""


def wandering(logs: Sequence[Trajectory]) -> Unseen | None:
    """What joints are beyond their positions per second that readings are late around each knot.

    Args:
        logs: trajectories.

    Returns:
        A number for each knot of each log, which moves all joints; None where all are too short.
    """
    parts = [_along(log) for log in logs]
    D = logs[0].q.shape[1]
    n = [part.shape[1] for part in parts]
    if not sum(n):
        return None
    motions = []
    for g, (log, part) in enumerate(zip(logs, parts, strict=True)):
        moved = (part[:, :, None] * log.qd[:, None, :]).reshape(len(log.q), -1)
        before, behind = D * sum(n[:g]), D * sum(n[g + 1 :])
        motions.append(np.pad(moved, ((0, 0), (before, behind))))
    return Unseen(
        np.tile(np.arange(D), sum(n)), tuple(motions), number=np.repeat(np.arange(sum(n)), D)
    )


def with_steady_clocks(
    problem: MotionProblem, fitted: Fitted
) -> tuple[MotionProblem, Fitted, tuple[F64, ...]]:
    """The fit with readings where they belong once clocks no longer wander.

    Args:
        problem: what was fitted.
        fitted: the fit.

    Returns:
        The problem with readings taken later, the fit, and by how much (N,) in each log [s].
    """
    late = tuple(np.zeros(len(log.q)) for log in problem.logs)
    logs = problem.logs
    for _ in range(_STEPS):
        more = wandering(problem.logs)
        if more is None:
            return problem, fitted, ()
        wider = with_unseen(problem, more, size_of(problem, fitted, more).size)
        zero = np.zeros(more.n_numbers)
        state = replace(fitted.state, unseen=np.append(fitted.state.unseen, zero))
        found = fit(wider, state, near=True).state
        x = found.unseen[-more.n_numbers :]
        steps = _lines(problem.logs, x)
        late = tuple(a + b for a, b in zip(late, steps, strict=True))
        problem = problem.again(logs=list(map(Trajectory.read_later, logs, late)))
        fitted = fit(problem, replace(found, unseen=found.unseen[: -len(x)]), near=True)
        if max(np.abs(step).max() for step in steps) < _SETTLED:
            break
    joints = np.arange(problem.tree.n_joints)
    taken = [log.joints_taken(joints, each) for log, each in zip(logs, late, strict=True)]
    others = problem.again(logs=taken)
    other = fit(others, fitted.state, near=True)
    weights, shaken = fitted.weights, fitted.shaken
    if cost_with(weights, shaken, other) < cost_with(weights, shaken, fitted) - _LIKELIER:
        return others, other, late
    return problem, fitted, late


def _lines(logs: Sequence[Trajectory], x: F64) -> tuple[F64, ...]:
    """Per log (N,) how late its readings are, by the numbers of all knots [s]."""
    parts = [_along(log) for log in logs]
    ends = np.cumsum([part.shape[1] for part in parts])[:-1]
    return tuple(part @ own for part, own in zip(parts, np.split(x, ends), strict=True))


def _along(log: Trajectory) -> F64:
    """(N, S) how much each of S knots counts along a log: cubic splines; none if it is short."""
    begin, end = float(log.time[0]), float(log.time[-1])
    pieces = int(min((end - begin) / _APART, _MOST / log.q.size - 3))
    if pieces < 2:
        return np.zeros((len(log.q), 0))
    every = (end - begin) / pieces
    knots = begin + every * np.arange(-3, pieces + 4)
    time = np.clip(np.arange(len(log.q)) / log.rate, knots[3], knots[-4])
    return np.asarray(BSpline.design_matrix(time, knots, 3).toarray())
