"""Publishers of joint states with clocks of their own, as all samples tell them.

Stamps that are late by T make a joint seem where it was, ``q = theta + T theta'`` to first order:
motion that encoders do not see, with one number for all joints of a publisher, and one more for a
drift. All that is fitted follows these numbers; where the readings gain more by them than they
cost, they are found by Gauss-Newton, every step taken from positions that are moved in time, so
that what is left in the end is of first order. Steps lead to the right place from some 50 ms, so
that all lags are looked through first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import size_of
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.uncertainty import shared_covariance
from skin2urdf.estimation.trajectory.unseen import Unseen, together
from skin2urdf.signals.motion import publishers_beyond_first
from skin2urdf.signals.stretches import STRETCH, best_line
from skin2urdf.signals.trajectory import Trajectory

N_CLOCK = 2
"""Numbers of a clock: how late it is in the middle of a log, and how much more at the end [s]."""
_WIDE = 0.1
"""Standard deviation of those numbers that is known before [s], wide beside what they are found
to: sizes beyond it are looked through."""
_CERTAIN = 10.0
"""Logarithm of the likelihood that a clock has to gain, over the misfit that lasts beside it, which
chance does once in 20,000. Sound recordings gain nothing."""
_FARTHEST, _STEP = 1.0, 0.032
"""Lags that are looked through [s], and how far these are apart: an eighth of the period of a
pattern of 4 Hz, and a fraction of any move."""
_STEEPEST = 0.01
"""Largest drift that is looked through."""
_LINEARISED = 3
"""Steps of a fit at most before positions are moved in time: the first does most."""
_STEPS = 8
"""Times that positions are moved in time, at most; each leaves a hundredth of 10 ms."""
_SETTLED = 0.05
"""Change of a number from one time to the next that is none, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Late:
    """Clocks of the publishers of joint states in all logs, as far as they are off.

    Attributes:
        log: (C,) the log of each clock.
        joints: the joints of the tree that it stamps.
        latency: (C,) by how much its stamps are late in the middle of the log [s].
        drift: (C,) by how much it is too fast [s/s].
        latency_sd: (C,) standard deviations.
        drift_sd: (C,).
    """

    log: Int
    joints: tuple[Int, ...]
    latency: F64
    drift: F64
    latency_sd: F64
    drift_sd: F64


def with_publishers(
    problem: MotionProblem,
    fitted: Fitted,
    begin: MotionState,
    misfit: Callable[[MotionProblem, Fitted], float],
) -> tuple[MotionProblem, Fitted, Late | None]:
    """The fit with clocks of publishers that the readings show, positions moved in time.

    Args:
        problem: what was fitted.
        fitted: the fit.
        begin: where it began.
        misfit: what a fit leaves of the readings, over what noise makes of them.

    Returns:
        The problem and its fit, without numbers of clocks; what was found, None where nothing.
    """
    clocks = [(g, joints) for g, log in enumerate(problem.logs) for joints in beyond_first(log)]
    if not clocks:
        return problem, fitted, None
    late = np.zeros((len(clocks), N_CLOCK))
    gain = size_of(problem, fitted, _motions(problem.logs, clocks)).gain
    if gain <= _CERTAIN * max(1.0, misfit(problem, fitted)):
        return problem, fitted, None
    rough = _looked_through(problem, begin, clocks)
    if rough.any():
        moved = problem.again(logs=_taken(problem.logs, clocks, rough))
        other = fit(moved, begin)
        if likelihood(other) > likelihood(fitted):
            problem, fitted, late = moved, other, rough
    halves = np.array([_half(problem.logs[g]) for g, _ in clocks])
    state, deviation = fitted.state, np.full(late.shape, np.inf)
    for _ in range(_STEPS):
        more, wider = _wider(problem, state, clocks)
        found = fit(more, wider, near=True, iterations=_LINEARISED)
        at = slice(more.layout.unseen.start, more.layout.unseen.start + late.size)
        system = eliminated(found.equations, more.free_joint, more.free_su)
        variance = np.diag(joint_inverse(system.schur, more.free_joint))[at]
        deviation = np.sqrt(variance.clip(min=0.0)).reshape(late.shape)
        step = found.state.unseen[: late.size].reshape(late.shape)
        late = _beyond(late, step, halves)
        problem = problem.again(logs=_taken(problem.logs, clocks, step))
        state = replace(found.state, unseen=found.state.unseen[late.size :])
        if (np.abs(step) <= _SETTLED * deviation).all():
            break
    clock = Late(
        log=np.array([g for g, _ in clocks]),
        joints=tuple(joints for _, joints in clocks),
        latency=late[:, 0],
        drift=late[:, 1] / halves,
        latency_sd=deviation[:, 0],
        drift_sd=deviation[:, 1] / halves,
    )
    return problem, fit(problem, state, near=True), clock


def beyond_first(log: Trajectory) -> list[Int]:
    """Joints of each publisher whose clock may be off that of most joints.

    Args:
        log: the trajectory.
    """
    if not len(log.publisher):
        return []
    return publishers_beyond_first(log.publisher, np.asarray(log.moving.any(axis=0)))


def with_deviations(late: Late, problem: MotionProblem, fitted: Fitted, misfit: float) -> Late:
    """Clocks with deviations under all errors that the residuals of a fit show.

    Args:
        late: clocks that were found.
        problem: what was fitted in the end, with positions where these clocks put them.
        fitted: the fit.
        misfit: what it leaves over spans of time, over what noise makes of it.
    """
    clocks = list(zip(late.log.tolist(), late.joints, strict=True))
    more, state = _wider(problem, fitted.state, clocks)
    again = fit(more, state, near=True, iterations=1)
    at = slice(more.layout.unseen.start - more.layout.gravity, None)
    variance = np.diag(shared_covariance(more, again, misfit))[at][: N_CLOCK * len(clocks)]
    deviation = np.sqrt(variance.clip(min=0.0)).reshape(-1, N_CLOCK)
    halves = np.array([_half(problem.logs[g]) for g, _ in clocks])
    return replace(late, latency_sd=deviation[:, 0], drift_sd=deviation[:, 1] / halves)


def _half(log: Trajectory) -> float:
    """Half the time of the samples that are compared [s]."""
    return 0.5 * float(log.time[-1] - log.time[0])


def _lates(log: Trajectory, numbers: F64) -> F64:
    """(N,) by how much a clock (2,) is late along a log [s]."""
    return np.asarray(numbers[0] + numbers[1] * log.since_middle / _half(log))


def _taken(
    logs: Sequence[Trajectory], clocks: Sequence[tuple[int, Int]], late: F64
) -> list[Trajectory]:
    """Logs with positions where they were once the clocks (C, 2) are set right."""
    out = list(logs)
    for (g, joints), numbers in zip(clocks, late, strict=True):
        if numbers.any():
            out[g] = out[g].joints_taken(joints, _lates(out[g], numbers))
    return out


def _beyond(late: F64, step: F64, halves: F64) -> F64:
    """(C, 2) clocks that lead to where some clocks led and then steps, halves (C,) logs long."""
    steep = late[:, 1] / halves
    return np.stack(
        [late[:, 0] + (1 + steep) * step[:, 0], late[:, 1] + (1 + steep) * step[:, 1]], axis=1
    )


def _motions(logs: Sequence[Trajectory], clocks: Sequence[tuple[int, Int]]) -> Unseen:
    """What joints are beyond their positions per unit of each number of each clock."""
    joint: list[int] = []
    number: list[int] = []
    columns: list[list[F64]] = [[] for _ in logs]
    for c, (g, joints) in enumerate(clocks):
        for i in range(N_CLOCK):
            joint += joints.tolist()
            number += [N_CLOCK * c + i] * len(joints)
            for h, log in enumerate(logs):
                share = _lates(log, np.eye(N_CLOCK)[i]) if h == g else np.zeros(len(log.q))
                columns[h].append(log.qd[:, joints] * share[:, None])
    motions = tuple(np.concatenate(each, axis=1) for each in columns)
    return Unseen(np.array(joint), motions, number=np.array(number))


def _wider(
    problem: MotionProblem, state: MotionState, clocks: Sequence[tuple[int, Int]]
) -> tuple[MotionProblem, MotionState]:
    """The problem with numbers of clocks before all other unseen motion, and where it begins."""
    more = _motions(problem.logs, clocks)
    state = replace(state, unseen=np.concatenate([np.zeros(more.n_numbers), state.unseen]))
    spread = np.concatenate([np.full(more.n_numbers, _WIDE), problem.priors.unseen])
    priors = replace(problem.priors, unseen=spread)
    motion = more if problem.unseen is None else together([more, problem.unseen])
    knots = problem.layout.n_knots
    return MotionProblem(problem.tree, problem.logs, priors, knots, motion), state


def likelihood(fitted: Fitted) -> float:
    """Logarithm of the likelihood of an accelerometer's sample, in the mean, but for a constant."""
    total, count = 0.0, 0
    for noise, predicted in zip(fitted.noise, fitted.predicted, strict=True):
        known = predicted.measured & np.isfinite(noise[..., 0])
        total -= float(np.log(noise[..., 0][known]).sum())
        count += int(known.sum())
    return total / max(count, 1)


def _looked_through(
    problem: MotionProblem, begin: MotionState, clocks: Sequence[tuple[int, Int]]
) -> F64:
    """(C, 2) lags at which a state explains the readings best, one clock after the other.

    Orientations are enough, as rests give them: gravity turns with the joints.
    """
    out = np.zeros((len(clocks), N_CLOCK))
    lags = np.asarray(
        _STEP * np.arange(-round(_FARTHEST / _STEP), round(_FARTHEST / _STEP) + 1), dtype=np.float64
    )
    logs: Sequence[Trajectory] = problem.logs
    for c, (g, joints) in enumerate(clocks):
        log = logs[g]
        size = max(1, round(STRETCH * len(log.kept) / (2 * _half(log))))
        first = np.arange(0, len(log.kept), size)
        left = []
        for lag in lags:
            there = [*logs]
            there[g] = log.joints_taken(joints, np.full(len(log.q), lag))
            p = problem.again(logs=there).predict(begin, g)
            square = np.where(p.measured[..., None], p.residual, 0.0) ** 2
            left.append(np.add.reduceat(square.sum(axis=2), first, axis=0))
        square = np.moveaxis(np.array(left), 0, 1)  # (W, R, U)
        usual = np.median(square.min(axis=1), axis=0) + 1e-12
        score: F64 = -0.5 * np.log(1 + square / usual).sum(axis=2)
        time: F64 = log.time[first] + 0.5 * STRETCH - 0.5 * (log.time[0] + log.time[-1])
        offset, drift = best_line(time, score, lags, _FARTHEST, _STEEPEST, 2 * _half(log))
        out[c] = offset, drift * _half(log)
        logs = _taken(logs, clocks[c : c + 1], out[c : c + 1])
    return out
