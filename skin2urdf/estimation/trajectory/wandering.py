"""Clocks of joints and of SUs that wander against each other.

An offset and a drift are all that clocks of good oscillators need. Clocks that are kept by the
network are slewed and stepped, and others warm up: SUs then read the robot now earlier, now later
than its joints say. All SUs read it so alike, and only where it moves, which nothing else does:
a smooth line along a log, whose size is learnt from the readings, says how much later they were
read. What a step of a clock leaves of that tells when it was: the line gets one there.

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
from skin2urdf.estimation.trajectory.records import Predicted
from skin2urdf.estimation.trajectory.slack import size_of, with_unseen
from skin2urdf.estimation.trajectory.unseen import Unseen, eased
from skin2urdf.signals.filters import first_derivative
from skin2urdf.signals.trajectory import Trajectory

_APART = 5.0
"""Time between the knots of the line [s]: a slewed clock takes minutes, a move tells the time."""
_MOST = 1 << 24
"""Values of all motions of a log at most, since memory goes with them: 128 MB."""
_STEPS = 5
"""Times at most that readings are taken later: a shift to first order is off by 5 %."""
_NEARER = 0.5
"""Share of the last change that the next one has at most where what is followed is a clock, which
leaves a tenth or less. Where stamps contradict each other, changes go on and on."""
_SETTLED = 1e-5
"""Change of how late readings are that is none [s]: 10 um at a metre per second."""
_SETTINGS = 3
"""Steps of a clock in a log that are looked for at most; clocks are set once an hour."""
_RAMP = 1.0
"""Time over which a step of a clock moves joints smoothly to first order [s]: a quicker one would
push harder than robots do. Readings are then taken later at once."""
_LIKELIER = 20.0
"""Fall of chi-squared from which it is the joints' clock that wanders: chance makes it once in
20,000 times."""


def wandering(logs: Sequence[Trajectory], steps: Sequence[Sequence[float]] = ()) -> Unseen | None:
    """What joints are beyond their positions per second that readings are late around each knot.

    Args:
        logs: trajectories.
        steps: per log, times at which the clock steps [s]; none by default.

    Returns:
        A number for each knot and each step of each log, which moves all joints; None where all
        are too short.
    """
    parts = _parts(logs, steps, _RAMP)
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
    logs = problem.logs
    late = tuple(np.zeros(len(log.q)) for log in logs)
    steps: list[tuple[float, ...]] = [() for _ in logs]
    problem, fitted, smooth = _followed(problem, fitted, logs, late, steps)
    late = smooth
    while True:
        more = [
            (*known, *_step(log, known, p, w)) if len(known) < _SETTINGS else known
            for log, known, p, w in zip(logs, steps, fitted.predicted, fitted.weights, strict=True)
        ]
        if more == steps:
            break
        steps = more
        problem, fitted, late = _followed(problem, fitted, logs, late, steps)
    # A step has no pace, of whichever clock it is.
    of_joints = _of_joints(problem, fitted, logs, smooth)
    return (problem, fitted, late) if of_joints is None else (*of_joints, smooth)


def _of_joints(
    problem: MotionProblem, fitted: Fitted, logs: Sequence[Trajectory], late: tuple[F64, ...]
) -> tuple[MotionProblem, Fitted] | None:
    """The problem and its fit with joints taken later in place of readings, where it is likelier.

    Args:
        problem: with readings taken later.
        fitted: its fit.
        logs: with readings where they were.
        late: by how much later joints are taken, per log (N,) [s].
    """
    joints = np.arange(problem.tree.n_joints)
    taken = [log.joints_taken(joints, each) for log, each in zip(logs, late, strict=True)]
    others = problem.again(logs=taken)
    other = fit(others, fitted.state, near=True)
    least, here = (cost_with(fitted.weights, fitted.shaken, each) for each in (other, fitted))
    return (others, other) if least < here - _LIKELIER else None


def _followed(
    problem: MotionProblem,
    fitted: Fitted,
    logs: Sequence[Trajectory],
    late: tuple[F64, ...],
    steps: Sequence[Sequence[float]],
) -> tuple[MotionProblem, Fitted, tuple[F64, ...]]:
    """The problem, its fit and lateness (N,) of each log with the line that explains most.

    Args:
        problem: with readings taken later by some lateness.
        fitted: its fit.
        logs: with readings where they were.
        late: that lateness, per log (N,) [s].
        steps: per log, times at which the clock steps [s].
    """
    last = np.inf
    for _ in range(_STEPS):
        more = wandering(problem.logs, steps)
        if more is None:
            break
        wider = with_unseen(problem, more, size_of(problem, fitted, more).size)
        zero = np.zeros(more.n_numbers)
        state = replace(fitted.state, unseen=np.append(fitted.state.unseen, zero))
        found = fit(wider, state, near=True).state
        x = found.unseen[-more.n_numbers :]
        parts = _parts(logs, steps, 0.0)
        ends = np.cumsum([part.shape[1] for part in parts])[:-1]
        changes = [part @ own for part, own in zip(parts, np.split(x, ends), strict=True)]
        late = tuple(a + b for a, b in zip(late, changes, strict=True))
        problem = problem.again(logs=list(map(Trajectory.read_later, logs, late)))
        fitted = fit(problem, replace(found, unseen=found.unseen[: -len(x)]), near=True)
        change = max(np.abs(each).max() for each in changes)
        if change < _SETTLED or change > _NEARER * last:
            break
        last = change
    return problem, fitted, late


def _step(
    log: Trajectory, known: Sequence[float], predicted: Predicted, weights: F64
) -> tuple[float, ...]:
    """The time at which one more step of the clock explains most of what is left [s], if any does.

    What is left of a reading that changes tells how much later it was read; beside the line that
    suits all of a log, a step at each sample is one more column, and sums over what is behind it
    give them all at once.

    Args:
        log: the trajectory.
        known: times at which it steps already.
        predicted: of its K samples.
        weights: (K, U, 3) of their residuals.
    """
    changes = first_derivative(log.readings, log.rate)[log.kept]
    seen = np.where(predicted.measured[..., None], weights[..., :3], 0.0)
    residual = np.where(seen > 0, predicted.residual, 0.0)
    pull = np.einsum("kuc,kuc,kuc->k", seen, residual, changes)
    weight = np.einsum("kuc,kuc,kuc->k", seen, changes, changes)
    line = _along(log, known, 0.0)[log.kept]
    if not line.shape[1] or not weight.any():
        return ()
    N = np.linalg.pinv(line.T @ (weight[:, None] * line), hermitian=True)
    behind = np.cumsum((weight[:, None] * line)[::-1], axis=0)[::-1]
    total, left = (np.cumsum(x[::-1])[::-1] for x in (weight, pull))
    own = total - np.einsum("ks,st,kt->k", behind, N, behind)
    some = own > 1e-8 * total[0]  # or the line does as well, but for rounding
    for time in known:
        some &= np.abs(log.time - time) > _RAMP
    gains = np.zeros(len(own))
    gains[some] = (left - behind @ (N @ (line.T @ pull)))[some] ** 2 / own[some]
    usual = float((seen * residual**2).sum() / max(1, np.count_nonzero(seen)))
    best = int(np.argmax(gains))
    certain = gains[best] > (_LIKELIER + 2 * np.log(len(gains))) * usual
    return (float(log.time[best]),) if certain else ()


def _parts(logs: Sequence[Trajectory], steps: Sequence[Sequence[float]], ramp: float) -> list[F64]:
    """Per log (N, S) what :func:`_along` has."""
    return [_along(log, steps[g] if steps else (), ramp) for g, log in enumerate(logs)]


def _along(log: Trajectory, steps: Sequence[float], ramp: float) -> F64:
    """(N, S) how much each knot and each step counts along a log; none if it is short.

    Args:
        log: the trajectory.
        steps: times at which its clock steps [s].
        ramp: time that a step takes [s]; 0 where it is one.
    """
    begin, end = float(log.time[0]), float(log.time[-1])
    pieces = int(min((end - begin) / _APART, _MOST / log.q.size - 3))
    if pieces < 2:
        return np.zeros((len(log.q), 0))
    every = (end - begin) / pieces
    knots = begin + every * np.arange(-3, pieces + 4)
    time = np.arange(len(log.q)) / log.rate
    cubic = BSpline.design_matrix(np.clip(time, knots[3], knots[-4]), knots, 3).toarray()
    since = time[:, None] - np.asarray(steps)
    stepped = eased(np.clip(since / ramp + 0.5, 0.0, 1.0)) if ramp else since >= 0.0
    return np.hstack([cubic, stepped])
