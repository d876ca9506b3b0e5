"""What real robots have and ideal ones have not, as far as the readings show it.

A rigid robot with steady sensors is fitted first. Where it leaves more than noise, or where joints
are off their encoders from place to place, causes are tried: uneven gears, joints that yield, a
base that gives way, biases that drift, several of these; slack of a learnt size takes up what none
of them explains. Slack no larger than half an encoder's step needs no cause: rounding makes it
wherever a robot rests, and many joints and SUs show what one of them hides in noise. What rounding
makes on the way from rest to rest is told from slack by drawing it anew.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse
from skin2urdf.estimation.trajectory.bending import (
    SPINDLE,
    YIELD,
    Bending,
    balanced,
    bending,
    unsettled,
)
from skin2urdf.estimation.trajectory.elastic import Elasticity
from skin2urdf.estimation.trajectory.elastic import followed as followed_by_known
from skin2urdf.estimation.trajectory.fit import (
    Fitted,
    Led,
    cost_with,
    fit,
    fit_following,
    held,
)
from skin2urdf.estimation.trajectory.front_end import begin_front
from skin2urdf.estimation.trajectory.gears import find_ripples, harmonics, ripples
from skin2urdf.estimation.trajectory.known_torque import known_elasticity
from skin2urdf.estimation.trajectory.misfit import misfit, span_means
from skin2urdf.estimation.trajectory.on_the_base import turned_as_the_base
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.rounded import rounded_off_again
from skin2urdf.estimation.trajectory.shaken import Shaken
from skin2urdf.estimation.trajectory.slack import (
    Lacking,
    Size,
    lacking,
    learnt_size,
    rounded_off,
    size_of,
    slack,
    with_unseen,
)
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.trajectory import Trajectory

SPAN = 2.0
"""Length of the spans of time whose errors count as independent [s]: far longer than the low-pass,
and than a pattern's period."""
_EXPLAINED = 2.0
"""Misfit up to which nothing is missing: recordings with nothing but noise have 0.6 to 0.9, and its
scatter over the spans of a log is a twentieth."""
_BEYOND = 200.0
"""Misfit beyond which no cause is looked for: gears that yield by 3 mrad leave 11, a joint whose
encoder is bent by 0.2 rad 62, and one that counts the other way from some time on 280, of which
causes that are none take 100 s to try."""
_MOST_OF_IT = 0.5
"""Part of a misfit, above the 1 of noise, or of slack's gain, that may stay where a cause is added,
and after a first look at one that is to be followed further. Links that bend leave 0.24 as elastic
joints, with which positions are four times better; a base that gives way 0.37 as a drift of biases,
so that causes are held against each other before one is taken."""
_TURNS = 6
"""Turns of deflections by known torques and of motion, at most; each leaves a fifth to a tenth of
the error."""
_PROMISING_STEPS, _STEPS = 12, 24
"""Steps at most until it shows whether there is anything to a cause, and until it is fitted: gears
at 4.4 Hz take 20, what is stiffer 3 to 8."""
_LATE = 1e-2
"""Standard deviation of the time by which deflections under known torques are late [s]: that of a
resonance at 8 Hz, damped to a quarter of the critical."""
_SETTLED = 1e-2
"""Change of deflections in a turn, over the largest, at which the next one is the last: that one
leaves some 0.001 of deflections, which is micrometres."""
_NEARLY = 0.3
"""Length of the last step of a turn in standard deviations: what is followed from where a fit has
not arrived leads to another place."""
_MEMORY = 4.0
"""Time in which what yields forgets how it swung before [s]: a gear at 5 Hz with 5 % of the
critical damping then swings by a hundredth, of which half a second is the low-pass's."""
_ON_ITS_WAY = 1e-2
"""Speed of a joint, over its highest, from which a log begins in motion: what swings is a part of
that, and a hundredth of that part is less than is followed."""
_ROUGHLY = 3.0
"""The same of what only leads near."""
_SLOWER = (3, 2)
"""By how many times slower the motion is that deflections are looked for in, one after the other:
patterns of 2 to 3 Hz are left of those up to 5 Hz, beside gears that resonate at 4.4 Hz and more.
Nearer to a resonance deflections change so fast with what they are made of that only a state close
by leads on."""
_CERTAIN = 10.0
"""Logarithm of the likelihood that unseen motion has to gain, which chance does once in 100,000;
sound recordings gain nothing (panda and five of ur5), a strain wave of 0.1 mrad 121."""
_DOUBTED = 4.5
"""Logarithm of the likelihood up to which a size is not ruled out: that of three standard
deviations. Slack of gears in a log of 15 s has 8, rounding that 200 SUs see 4."""
_NEGATIVE = 10.0
"""Deviations below zero at which a compliance is none: what torques lack in truth, as those of
cables and tools that a model leaves out, makes small ones wrong by several."""
BENDS, _DRIFT = ("elastic", "base"), "drift"
"""Causes of deflections, and that of biases."""
_KNOTS = 15.0
"""Time between the moments that a drifting bias is given at [s]; sensors warm up in minutes."""


@dataclass(frozen=True, eq=False)
class Explained:
    """A fit with what real robots have and ideal ones have not, as far as the readings show it.

    Attributes:
        problem: what was fitted in the end.
        fitted: the fit.
        causes: names of what was added.
        tried: misfit with each cause that was tried, chosen or not.
        under_known: what joints yield under torques that are known, the first of what encoders do
            not see; None where none do, or torques are not known.
    """

    problem: MotionProblem
    fitted: Fitted
    causes: tuple[str, ...] = ()
    tried: Mapping[str, float] = field(default_factory=dict)
    under_known: Elasticity | None = None


def explained(
    problem: MotionProblem,
    fitted: Fitted,
    most: float = np.inf,
    *,
    only_known: bool = False,
    without: Collection[str] = (),
) -> Explained:
    """Try what a rigid robot with steady sensors has not, where it does not explain the readings.

    Args:
        problem: the rigid robot.
        fitted: its fit.
        most: misfit of the rigid robot beyond which nothing is tried.
        only_known: try nothing but joints that yield under known torques.
        without: causes of what drifts and bends that need not be tried.
    """
    given = problem.priors.blueprint is not None
    places = slack(problem.tree, problem.logs, zeros_given=given)
    rigid = _Attempt(problem, fitted, (), places)
    if rigid.misfit > min(most, _BEYOND) or not rigid.lacks:
        return Explained(problem, fitted)
    rounded = rigid.with_rounding()
    if rounded is not None and rounded.misfit <= _EXPLAINED:
        return Explained(rounded.problem, rounded.fitted)
    # Few numbers that say more than many would.
    known = rigid.with_known_torque()
    if known is not None and yields(known.problem, known.fitted) and _explains_most(known, rigid):
        best, attempts = known, [known]
    else:
        known = None
        best, attempts = (rigid, []) if only_known else _of_any_cause(rigid, without)
    if best.slack_size is not None and best.slack_size.gain > _CERTAIN:
        best = best.with_slack()
        attempts.append(best)
    tried = {cause: each.misfit for each in attempts for cause in each.causes[-1:]}
    elastic = known.problem.unseen if known else None
    under = elastic if isinstance(elastic, Elasticity) else None
    return Explained(best.problem, best.fitted, best.causes, tried, under)


def _of_any_cause(rigid: _Attempt, without: Collection[str]) -> tuple[_Attempt, list[_Attempt]]:
    """The attempt that explains most, and all that were made."""
    bends = [cause for cause in BENDS if cause not in without]
    likeliest = rigid.likely(bends)[:1] if rigid.lacks else []
    best = _with_uneven_gears(rigid, rigid.gains[likeliest[0]] if likeliest else 0.0)
    attempts = [best]
    if best.lacks:
        other, more = _with_physics(rigid, without)
        attempts += more
        if _explains_most(other, rigid) and not _explains_most(best, other):
            best = other
    return best, attempts


def _with_physics(rigid: _Attempt, without: Collection[str]) -> tuple[_Attempt, list[_Attempt]]:
    """The best of what drifts and bends, one cause after the other, and all that was tried."""
    left = [cause for cause in (_DRIFT, *BENDS) if cause not in without]
    if _DRIFT in left and (rigid.misfit <= _EXPLAINED or rigid.problem.priors.sensors.bias == 0):
        left.remove(_DRIFT)
    best, tried = rigid, []
    while left:
        further: list[_Attempt] = []
        for cause in (*(c for c in left if c == _DRIFT), *best.likely(left)):
            further.append(best.adding(cause))
            tried.append(further[-1])
            if not further[-1].lacks and _explains_most(further[-1], best):
                return further[-1], tried
            if cause in BENDS and any(_explains_most(each, best) for each in further):
                break  # what is less likely waits for what is left then
        if not further:
            break
        other = min(further, key=lambda each: each.misfit)
        if best is not rigid and not _explains_most(other, best):
            break
        best = other
        left.remove(best.causes[-1])
        if best.misfit <= _EXPLAINED:
            break
    return best, tried


def _with_uneven_gears(rigid: _Attempt, by_bends: float) -> _Attempt:
    """An attempt with the errors of gears that say more than slack of any kind would.

    Args:
        rigid: the attempt without.
        by_bends: what the likeliest of what bends says.
    """
    best = rigid
    while best.slack_size is not None and best.slack_size.gain > _CERTAIN:
        proposed = {name: best.sized(more) for name, more in best.uneven() if more is not None}
        if not proposed:
            break
        name = max(proposed, key=lambda each: proposed[each][1].gain)
        more, size = proposed[name]
        if size.gain <= max(best.slack_size.gain, by_bends):
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
        return misfit_of(self.problem, self.fitted, SPAN)

    @cached_property
    def slack_size(self) -> Size | None:
        """Slack that the readings show beyond what the problem has."""
        return None if self.shown is None else self.shown.size(0)

    @cached_property
    def shown(self) -> Lacking | None:
        """What the readings show of slack; None of a robot that stays in one place."""
        return None if self.places is None else lacking(self.problem, self.fitted, [self.places])

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

    def likely(self, causes: Collection[str]) -> list[str]:
        """Of what bends, the causes that may explain most of what is lacking, the likeliest first.

        To first order deflections are linear in the loads, and one look at the residuals tells what
        loads of a size that they all share would gain. To follow them takes fifty times as long.
        None is likely that says less than slack of any kind would, or too little for the misfit.
        """
        enough = 0.0 if self.slack_size is None else self.slack_size.gain
        if self.misfit > _EXPLAINED:
            enough = max(enough, 0.5 * (1 - _MOST_OF_IT) * self._excess)
        likely = [cause for cause in causes if cause in BENDS and self.gains[cause] > enough]
        return sorted(likely, key=lambda cause: -self.gains[cause])

    @cached_property
    def gains(self) -> dict[str, float]:
        """Logarithm of the likelihood that loads of each kind of what bends would gain."""
        problem, state = self.problem, self.fitted.state
        found = {}
        for cause in BENDS:
            loads = bending(
                problem.tree, problem.logs, state.placements, state.gravity,
                joints=cause == "elastic", base=cause == "base",
            )  # fmt: skip
            found[cause] = size_of(problem, self.fitted, loads).gain
        return found

    @property
    def _excess(self) -> float:
        """Chi-squared of mean residuals over spans beyond what noise makes of it."""
        _, variances = span_means(self.problem, self.fitted.predicted, self.fitted.weights, SPAN)
        return (self.misfit - 1) * int(np.isfinite(variances).sum())

    def sized(self, more: Unseen) -> tuple[Unseen, Size]:
        """More unseen motion, and the size that the readings show."""
        return more, size_of(self.problem, self.fitted, more)

    def with_more(self, name: str, more: Unseen, size: float) -> _Attempt:
        """With more unseen motion of a common size."""
        problem = with_unseen(self.problem, more, size)
        zero = np.zeros(more.n_numbers)
        state = self.fitted.state
        state = replace(state, unseen=np.concatenate([state.unseen, zero]))
        return replace(
            self, problem=problem, fitted=fit(problem, state), causes=(*self.causes, name)
        )

    def with_rounding(self) -> _Attempt | None:
        """With slack, where it is lacking and all of it may be what encoders round off.

        So little leaves a fit where it is but for a step, of which the equations are known.
        """
        if self.shown is None or self.slack_size is None or self.slack_size.gain <= _CERTAIN:
            return None
        rounding = rounded_off(self.problem.tree, self.problem.logs)
        size = self.slack_size
        if size.gain_beyond(rounding) > _DOUBTED:
            size = self._size_beside_rounding() or size
        if size.gain_beyond(rounding) > _DOUBTED:
            return None
        if size.gain <= _CERTAIN:
            return self
        problem, equations = self.shown.begun(0, size.size)
        before = self.fitted
        none = np.zeros(problem.layout.n_unseen - len(before.state.unseen))
        state = replace(before.state, unseen=np.concatenate([before.state.unseen, none]))
        fitted = fit(problem, state, near=True, predicted=before.predicted, equations=equations)
        return replace(self, problem=problem, fitted=fitted, causes=(*self.causes, "slack"))

    def _size_beside_rounding(self) -> Size | None:
        """Slack beyond what encoders round off while joints move; None where they round nothing."""
        again = rounded_off_again(self.problem.logs)
        if again is None or self.places is None:
            return None
        return lacking(self.problem, self.fitted, [self.places, again]).size(0, drawn=1)

    def with_slack(self) -> _Attempt:
        """With slack of the size that the readings show."""
        if self.places is None or self.slack_size is None:
            return self
        return self.with_more("slack", self.places, self.slack_size.size)

    def with_known_torque(self) -> _Attempt | None:
        """With joints that yield under torques that are known; None where these are not."""
        found = with_known_torque(self.problem, self.fitted)
        if found is None:
            return None
        problem, fitted = found
        return replace(self, problem=problem, fitted=fitted, causes=(*self.causes, "elastic"))

    def adding(self, cause: str) -> _Attempt:
        """With joints or a base that yield, or with biases that walk."""
        causes = (*self.causes, cause)
        if cause == _DRIFT:
            problem, fitted = _with_drifting_biases(self.problem, self.fitted)
        else:
            bends = {name: name in causes for name in BENDS}
            problem, fitted = _yielding(self.problem, self.fitted, **bends)
        return replace(self, problem=problem, fitted=fitted, causes=causes)


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
    means, variances = span_means(problem, fitted.predicted, fitted.weights, SPAN)
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


def with_known_torque(
    problem: MotionProblem, fitted: Fitted
) -> tuple[MotionProblem, Fitted] | None:
    """The fit with joints that yield under torques that are known; None where they are not.

    Args:
        problem: the rigid robot.
        fitted: its fit.
    """
    blueprint, state = problem.priors.blueprint, fitted.state
    if blueprint is None or blueprint.inertials is None:
        return None
    elastic = known_elasticity(
        problem.tree, problem.logs, state.placements, state.gravity, blueprint.inertials
    )
    # Sensors have taken up of the deflections what they could, and would hold it back.
    sensors = replace(
        state.placements,
        bias=np.zeros_like(state.placements.bias),
        shape=np.zeros_like(state.placements.shape),
    )
    fresh = replace(
        state,
        placements=sensors,
        front=np.tile(begin_front(problem.priors.front), (len(state.front), 1)),
    )
    return _with_elastic_joints(problem, replace(fitted, state=fresh), elastic)


def yields(problem: MotionProblem, fitted: Fitted) -> bool:
    """Whether all compliances under known torques are such as springs have: not below zero.

    Args:
        problem: with nothing but these in what encoders do not see.
        fitted: its fit.
    """
    elastic, at = problem.unseen, problem.layout.unseen
    if not isinstance(elastic, Elasticity):
        return False
    system = eliminated(fitted.equations, problem.free_joint, problem.free_su)
    variance = np.diag(joint_inverse(system.schur, problem.free_joint))[at]
    spring = ~elastic.damping
    x = fitted.state.unseen[spring]
    return bool((x > -_NEGATIVE * np.sqrt(variance[spring].clip(min=0.0))).all())


def _yielding(
    problem: MotionProblem, fitted: Fitted, *, elastic: bool, base: bool
) -> tuple[MotionProblem, Fitted]:
    """The fit with joints, a base or both that yield under loads that nobody knows.

    Torques go with the motion of the links, which is known once the deflections are, and with the
    masses, which are known once the stiffness is: every step follows what it has found.
    """
    tree, state = problem.tree, fitted.state
    logs = [_at_rest_before(log) for log in problem.logs]
    n_knots = problem.layout.n_knots
    promised = 1 + _MOST_OF_IT * (misfit_of(problem, fitted, SPAN) - 1)

    def follow(before: MotionProblem, at: MotionState) -> Led:
        bends = cast(Bending, before.unseen)
        there = balanced(bends, tree, before.logs, at.placements, at.gravity, at.unseen)

        def about(bends: Bending) -> MotionProblem:
            return MotionProblem(tree, before.logs, before.priors, n_knots, bends)

        led = about(there.deflections), replace(at, unseen=there.x)
        return Led(*led, lambda: about(there.moved_by_numbers()))

    def follow_where_it_holds(before: MotionProblem, at: MotionState) -> Led | None:
        led = follow(before, at)
        return led if cast(Bending, led.problem.unseen).holds else None

    # How SUs on the base are turned is known when its motion is.
    moved = [replace(log, valid=log.valid & ((tree.su_joint >= 0) | (not base))) for log in logs]
    first = moved if base else [log.slower(_SLOWER[0]) for log in moved]
    bends = bending(tree, first, state.placements, state.gravity, joints=elastic, base=base)
    state = replace(state, unseen=np.zeros(bends.n_numbers))
    priors = replace(problem.priors, unseen=bends.spread)
    yielding = MotionProblem(tree, first, priors, n_knots, bends)
    if not base:
        # Far below resonances links deflect by the motion that encoders have, or nearly so.
        state = fit(yielding, state, tolerance=_NEARLY, iterations=_PROMISING_STEPS).state
        led = follow(yielding, state)
        yielding, state = led.whole(), led.state
        ways = []
        for slower in (*_SLOWER[1:], 1):
            yielding, near = fit_following(
                yielding,
                state,
                follow_where_it_holds,
                iterations=_PROMISING_STEPS,
                tolerance=_ROUGHLY,
            )
            ways.append((cast(Bending, yielding.unseen), near.state))
            if slower > 1:
                faster = [log.slower(slower) for log in moved]
                bends = unsettled(ways[-1][0], faster)
                led = follow(MotionProblem(tree, faster, priors, n_knots, bends), near.state)
                yielding, state = led.whole(), led.state
        # Where swings are all of one frequency, one of the two bands holds nothing of them.
        leads = [
            follow(MotionProblem(tree, moved, priors, n_knots, unsettled(bends, moved)), at)
            for bends, at in ways
        ]
        ends = [held(led.problem, led.state) for led in leads]
        shaken = Shaken.of(tree, moved, ends[0].state, ends[0].weights)
        costs = [cost_with(ends[0].weights, shaken, end) for end in ends]
        led = leads[int(np.argmin(costs))]
        bends, yielding, state = cast(Bending, led.problem.unseen), led.whole(), led.state
    stages = (
        ((_PROMISING_STEPS, _NEARLY), (_STEPS, _NEARLY))
        if base
        else ((_PROMISING_STEPS, _ROUGHLY),)
    )
    for steps, enough in stages:
        yielding, fitted = fit_following(
            yielding, state, follow_where_it_holds, iterations=steps, tolerance=enough
        )
        keeps = misfit_of(yielding, fitted, SPAN) <= promised
        yielding = yielding.again(logs=logs)
        state = turned_as_the_base(yielding, fitted.state, SPAN)
        if not keeps:
            return yielding, held(yielding, state)
    loads = slice(0, len(bends.basis))
    spread = np.array(bends.spread)
    spread[loads] = learnt_size(yielding, fitted, loads).size
    yielding = yielding.again(priors=replace(priors, unseen=spread))
    return fit_following(
        yielding, state, follow_where_it_holds, iterations=_STEPS, tolerance=_NEARLY
    )


def _at_rest_before(log: Trajectory) -> Trajectory:
    """A log in which nothing swings that has begun to before it, as a robot on its way may."""
    speed, first = np.abs(log.qd), len(log.taps) // 2
    moves = (speed[first] > _ON_ITS_WAY * speed.max(axis=0)).any()
    return log.without_first(_MEMORY) if moves else log


def _with_elastic_joints(
    problem: MotionProblem, fitted: Fitted, elastic: Elasticity
) -> tuple[MotionProblem, Fitted]:
    """The fit with joints that yield under torques that are known.

    Torques go with the motion of the links, which is known once the deflections are: both are found
    in turns.
    """
    tree, logs, state = problem.tree, problem.logs, fitted.state
    spread = YIELD * np.where(tree.prismatic, SPINDLE, 1.0)[elastic.joint]
    spread[elastic.damping] = _LATE
    priors = replace(problem.priors, unseen=spread)
    state = replace(state, unseen=np.zeros(len(spread)))
    n_knots = problem.layout.n_knots
    yielding = MotionProblem(tree, logs, priors, n_knots, elastic)
    rigid = misfit_of(problem, fitted, SPAN)
    for turn in range(_TURNS):
        before = yielding.deflections(state)
        fitted = fit(yielding, state, tolerance=_NEARLY, far=turn == 0)
        state = fitted.state
        if turn == 0 and misfit_of(yielding, fitted, SPAN) > _MOST_OF_IT * rigid:
            return yielding, fitted
        change = _change(before, yielding.deflections(state))
        for _ in range(2):
            x = state.unseen
            elastic = followed_by_known(elastic, tree, logs, state.placements, state.gravity, x)
        yielding = MotionProblem(tree, logs, priors, n_knots, elastic)
        if change < _SETTLED:
            break
    return yielding, fit(yielding, state)


def _change(before: Sequence[F64], after: Sequence[F64]) -> float:
    """Largest change of deflections, over the largest deflection."""
    largest = max(float(np.abs(a).max(initial=0.0)) for a in after)
    moved = max(float(np.abs(a - b).max(initial=0.0)) for a, b in zip(after, before, strict=True))
    return moved / largest if largest > 0 else 0.0


def misfit_of(problem: MotionProblem, fitted: Fitted, seconds: float) -> float:
    """Squares of mean residuals over spans of so many seconds, over what noise makes of them."""
    return misfit(*span_means(problem, fitted.predicted, fitted.weights, seconds))
