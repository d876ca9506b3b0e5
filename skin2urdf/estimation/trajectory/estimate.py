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
from skin2urdf.estimation.trajectory.gears import find_ripples, harmonics, ripples
from skin2urdf.estimation.trajectory.gyro import gyro_deviations
from skin2urdf.estimation.trajectory.listening import found_gyros, listened
from skin2urdf.estimation.trajectory.misfit import misfit, span_means
from skin2urdf.estimation.trajectory.priors import MotionPriors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Gyros
from skin2urdf.estimation.trajectory.slack import Size, size_of, slack, with_unseen
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.uncertainty import MotionInformation, motion_information
from skin2urdf.estimation.trajectory.unseen import Unseen
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
_BEYOND = 400.0
"""Misfit beyond which no cause is looked for: gears that yield by 3 mrad leave 11, so that a
degree, the most that is allowed for, leaves 400."""
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
_CERTAIN = 10.0
"""Logarithm of the likelihood that unseen motion has to gain: chance does once in 100,000, and some
hundred numbers that are not needed lose 0.3 to 0.6 (panda and ur5, sound recordings)."""
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
        causes: what was added to a rigid robot with steady sensors: ``elastic`` joints, ``drift``
            of biases, ``harmonics`` and ``ripples`` of gears, ``slack`` from place to place.
    """

    problem: MotionProblem
    fitted: Fitted
    information: MotionInformation
    misfit: float
    gyros: Gyros | None = None
    causes: tuple[str, ...] = ()

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
    def slack(self) -> float:
        """What encoders leave of a joint's position from place to place, its learnt size [rad]."""
        return float(self.problem.priors.unseen[-1]) if "slack" in self.causes else 0.0

    @property
    def deflections(self) -> F64:
        """(D,) by how much each link is beyond its encoder at most [rad or m]; 0 where it is not.

        Joints that yield, gears that are uneven and slack, together.
        """
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
    logs = problem.logs
    causes: tuple[str, ...] = ()
    if look_further:
        problem, fitted, causes = _explained(problem, fitted)
    left = _misfit(problem, fitted, _SPAN)
    # Errors that last longer than a span are larger than spans taken as independent show.
    lasting = max(1.0, _misfit(problem, fitted, _LONG) / max(left, 1.0))
    seconds = max(float(log.time[-1] - log.time[0]) for log in logs)
    spans = int(np.clip(seconds / _SPAN, _FEWEST, _MOST))
    information = motion_information(problem, fitted, spans, lasting)
    gyros = found_gyros(problem, fitted, contradict)
    return MotionEstimate(problem, fitted, information, left, gyros, causes)


def _begin_front(front: F64) -> F64:
    """Front end (2,) to begin with: that of a filter of second order within what is common.

    Without any filter the slope towards one of second order is zero, and where data ask for it the
    way begins on either side.
    """
    mean, deviation = front
    return np.asarray(mean if mean.any() else np.array([1.0, 0.5]) * deviation)


def _misfit(problem: MotionProblem, fitted: Fitted, seconds: float) -> float:
    return misfit(*span_means(problem, fitted.predicted, fitted.weights, seconds))


def _explained(
    problem: MotionProblem, fitted: Fitted
) -> tuple[MotionProblem, Fitted, tuple[str, ...]]:
    """The fit with what real robots have and ideal ones have not, as far as the readings show it.

    Returns:
        The problem with it, the fit, and the names of what was added.
    """
    rigid = _Attempt(problem, fitted, (), slack(problem.tree, problem.logs))
    if not rigid.lacks or rigid.misfit > _BEYOND:
        return problem, fitted, ()
    best = _with_uneven_gears(rigid)
    if best.lacks:
        others = [rigid.with_elastic_joints()]
        if rigid.misfit > _EXPLAINED and problem.priors.sensors.bias > 0:
            others.append(rigid.with_drifting_biases())
        other = min(others, key=lambda each: each.misfit)
        if other.misfit > _EXPLAINED and len(others) > 1:
            both = other.with_the_other()
            other = both if _explains_most(both, other) else other
        if _explains_most(other, rigid) and not _explains_most(best, other):
            best = other
    if best.slack_size is not None and best.slack_size.gain > _CERTAIN:
        best = best.with_slack()
    return best.problem, best.fitted, best.causes


def _with_uneven_gears(rigid: _Attempt) -> _Attempt:
    """An attempt with the errors of gears that say more than slack of any kind would."""
    best = rigid
    while best.slack_size is not None and best.slack_size.gain > _CERTAIN:
        proposed = {name: best.sized(more) for name, more in best.uneven() if more is not None}
        if not proposed:
            break
        name = max(proposed, key=lambda each: proposed[each][1].gain)
        more, size = proposed[name]
        if size.gain <= best.slack_size.gain:
            break
        best = best.with_more(name, more, size.size)
    return best


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A fit, and what it still lacks.

    Attributes:
        problem: what was fitted.
        fitted: the fit.
        causes: names of what was added to a rigid robot with steady sensors.
        places: slack of joints from place to place; None where the robot stays in one.
    """

    problem: MotionProblem
    fitted: Fitted
    causes: tuple[str, ...]
    places: Unseen | None

    @cached_property
    def misfit(self) -> float:
        """Squares of mean residuals over what noise makes of them."""
        return _misfit(self.problem, self.fitted, _SPAN)

    @cached_property
    def slack_size(self) -> Size | None:
        """Slack that the readings show beyond what the problem has."""
        return None if self.places is None else size_of(self.problem, self.fitted, self.places)

    @property
    def lacks(self) -> bool:
        """Whether the readings show something that the problem has not."""
        if self.misfit > _EXPLAINED:
            return True
        return self.slack_size is not None and self.slack_size.gain > _CERTAIN

    def uneven(self) -> list[tuple[str, Unseen | None]]:
        """Errors of gears by name, of those that it has not yet."""
        tree, logs = self.problem.tree, self.problem.logs
        kinds: list[tuple[str, Unseen | None]] = []
        if "harmonics" not in self.causes:
            kinds.append(("harmonics", harmonics(tree, logs)))
        if "ripples" not in self.causes:
            found = find_ripples(self.problem, self.fitted)
            kinds.append(("ripples", ripples(logs, found)))
        return kinds

    def sized(self, more: Unseen) -> tuple[Unseen, Size]:
        """More unseen motion, and the size that the readings show."""
        return more, size_of(self.problem, self.fitted, more)

    def with_more(self, name: str, more: Unseen, size: float) -> _Attempt:
        """With more unseen motion of a common size."""
        problem = with_unseen(self.problem, more, size)
        zero = np.zeros(len(more.joint))
        state = self.fitted.state
        state = replace(state, unseen=np.concatenate([state.unseen, zero]))
        return replace(
            self, problem=problem, fitted=fit(problem, state), causes=(*self.causes, name)
        )

    def with_slack(self) -> _Attempt:
        """With slack of the size that the readings show."""
        if self.places is None or self.slack_size is None:
            return self
        return self.with_more("slack", self.places, self.slack_size.size)

    def with_elastic_joints(self) -> _Attempt:
        """With joints that yield."""
        problem, fitted = _with_elastic_joints(self.problem, self.fitted)
        return replace(self, problem=problem, fitted=fitted, causes=(*self.causes, "elastic"))

    def with_drifting_biases(self) -> _Attempt:
        """With biases that walk."""
        problem, fitted = _with_drifting_biases(self.problem, self.fitted)
        return replace(self, problem=problem, fitted=fitted, causes=(*self.causes, "drift"))

    def with_the_other(self) -> _Attempt:
        """With elastic joints and drifting biases, where it has one of them."""
        if "elastic" in self.causes:
            return self.with_drifting_biases()
        return self.with_elastic_joints()


def _explains_most(one: _Attempt, other: _Attempt) -> bool:
    """Whether an attempt takes most of what another one leaves."""
    if other.misfit > _EXPLAINED:
        return one.misfit - 1 < _MOST_OF_IT * (other.misfit - 1)
    if one.slack_size is None or other.slack_size is None:
        return False
    small = one.slack_size.gain < _MOST_OF_IT * other.slack_size.gain
    return small and one.misfit < _EXPLAINED


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
    walking = MotionProblem(problem.tree, problem.logs, priors, n_knots, problem.unseen)
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
    n_knots = problem.layout.n_knots
    bending = MotionProblem(tree, logs, priors, n_knots, elastic)
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
        bending = MotionProblem(tree, logs, priors, n_knots, elastic)
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
