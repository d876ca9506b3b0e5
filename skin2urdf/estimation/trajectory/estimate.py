"""An estimate from features made better by all samples of the logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.deviations import su_covariances
from skin2urdf.estimation.trajectory.elastic import elasticity, followed
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.front_end import droop, droop_variance
from skin2urdf.estimation.trajectory.gyro import gyro_deviations
from skin2urdf.estimation.trajectory.listening import found_gyros, listened
from skin2urdf.estimation.trajectory.misfit import misfit, span_means
from skin2urdf.estimation.trajectory.priors import MotionPriors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Gyros
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.uncertainty import MotionInformation, motion_information
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_SPAN = 2.0
"""Length of the spans of time whose errors count as independent [s]: far longer than the low-pass,
and than a pattern's period."""
_FEWEST, _MOST = 20, 200
"""Spans in a log, at least and at most."""
_LONG = 8.0
"""Length of spans that show whether errors outlast the others [s]: about that of a pose."""
_EXPLAINED = 2.0
"""Misfit up to which nothing is missing: recordings with nothing but noise have 0.6 to 0.9, and its
scatter over the spans of a log is a twentieth."""
_MOST_OF_IT = 0.2
"""Part of a misfit, above the 1 of noise, that may stay where a drift of biases or elastic joints
are its cause: what bends otherwise looks like one only in part."""
_YIELD = (2e-3, 2e-2)
"""Standard deviation of deflections [m of prismatic, rad of revolute joints]; robots whose gears
twist by more than a degree are not built to be calibrated."""
_LATE = 1e-2
"""Standard deviation of the time by which deflections lag behind torques [s]: that of a resonance
at 8 Hz, damped to a quarter of the critical."""
_TURNS = 6
"""Turns of deflections and motion, at most; each leaves a fifth to a tenth of the error."""
_SETTLED = 1e-2
"""Change of deflections in a turn, over the largest, at which the next one is the last: that one
leaves some 0.001 of deflections, which is micrometres."""
_PROMISING = 0.5
"""Part of a misfit that the first turn leaves at most where elastic joints are its cause; with
14,000 and 7,000 Nm/rad it leaves 0.16, and where biases drift 0.9."""
_NEARLY = 30.0
"""Length of the last step of a turn in standard deviations, of which only the last turn asks
more."""
_KNOTS = 15.0
"""Time between the moments that a drifting bias is given at [s]; sensors warm up in minutes."""


@dataclass(frozen=True, eq=False)
class MotionEstimate:
    """What all samples along the logs say.

    Attributes:
        problem: the logs and what was known before.
        fitted: the fit.
        information: what it is worth.
        misfit: squares of mean residuals over spans of time, over what noise makes of them; up to 1
            where the model explains the readings.
        gyros: what was found of gyroscopes; None where no SU has one.
    """

    problem: MotionProblem
    fitted: Fitted
    information: MotionInformation
    misfit: float
    gyros: Gyros | None = None

    @property
    def state(self) -> State:
        """Placements, gravity's directions, bias and shape."""
        return self.fitted.state.placements

    @property
    def droops(self) -> F64:
        """(U,) what each SU's own low-pass takes away, per square of angular frequency [s^2]."""
        return droop(self.fitted.state.front)

    @cached_property
    def su_covariances(self) -> F64:
        """(U, n, n) of each SU's own coordinates, as the layout has them."""
        return su_covariances(self.fitted.equations)

    @property
    def droop_deviations(self) -> F64:
        """(U,) standard deviations of the droops [s^2]."""
        front = self.problem.layout.front
        return np.sqrt(droop_variance(self.su_covariances[:, front, front]))

    @property
    def drifts(self) -> F64:
        """(U,) by how much each SU's bias changes within a log, largest less smallest [m/s^2]."""
        knots = self.fitted.state.knots
        ranges = [np.ptp(k, axis=0).max(axis=1) for k in knots if len(k)]
        return np.max(ranges, axis=0) if ranges else np.zeros(self.problem.tree.n_sus)

    @property
    def deflections(self) -> F64:
        """(D,) by how much each joint yields at most [rad or m]; 0 where joints are rigid."""
        logs = self.problem.deflections(self.fitted.state)
        return np.asarray(np.abs(np.concatenate(logs)).max(axis=0, initial=0.0))


def estimate_along(
    logs: Sequence[Trajectory],
    tree: KinematicTree,
    start: State,
    priors: MotionPriors,
    latency: F64,
    tell: Callable[[float], None] = lambda _: None,
    *,
    look_further: bool = True,
) -> MotionEstimate:
    """Fit all samples of all logs.

    Args:
        logs: trajectories, with columns in the tree's order.
        tree: the structure.
        start: placements to begin with.
        priors: what is known before.
        latency: (U,) lag of each SU's clock to begin with [s].
        tell: told the share of the work that is done.
        look_further: whether elastic joints and drifting biases are tried where noise and
            placements do not explain the readings.
    """
    U, G = tree.n_sus, len(logs)
    problem = MotionProblem(tree, logs, priors)
    clock = np.zeros((G, U, 2))
    clock[:, :, 0] = latency
    begin = MotionState(
        placements=start,
        gravity=priors.sensors.gravity,
        front=np.tile(_begin_front(priors.front), (U, 1)),
        clock=clock,
        knots=tuple(np.zeros((n, U, 3)) for n in problem.layout.n_knots),
        unseen=np.zeros(problem.layout.n_unseen),
        gyro=np.zeros((U, problem.layout.gyro.stop - problem.layout.gyro.start)),
    )
    fitted = fit(problem, begin, tell=tell)
    problem, fitted, contradict = listened(problem, fitted)
    logs, priors = problem.logs, problem.priors
    left = _misfit(problem, fitted, _SPAN)
    if left > _EXPLAINED and look_further:
        causes = [_with_elastic_joints(problem, fitted)]
        if priors.sensors.bias > 0:
            causes.append(_with_drifting_biases(problem, fitted))
        misfits = [_misfit(*cause, _SPAN) for cause in causes]
        best = int(np.argmin(misfits))
        if misfits[best] - 1 < _MOST_OF_IT * (left - 1):
            problem, fitted = causes[best]
            left = misfits[best]
    # Errors that last longer than a span are larger than spans taken as independent show.
    lasting = max(1.0, _misfit(problem, fitted, _LONG) / max(left, 1.0))
    seconds = max(float(log.time[-1] - log.time[0]) for log in logs)
    spans = int(np.clip(seconds / _SPAN, _FEWEST, _MOST))
    information = motion_information(problem, fitted, spans, lasting)
    gyros = found_gyros(problem, fitted, contradict)
    return MotionEstimate(problem, fitted, information, left, gyros)


def _begin_front(front: F64) -> F64:
    """Front end (2,) to begin with: that of a filter of second order within what is common.

    Without any filter the slope towards one of second order is zero, and where data ask for it the
    way begins on either side.
    """
    mean, deviation = front
    return np.asarray(mean if mean.any() else np.array([1.0, 0.5]) * deviation)


def _misfit(problem: MotionProblem, fitted: Fitted, seconds: float) -> float:
    return misfit(*span_means(problem, fitted.predicted, fitted.weights, seconds))


def _with_drifting_biases(problem: MotionProblem, fitted: Fitted) -> tuple[MotionProblem, Fitted]:
    """The fit with biases that walk, by as much as they are then found to do.

    The mean square of a walk of s per root of a second, about its mean over a time T, is
    ``s^2 T / 6``.
    """
    means, variances = span_means(problem, fitted.predicted, fitted.weights, _SPAN)
    known = np.isfinite(variances)
    slow = float((means[known] ** 2 - variances[known]).mean())
    lengths = [float(log.time[-1] - log.time[0]) for log in problem.logs]
    walk = np.sqrt(max(slow, 0.0) * 6 / max(lengths))
    n_knots = [max(2, round(length / _KNOTS) + 1) for length in lengths]
    state = replace(
        fitted.state, knots=tuple(np.zeros((n, problem.tree.n_sus, 3)) for n in n_knots)
    )
    priors = replace(problem.priors, bias_walk=float(walk))
    walking = MotionProblem(problem.tree, problem.logs, priors, n_knots)
    return walking, fit(walking, state)


def _with_elastic_joints(problem: MotionProblem, fitted: Fitted) -> tuple[MotionProblem, Fitted]:
    """The fit with joints that yield under the load of what they carry.

    Torques go with the motion of the links, which is known once the deflections are: both are found
    in turns.
    """
    tree, logs, state = problem.tree, problem.logs, fitted.state
    elastic = elasticity(tree, logs, state.placements, state.gravity)
    spread = np.where(tree.prismatic, *_YIELD)[elastic.joint]
    spread[elastic.damping] = _LATE
    priors = replace(problem.priors, unseen=spread)
    state = replace(state, unseen=np.zeros(len(spread)))
    bending = MotionProblem(tree, logs, priors, unseen=elastic)
    rigid = _misfit(problem, fitted, _SPAN)
    for turn in range(_TURNS):
        before = bending.deflections(state)
        fitted = fit(bending, state, tolerance=_NEARLY)
        state = fitted.state
        if turn == 0 and _misfit(bending, fitted, _SPAN) > _PROMISING * rigid:
            return bending, fitted
        change = _change(before, bending.deflections(state))
        for _ in range(2):
            x = state.unseen
            elastic = followed(elastic, tree, logs, state.placements, state.gravity, x)
        bending = MotionProblem(tree, logs, priors, unseen=elastic)
        if change < _SETTLED:
            break
    return bending, fit(bending, state)


def _change(before: Sequence[F64], after: Sequence[F64]) -> float:
    """Largest change of deflections, over the largest deflection."""
    largest = max(float(np.abs(a).max(initial=0.0)) for a in after)
    moved = max(float(np.abs(a - b).max(initial=0.0)) for a, b in zip(after, before, strict=True))
    return moved / largest if largest > 0 else 0.0


def motion_priors(
    sensors: Priors, *, gravity: float, front: tuple[F64, F64], gyro: bool = True
) -> MotionPriors:
    """What is commonly known before logs are read.

    Args:
        sensors: of bias, scale and cross-axis.
        gravity: standard deviation of its magnitude [m/s^2].
        front: mean and standard deviation (2,) of sensors' front ends [s^2].
        gyro: whether gyroscopes have errors.
    """
    return MotionPriors(
        sensors=sensors,
        gravity=gravity,
        front=np.stack(front),
        lag=1.0,
        drift=1e-2,
        bias_walk=0.0,
        unseen=np.zeros(0),
        gyro=gyro_deviations(float(front[1].max())) * gyro,
    )
