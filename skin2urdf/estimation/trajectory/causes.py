"""What real robots have and ideal ones have not, as far as the readings show it.

A rigid robot with steady sensors is fitted first. Where it leaves more than noise, or where joints
are off their encoders from place to place, causes are tried: clocks that wander, sensors whose axes
are curved, uneven gears, joints that yield, a base that gives way, biases that drift, several of
these; slack of a learnt size takes up what none of them explains. Slack no larger than half an
encoder's step needs no cause: rounding makes it wherever a robot rests, and many joints and SUs
show what one of them hides in noise. What rounding makes on the way from rest to rest is told from
slack by drawing it anew.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.balance import bending
from skin2urdf.estimation.trajectory.curved import (
    Curvature,
    fit_curved,
    likeliest_curvature,
    may_be_curved,
    straightened,
)
from skin2urdf.estimation.trajectory.elastic import UnderKnown
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.gears import find_ripples, harmonics, ripples
from skin2urdf.estimation.trajectory.known_torque import with_known_torque, yields
from skin2urdf.estimation.trajectory.measured_torque import with_measured_torque
from skin2urdf.estimation.trajectory.misfit import MOST_OF_IT, SPAN, misfit_of, span_means
from skin2urdf.estimation.trajectory.play import deflections_saturate
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.rounded import rounded_off_again
from skin2urdf.estimation.trajectory.slack import (
    Lacking,
    Size,
    lacking,
    rounded_off,
    size_of,
    slack,
    with_unseen,
)
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.estimation.trajectory.wandering import wandering, with_steady_clocks
from skin2urdf.estimation.trajectory.yielding import fit_yielding

_EXPLAINED = 2.0
"""Misfit up to which nothing is missing: recordings with nothing but noise have 0.6 to 0.9, and its
scatter over the spans of a log is a twentieth."""
_BEYOND = 200.0
"""Misfit beyond which no cause is looked for: gears that yield by 3 mrad leave 11, a joint whose
encoder is bent by 0.2 rad 62, and one that counts the other way from some time on 280, of which
causes that are none take 100 s to try."""
CERTAIN = 10.0
"""Logarithm of the likelihood that unseen motion has to gain, which chance does once in 100,000;
sound recordings gain nothing (panda and five of ur5), a strain wave of 0.1 mrad 121."""
_DOUBTED = 4.5
"""Logarithm of the likelihood up to which a size is not ruled out: that of three standard
deviations. Slack of gears in a log of 15 s has 8, rounding that 200 SUs see 4."""
BENDS, PLAY, CLOCK, _DRIFT, _CURVES = ("elastic", "base"), "play", "clock", "drift", "nonlinearity"
"""Causes of deflections, what is followed as the first of them and is none, and those of clocks
that wander, of biases and of sensors' axes."""
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
        wander: per log (N,) by how much later its readings were taken as clocks wander [s]; ()
            where they do not.
    """

    problem: MotionProblem
    fitted: Fitted
    causes: tuple[str, ...] = ()
    tried: Mapping[str, float] = field(default_factory=dict)
    under_known: UnderKnown | None = None
    wander: tuple[F64, ...] = ()


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
    if rigid.misfit > min(most, _BEYOND):
        return Explained(problem, fitted)
    # What clocks leave goes with the motion, and may pass for noise of SUs that move.
    rigid = rigid.on_steady_clocks()
    if not (rigid.lacks or rigid.certain_curvature):
        return rigid.explained()
    # As few numbers of each SU as a bias has; what bends gravity looks alike.
    rigid = rigid.curved_where_likeliest()
    if not rigid.lacks:
        return rigid.explained()
    rounded = rigid.with_rounding()
    if rounded is not None and rounded.misfit <= _EXPLAINED:
        return rounded.explained()
    # Few numbers that say more than many would.
    known = rigid.with_known_torque()
    if known is None:
        best, attempts = (rigid, []) if only_known else _of_any_cause(rigid, without)
    else:
        best, attempts = known, [known]
    curved = best if best is rigid else best.curved_where_likeliest()
    if curved is not best:
        best = curved
        attempts.append(best)
    slackened = best.slackened()
    if slackened.misfit > _EXPLAINED and not (known or only_known):
        # To first order nothing that bends said as much as slack, which explains too little.
        other = _of_what_seemed_unlikely(rigid, slackened, attempts, without)
        if other is not None:
            best, slackened = other, other.slackened()
    if _DRIFT in best.causes[:-1]:
        # What was looked for first may have stood for what was found after it.
        steady = best.steady()
        other = steady.slackened()
        if not _explains_most(slackened, other):
            best, slackened = steady, other
            attempts.append(best)
    if best is not rigid and _CURVES in best.causes and not best.is_curved_for_certain:
        best = best.straight()
        slackened = best.slackened()
        attempts.append(best)
    if slackened is not best:
        best = slackened
        attempts.append(best)
    elastic = known.problem.unseen if known else None
    under = elastic if isinstance(elastic, UnderKnown) else None
    return best.explained(attempts, under)


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


def _of_what_seemed_unlikely(
    rigid: _Attempt, slackened: _Attempt, attempts: list[_Attempt], without: Collection[str]
) -> _Attempt | None:
    """The attempt with what bends and was not tried that takes most of what slack leaves.

    A base that resonates with the motion, or sways under loads that differ by more than one size
    takes, says little to first order, and explains all once it is followed.

    Args:
        rigid: the attempt without any cause.
        slackened: the best one with slack.
        attempts: all that were made; those made here are added.
        without: causes that need not be tried.
    """
    known = {cause for each in attempts for cause in each.causes}
    untried = [cause for cause in BENDS if cause not in known and cause not in without]
    for cause in sorted(untried, key=lambda each: -rigid.gains[each]):
        if rigid.gains[cause] <= CERTAIN:
            break
        attempts.append(rigid.adding(cause))
        if _explains_most(attempts[-1], slackened):
            return attempts[-1]
    return None


def _with_physics(rigid: _Attempt, without: Collection[str]) -> tuple[_Attempt, list[_Attempt]]:
    """The best of what drifts and bends, one cause after the other, and all that was tried.

    One that explains the readings may leave slack that another one would explain: to slack, its
    deflections are of another size in every place and of none on the way. Of play nothing else that
    bends explains what it leaves.
    """
    left = [cause for cause in (_DRIFT, *BENDS) if cause not in without]
    if _DRIFT in left and rigid.problem.priors.sensors.bias == 0:
        left.remove(_DRIFT)
    best, tried = rigid, list[_Attempt]()
    while left and best.needs_a_cause:
        further: list[_Attempt] = []
        drifts = [_DRIFT] if _DRIFT in left and best.misfit > _EXPLAINED else []
        for cause in (*drifts, *best.likely(left)):
            further.append(best.adding(cause))
            if further[-1].has_play:
                play = replace(further[-1], causes=(*best.causes, PLAY))
                return play, [*tried, play]
            tried.append(further[-1])
            if not further[-1].needs_a_cause and _explains_most(further[-1], best):
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
    return best, tried


def _with_uneven_gears(rigid: _Attempt, by_bends: float) -> _Attempt:
    """An attempt with the errors of gears that say more than slack of any kind would.

    Args:
        rigid: the attempt without.
        by_bends: what the likeliest of what bends says.
    """
    best = rigid
    while (slack_size := best.certain_slack) is not None:
        proposed = {name: best.sized(more) for name, more in best.uneven() if more is not None}
        if not proposed:
            break
        name = max(proposed, key=lambda each: proposed[each][1].gain)
        more, size = proposed[name]
        if size.gain <= max(slack_size.gain, by_bends):
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
        wander: per log (N,) by how much later its readings were taken as clocks wander [s]; ()
            where they do not.
    """

    problem: MotionProblem
    fitted: Fitted
    causes: tuple[str, ...]
    places: Unseen | None
    wander: tuple[F64, ...] = ()

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
        if self.places is None:
            return None
        curves = may_be_curved(self.problem)
        return lacking(self.problem, self.fitted, [self.places], curves=curves)

    @property
    def certain_curvature(self) -> Curvature | None:
        """Curvature of axes that the readings show for certain, and more than slack."""
        found = None if self.shown is None else self.shown.curvature
        least = max(CERTAIN, 0.0 if self.slack_size is None else self.slack_size.gain)
        return found if found is not None and found.gain > least else None

    @property
    def certain_slack(self) -> Size | None:
        """The same where the readings show it for certain."""
        size = self.slack_size
        return size if size is not None and size.gain > CERTAIN else None

    @property
    def slack_left(self) -> float:
        """Mean square of slack that the readings show for certain [rad^2]."""
        return self.certain_slack.size**2 if self.certain_slack is not None else 0.0

    @property
    def lacks(self) -> bool:
        """Whether the readings show something that the problem has not."""
        return self.misfit > _EXPLAINED or self.certain_slack is not None

    @property
    def needs_a_cause(self) -> bool:
        """Whether the readings show more than slack that encoders may have rounded off."""
        if self.misfit > _EXPLAINED:
            return True
        size, rounding = self.certain_slack, rounded_off(self.problem.tree, self.problem.logs)
        return size is not None and size.gain_beyond(rounding) > _DOUBTED

    @cached_property
    def has_play(self) -> bool:
        """Whether it has joints that yield, of which what is lacking shows that they have play."""
        yields = self.causes[-1:] == BENDS[:1] and self.lacks
        return yields and deflections_saturate(self.problem, self.fitted, CERTAIN)

    def explained(
        self, attempts: Sequence[_Attempt] = (), under: UnderKnown | None = None
    ) -> Explained:
        """This attempt as the one that explains the readings, with what else was tried."""
        tried = {cause: each.misfit for each in attempts for cause in each.causes[-1:]}
        return Explained(self.problem, self.fitted, self.causes, tried, under, self.wander)

    def on_steady_clocks(self) -> _Attempt:
        """With clocks that no longer wander, where that says more than all that bends, else as is.

        Slack is no rival: of another size from moment to moment, it follows whatever clocks do.
        """
        more = wandering(self.problem.logs)
        if more is None:
            return self
        gain = size_of(self.problem, self.fitted, more).gain
        if gain <= CERTAIN or gain <= max(self.gains.values()):
            return self
        problem, fitted, wander = with_steady_clocks(self.problem, self.fitted)
        causes = (*self.causes, CLOCK)
        return replace(self, problem=problem, fitted=fitted, causes=causes, wander=wander)

    def curved_where_likeliest(self) -> _Attempt:
        """With curved axes, where these say more than all that looks alike, else as it is."""
        found = self.certain_curvature
        if found is None:
            return self
        uneven = [self.sized(more)[1].gain for _, more in self.uneven() if more is not None]
        return self if found.gain <= max([*self.gains.values(), *uneven]) else self.curved()

    def curved(self) -> _Attempt:
        """With axes that are curved by as much as the readings show."""
        found = self.certain_curvature
        if found is None:
            return self
        problem, fitted = fit_curved(self.problem, self.fitted, found.size)
        return replace(self, problem=problem, fitted=fitted, causes=(*self.causes, _CURVES))

    @property
    def is_curved_for_certain(self) -> bool:
        """Whether the readings show that axes are curved with all else that was found."""
        equations = self.fitted.minimised(self.fitted.equations)
        none = np.zeros(self.problem.layout.n_joint, dtype=bool)
        x = self.fitted.state.curvature
        return likeliest_curvature(self.problem, equations, none, x).gain > CERTAIN

    def straight(self) -> _Attempt:
        """With straight axes, with all other causes where they are but for a step."""
        problem, state = straightened(self.problem, self.fitted.state)
        causes = tuple(cause for cause in self.causes if cause != _CURVES)
        return replace(self, problem=problem, fitted=fit(problem, state, near=True), causes=causes)

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
        likely = [cause for cause in causes if cause in BENDS and self.gains[cause] > self._enough]
        return sorted(likely, key=lambda cause: -self.gains[cause])

    def may_be_explained_by(self, bends: Unseen) -> bool:
        """Whether deflections under known loads are likely to explain enough, by the same look."""
        return size_of(self.problem, self.fitted, bends).gain > self._enough

    @cached_property
    def _enough(self) -> float:
        """Logarithm of the likelihood that what bends has to gain to first order."""
        enough = 0.0 if self.slack_size is None else self.slack_size.gain
        if self.misfit > _EXPLAINED:
            enough = max(enough, 0.5 * (1 - MOST_OF_IT) * self._excess)
        return enough

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
        """With slack, where it is lacking and all of it may be what encoders round off: no cause.

        So little leaves a fit where it is but for a step, of which the equations are known.
        """
        size = self.certain_slack
        if self.shown is None or size is None:
            return None
        rounding = rounded_off(self.problem.tree, self.problem.logs)
        if size.gain_beyond(rounding) > _DOUBTED:
            size = self._size_beside_rounding() or size
        if size.gain_beyond(rounding) > _DOUBTED:
            return None
        if size.gain <= CERTAIN:
            return self
        problem, equations = self.shown.begun(0, size.size)
        before = self.fitted
        none = np.zeros(problem.layout.n_unseen - len(before.state.unseen))
        state = replace(before.state, unseen=np.concatenate([before.state.unseen, none]))
        fitted = fit(problem, state, near=True, predicted=before.predicted, equations=equations)
        return replace(self, problem=problem, fitted=fitted)

    def _size_beside_rounding(self) -> Size | None:
        """Slack beyond what encoders round off while joints move; None where they round nothing."""
        again = rounded_off_again(self.problem.logs)
        if again is None or self.places is None:
            return None
        return lacking(self.problem, self.fitted, [self.places, again]).size(0, drawn=1)

    def slackened(self) -> _Attempt:
        """With slack where the readings show any for certain, else as it is."""
        return self if self.certain_slack is None else self.with_slack()

    def steady(self) -> _Attempt:
        """Without biases that walk, with all other causes where they are but for a step."""
        problem, state = self.problem, self.fitted.state
        priors = replace(problem.priors, bias_walk=0.0)
        steady = MotionProblem(problem.tree, problem.logs, priors, unseen=problem.unseen)
        state = replace(state, knots=tuple(each[:0] for each in state.knots))
        causes = tuple(cause for cause in self.causes if cause != _DRIFT)
        return replace(self, problem=steady, fitted=fit(steady, state, near=True), causes=causes)

    def with_slack(self) -> _Attempt:
        """With slack of the size that the readings show."""
        if self.places is None or self.slack_size is None:
            return self
        return self.with_more("slack", self.places, self.slack_size.size)

    def with_known_torque(self) -> _Attempt | None:
        """With joints that yield under torques that are known; None where that explains little.

        Torques are those that the log holds, or of links that are known.
        """
        best: _Attempt | None = None
        ways = (
            (True, with_measured_torque(self.problem, self.fitted, self.may_be_explained_by)),
            (False, with_known_torque(self.problem, self.fitted)),
        )
        for measured, found in ways:
            if found is None or not yields(*found, in_either_sense=measured):
                continue
            problem, fitted = found
            attempt = replace(self, problem=problem, fitted=fitted, causes=(*self.causes, BENDS[0]))
            if _explains_most(attempt, best or self):
                best = attempt
        return best

    def adding(self, cause: str) -> _Attempt:
        """With joints or a base that yield, or with biases that walk."""
        causes = (*self.causes, cause)
        if cause == _DRIFT:
            problem, fitted = _with_drifting_biases(self.problem, self.fitted)
        else:
            bends = {name: name in causes for name in BENDS}
            problem, fitted = fit_yielding(self.problem, self.fitted, **bends)
        return replace(self, problem=problem, fitted=fitted, causes=causes)


def _explains_most(one: _Attempt, other: _Attempt) -> bool:
    """Whether an attempt takes most of what another one leaves.

    Of slack its size counts: likelihoods are in the noise that a fit leaves, which falls with what
    it explains.
    """
    if other.misfit > _EXPLAINED:
        return one.misfit - 1 < MOST_OF_IT * (other.misfit - 1)
    return one.misfit < _EXPLAINED and one.slack_left < MOST_OF_IT * other.slack_left


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
