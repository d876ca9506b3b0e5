"""A fit of all samples, what it still lacks, and the same with one cause more or less.

Causes are what real robots have and ideal ones have not: clocks that wander, joints that are read
one after another or smoothed, sensors whose axes are curved, uneven gears, joints that yield, a
base that gives way, biases that drift, and slack of a learnt size, which takes up what none of them
explains. Slack no larger than half an encoder's step
needs no cause: rounding makes it wherever a robot rests, and many joints and SUs show what one of
them hides in noise. What rounding makes on the way from rest to rest is told from slack by drawing
it anew.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.balance import bending
from skin2urdf.estimation.trajectory.bending import Bending
from skin2urdf.estimation.trajectory.creeping import creeping, homed_anew
from skin2urdf.estimation.trajectory.curved import (
    Curvature,
    fit_curved,
    likeliest_curvature,
    may_be_curved,
    straightened,
)
from skin2urdf.estimation.trajectory.elastic import UnderKnown
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.gaps import fit_gaps
from skin2urdf.estimation.trajectory.gears import find_harmonics, find_ripples, ratios, ripples
from skin2urdf.estimation.trajectory.known_torque import with_known_torque, yields
from skin2urdf.estimation.trajectory.measured_torque import with_measured_torque
from skin2urdf.estimation.trajectory.misfit import (
    MOST_OF_IT,
    SPAN,
    misfit_of,
    span_means,
    variance_beyond,
)
from skin2urdf.estimation.trajectory.play import deflections_saturate, gaps_like, rms
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.reading_times import Read
from skin2urdf.estimation.trajectory.rounded import rounded_off_again
from skin2urdf.estimation.trajectory.slack import (
    CERTAIN,
    UNKNOWN,
    Lacking,
    Shared,
    Size,
    lacking,
    rounded_off,
    size_of,
    with_unseen,
)
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.tilting import tilts
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.estimation.trajectory.warming import fit_warming, with_steady_scales
from skin2urdf.estimation.trajectory.yielding import fit_yielding

EXPLAINED = 2.0
"""Misfit up to which nothing is missing: recordings with nothing but noise have 0.6 to 0.9, and its
scatter over the spans of a log is a twentieth."""
_DOUBTED = 4.5
"""Logarithm of the likelihood up to which a size is not ruled out: that of three standard
deviations. Slack of gears in a log of 15 s has 8, rounding that 200 SUs see 4."""
_HIDDEN = 0.05
"""Part of the noise that residuals show which springs or a base have to take where no more than
noise is left: less would change stated errors by a fortieth. They take 0.07 to 0.8 of it in series
on springs, and 0.03 in one synthetic log without."""
BASE = "base"
"""That of a base that gives way under loads."""
BENDS, PLAY, CLOCK, DRIFT, CURVES = ("elastic", BASE), "play", "clock", "drift", "nonlinearity"
"""Causes of deflections, what is followed as the first of them and is none, and those of clocks
that wander, of biases and of sensors' axes."""
WARMING = "warming"
"""That of scales that drift, as sensors' biases do."""
LAGS, SMOOTHED = "lags", "smoothed"
"""Those of joints that are read one after another, and of joints whose driver smooths them."""
TILTS = "tilts"
"""That of a base that is tilted otherwise from time to time."""
RATIO = "ratio"
"""That of joints that move by a share of what their encoders say more or less."""
HARMONICS, RIPPLES = "harmonics", "ripples"
"""Those of gears and encoders that are uneven: by any smooth function of their joint's position,
and so many times per turn."""
CREEP, HOMED = "creep", "homed"
"""Those of encoders whose zeros creep along a log, and are others in the next one."""
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
        left_to_one: whether nothing was tried, as what is left is the change of a single SU.
        left_to_place: whether nothing was, as an SU may sit on the base instead.
        read: by cause, how joints are read otherwise than their stamps say.
    """

    problem: MotionProblem
    fitted: Fitted
    causes: tuple[str, ...] = ()
    tried: Mapping[str, float] = field(default_factory=dict)
    under_known: UnderKnown | None = None
    wander: tuple[F64, ...] = ()
    left_to_one: bool = False
    left_to_place: bool = False
    read: Mapping[str, Read] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Attempt:
    """A fit, and what it still lacks.

    Attributes:
        problem: what was fitted.
        fitted: the fit.
        causes: names of what was added to a rigid robot with steady sensors.
        places: slack of joints from place to place; None where the robot stays in one.
        wander: per log (N,) by how much later its readings were taken as clocks wander [s]; ()
            where they do not.
        read: by cause, how joints are read otherwise than their stamps say.
    """

    problem: MotionProblem
    fitted: Fitted
    causes: tuple[str, ...]
    places: Unseen | None
    wander: tuple[F64, ...] = ()
    read: Mapping[str, Read] = field(default_factory=dict)

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

    @cached_property
    def certain_bends(self) -> dict[str, Size]:
        """What bends that the readings show for certain beside what encoders round off.

        Slow moves of small loads leave little, which looks like rounding, and yet make lengths
        others. Where no more is left than noise leaves, what bends has to be a part of that noise:
        that of residuals has in it what they leave while all joints move on and on. What bends has
        few numbers, and has to say more than slack does, which follows whatever a drive that gives
        way does within a step of its encoder.
        """
        beyond = self.misfit > 1 or self.certain_slack is not None
        worth = CERTAIN if beyond else max(CERTAIN, 0.5 * _HIDDEN * self._n_measured)
        found = {cause: size for cause, size in self.bends.items() if size.gain > worth}
        if found and (again := self._rounded_again) is not None:
            drives = self._loads(BENDS[0])
            beside = {cause: self._beside_rounding(cause, again, drives) for cause in found}
            found = {cause: size for cause, size in beside.items() if size.gain > CERTAIN}
        slack = self._size_beside_rounding if found else None
        least = 0.0 if slack is None else slack.gain
        return {cause: size for cause, size in found.items() if size.gain > least}

    @property
    def _n_measured(self) -> float:
        """Independent values that the fit is made to."""
        logs = zip(self.problem.logs, self.fitted.predicted, strict=True)
        return float(sum(3 * log.independence * p.measured.sum() for log, p in logs))

    def _beside_rounding(self, cause: str, again: Unseen, drives: Unseen) -> Size:
        """What the readings show of what bends beside what encoders round off on the way.

        Drives give way to loads, which encoders show by whole steps: by how much a held joint does
        within one is like elastic joints of that size.

        Args:
            cause: what bends.
            again: what encoders round off, drawn anew.
            drives: the deflections of elastic joints.
        """
        bends = drives if cause == BENDS[0] else self._loads(cause)
        found = lacking(self.problem, self.fitted, [bends, again, drives])
        # What is left of a step is anything from minus a half to a half of it.
        step = 2 * rounded_off(self.problem.tree, self.problem.logs)
        return found.size(0, Shared(draws=1, times=UNKNOWN, loads=2, load=step / np.sqrt(12)))

    @property
    def lacks(self) -> bool:
        """Whether the readings show something that the problem has not."""
        unexplained = self.misfit > EXPLAINED or self.certain_slack is not None
        return unexplained or bool(self.certain_bends)

    @property
    def needs_a_cause(self) -> bool:
        """Whether the readings show more than slack that encoders may have rounded off."""
        return self.misfit > EXPLAINED or self.has_own_slack or bool(self.certain_bends)

    @property
    def has_own_slack(self) -> bool:
        """Whether the readings show slack beyond what encoders may have rounded off."""
        return self.certain_slack is not None and self._is_more_than_rounding(self.certain_slack)

    def _is_more_than_rounding(self, slack: Size) -> bool:
        """Whether slack is of a size that encoders do not round off."""
        rounding = rounded_off(self.problem.tree, self.problem.logs)
        return slack.gain_beyond(rounding) > _DOUBTED

    @property
    def may_drift(self) -> bool:
        """Whether sensors have biases that are not known."""
        return self.problem.priors.sensors.bias > 0

    @property
    def gives_way(self) -> bool:
        """Whether it has joints, links or a base that yield."""
        return bool(set(BENDS) & set(self.causes))

    @cached_property
    def has_play(self) -> bool:
        """Whether it has joints that yield, of which what is lacking shows that they have play."""
        yields = self.causes[-1:] == BENDS[:1] and self.needs_a_cause
        return yields and deflections_saturate(self.problem, self.fitted, CERTAIN)

    def as_explained(
        self, attempts: Sequence[Attempt] = (), under: UnderKnown | None = None
    ) -> Explained:
        """This attempt as the one that explains the readings, with what else was tried."""
        tried = {cause: each.misfit for each in attempts for cause in each.causes[-1:]}
        return Explained(
            self.problem, self.fitted, self.causes, tried, under, self.wander,
            read=self.read,
        )  # fmt: skip

    def curved_where_likeliest(self) -> Attempt:
        """With curved axes, where these say more than all that looks alike, else as it is."""
        found = self.certain_curvature
        if found is None:
            return self
        others = [size.gain for _, size in self.few_sizes.values()]
        return self if found.gain <= max([*self.gains.values(), *others]) else self.curved()

    def curved(self) -> Attempt:
        """With axes that are curved by as much as the readings show."""
        found = self.certain_curvature
        if found is None:
            return self
        problem, fitted = fit_curved(self.problem, self.fitted, found.size)
        return replace(self, problem=problem, fitted=fitted, causes=(*self.causes, CURVES))

    @property
    def is_curved_for_certain(self) -> bool:
        """Whether the readings show that axes are curved with all else that was found."""
        equations = self.fitted.minimised(self.fitted.equations)
        none = np.zeros(self.problem.layout.n_joint, dtype=bool)
        x = self.fitted.state.curvature
        return likeliest_curvature(self.problem, equations, none, x).gain > CERTAIN

    def straight(self) -> Attempt:
        """With straight axes, with all other causes where they are but for a step."""
        problem, state = straightened(self.problem, self.fitted.state)
        causes = tuple(cause for cause in self.causes if cause != CURVES)
        return replace(self, problem=problem, fitted=fit(problem, state, near=True), causes=causes)

    @cached_property
    def few_sizes(self) -> dict[str, tuple[Unseen, Size]]:
        """What it has not yet and has as many numbers as slack, or fewer, by name, with its size.

        Play, errors of gears and encoders, zeros that change, and tilts of a base that no load
        moves.
        """
        tree, logs = self.problem.tree, self.problem.logs
        kinds: dict[str, Unseen | None] = {TILTS: self._tilting}
        if self.problem.unseen is None:
            kinds[PLAY] = gaps_like(logs, self._bent_by_loads)
        if RATIO not in self.causes:
            kinds[RATIO] = ratios(logs)
        if RIPPLES not in self.causes:
            kinds[RIPPLES] = ripples(logs, find_ripples(self.problem, self.fitted))
        if CREEP not in self.causes:
            kinds[CREEP] = creeping(tree, logs)
        if HOMED not in self.causes:
            kinds[HOMED] = homed_anew(tree, logs)
        found = {
            name: (more, size_of(self.problem, self.fitted, more))
            for name, more in kinds.items()
            if more is not None
        }
        uneven = None
        if HARMONICS not in self.causes:
            uneven = find_harmonics(self.problem, self.fitted)
        return found if uneven is None else {**found, HARMONICS: uneven}

    @cached_property
    def _bent_by_loads(self) -> list[F64]:
        """Per log (N, D) deflections of elastic joints that the readings show to first order."""
        bends, numbers = self._loads(BENDS[0]), self.bends[BENDS[0]].numbers
        logs, D = self.problem.logs, self.problem.tree.n_joints
        return [bends.moved(log, g, numbers).q[:, :D] - log.q for g, log in enumerate(logs)]

    def with_gaps(self) -> Attempt | None:
        """With joints in gaps, by loads as they bend joints to first order; None as on springs."""
        bends = self._loads(BENDS[0])
        loads = self.bends[BENDS[0]].numbers[: len(bends.basis)]
        return self.in_gaps(self.fitted.state, bends, loads, self._bent_by_loads)

    def in_gaps(
        self, begin: MotionState, bends: Bending, loads: F64, bent: Sequence[F64]
    ) -> Attempt | None:
        """With joints that lie in gaps; None where they hang within them, as on springs.

        Args:
            begin: a state to begin with.
            bends: what would bend springs.
            loads: (P,) by how much.
            bent: per log (N, D or more) deflections of these springs [rad or m].
        """
        half = rms(bent)[: self.problem.tree.n_joints]
        found = fit_gaps(self.problem, begin, bends, loads, half)
        if found is None:
            return None
        return replace(self, problem=found[0], fitted=found[1], causes=(*self.causes, PLAY))

    def tilted(self) -> Attempt | None:
        """With tilts of the base of the size that is shown; None where none is for certain."""
        if (more := self._tilting) is None:
            return None
        size = self.beside_rounding(more) or size_of(self.problem, self.fitted, more)
        return self.with_more(TILTS, more, size.size) if size.gain > CERTAIN else None

    @property
    def _tilting(self) -> Unseen | None:
        """Tilts of the base by themselves; None of one that moves already."""
        problem = self.problem
        if problem.unseen is not None and problem.unseen.moves_base(problem.tree.n_joints):
            return None
        return tilts(problem.tree, problem.logs, self.fitted.state.placements.up)

    def likely(self, causes: Collection[str]) -> list[str]:
        """Of what bends, the causes that may explain most of what is lacking, the likeliest first.

        To first order deflections are linear in the loads, and one look at the residuals tells what
        loads of a size that they all share would gain. To follow them takes fifty times as long.
        None is likely that says less than slack of any kind would, or too little for the misfit.
        Where slack may all be what encoders round off, it is no rival.
        """
        if self.misfit > EXPLAINED or self.has_own_slack:
            gains = {cause: gain for cause, gain in self.gains.items() if gain > self._enough}
        else:
            gains = {cause: size.gain for cause, size in self.certain_bends.items()}
        return sorted(gains.keys() & set(causes), key=lambda cause: -gains[cause])

    def may_be_explained_by(self, bends: Unseen) -> bool:
        """Whether deflections under known loads are likely to explain enough, by the same look."""
        return size_of(self.problem, self.fitted, bends).gain > self._enough

    @cached_property
    def _enough(self) -> float:
        """Logarithm of the likelihood that what bends has to gain to first order."""
        enough = 0.0 if self.slack_size is None else self.slack_size.gain
        if self.misfit > EXPLAINED:
            enough = max(enough, 0.5 * (1 - MOST_OF_IT) * self._excess)
        return enough

    @property
    def gains(self) -> dict[str, float]:
        """Logarithm of the likelihood that loads of each kind of what bends would gain."""
        return {cause: found.gain for cause, found in self.bends.items()}

    @cached_property
    def bends(self) -> dict[str, Size]:
        """What the readings show of each kind of what bends, to first order.

        A base that tilts by itself gives way to no load as well.
        """
        kinds = BENDS[:1] if TILTS in self.causes else BENDS
        return {cause: size_of(self.problem, self.fitted, self._loads(cause)) for cause in kinds}

    def _loads(self, cause: str) -> Bending:
        """The deflections that loads of one kind of what bends can make."""
        problem, state = self.problem, self.fitted.state
        return bending(
            problem.tree, problem.logs, state.placements, state.gravity,
            joints=cause == "elastic", base=cause == BASE,
        )  # fmt: skip

    @cached_property
    def _rounded_again(self) -> Unseen | None:
        """What encoders round off, drawn anew; None where they round nothing."""
        return rounded_off_again(self.problem.logs)

    @property
    def _excess(self) -> float:
        """Chi-squared of mean residuals over spans beyond what noise makes of it."""
        _, variances = span_means(self.problem, self.fitted.predicted, self.fitted.weights, SPAN)
        return (self.misfit - 1) * int(np.isfinite(variances).sum())

    def with_more(self, name: str, more: Unseen, size: float) -> Attempt:
        """With more unseen motion of a common size."""
        problem = with_unseen(self.problem, more, size)
        zero = np.zeros(more.n_numbers)
        state = self.fitted.state
        state = replace(state, unseen=np.concatenate([state.unseen, zero]))
        return replace(
            self, problem=problem, fitted=fit(problem, state), causes=(*self.causes, name)
        )

    def with_rounding(self) -> Attempt | None:
        """With slack, where it is lacking and all of it may be what encoders round off: no cause.

        So little leaves a fit where it is but for a step, of which the equations are known.
        """
        size = self.certain_slack
        if self.shown is None or size is None:
            return None
        if self._is_more_than_rounding(size):
            size = self._size_beside_rounding or size
            if self._is_more_than_rounding(size):
                return None
        if size.gain <= CERTAIN:
            return self
        problem, equations = self.shown.begun(0, size.size)
        before = self.fitted
        none = np.zeros(problem.layout.n_unseen - len(before.state.unseen))
        state = replace(before.state, unseen=np.concatenate([before.state.unseen, none]))
        fitted = fit(problem, state, near=True, predicted=before.predicted, equations=equations)
        return replace(self, problem=problem, fitted=fitted)

    @cached_property
    def _size_beside_rounding(self) -> Size | None:
        """Slack beyond what encoders round off while joints move; None where they round nothing."""
        return None if self.places is None else self.beside_rounding(self.places)

    def beside_rounding(self, more: Unseen) -> Size | None:
        """The size of unseen motion beyond what encoders round off while joints move.

        None where they round nothing.
        """
        again = self._rounded_again
        if again is None:
            return None
        return lacking(self.problem, self.fitted, [more, again]).size(0, Shared(draws=1))

    def slackened(self) -> Attempt:
        """With slack where the readings show any for certain, else as it is."""
        if self.certain_slack is None:
            return self
        return self.with_rounding() or self.with_slack()

    def steady(self) -> Attempt:
        """Without biases and scales that drift, with all other causes where they are but a step."""
        problem, state = with_steady_scales(self.problem, self.fitted.state)
        priors = replace(problem.priors, bias_walk=0.0)
        steady = MotionProblem(problem.tree, problem.logs, priors, unseen=problem.unseen)
        state = replace(state, knots=tuple(each[:0] for each in state.knots))
        causes = tuple(cause for cause in self.causes if cause not in (DRIFT, WARMING))
        return replace(self, problem=steady, fitted=fit(steady, state, near=True), causes=causes)

    def with_slack(self) -> Attempt:
        """With slack of the size that the readings show."""
        if self.places is None or self.slack_size is None:
            return self
        return self.with_more("slack", self.places, self.slack_size.size)

    def with_known_torque(self) -> Attempt | None:
        """With joints that yield under torques that are known; None where that explains little.

        Torques are those that the log holds, or of links that are known.
        """
        best: Attempt | None = None
        ways = (
            (True, with_measured_torque(self.problem, self.fitted, self.may_be_explained_by)),
            (False, with_known_torque(self.problem, self.fitted)),
        )
        for measured, found in ways:
            if found is None or not yields(*found, in_either_sense=measured):
                continue
            problem, fitted = found
            attempt = replace(self, problem=problem, fitted=fitted, causes=(*self.causes, BENDS[0]))
            if explains_most(attempt, best or self):
                best = attempt
        return best

    def adding(self, cause: str) -> Attempt:
        """With joints or a base that yield, or with biases or scales that drift."""
        causes = (*self.causes, cause)
        if cause == DRIFT:
            problem, fitted = _with_drifting_biases(self.problem, self.fitted)
        elif cause == WARMING:
            problem, fitted = fit_warming(self.problem, self.fitted)
        else:
            bends = {name: name in causes for name in BENDS}
            problem, fitted = fit_yielding(self.problem, self.fitted, **bends)
        return replace(self, problem=problem, fitted=fitted, causes=causes)


def explains_most(one: Attempt, other: Attempt) -> bool:
    """Whether an attempt takes most of what another one leaves.

    Of slack, and of what bends, its size counts: likelihoods are in the noise that a fit leaves,
    which falls with what it explains.
    """
    if other.misfit > EXPLAINED:
        return one.misfit - 1 < MOST_OF_IT * (other.misfit - 1)
    if one.misfit >= EXPLAINED:
        return False
    if not other.has_own_slack and other.certain_bends:
        return all(
            cause not in one.certain_bends or one.certain_bends[cause].size < MOST_OF_IT * much.size
            for cause, much in other.certain_bends.items()
        )
    return one.slack_left < MOST_OF_IT * other.slack_left


def _with_drifting_biases(problem: MotionProblem, fitted: Fitted) -> tuple[MotionProblem, Fitted]:
    """The fit with biases that walk, by as much as they are then found to do.

    The mean square of a walk of s per root of a second, about its mean over a time T, is
    ``s^2 T / 6``.
    """
    slow = variance_beyond(*span_means(problem, fitted.predicted, fitted.weights, SPAN))
    lengths = [float(log.time[-1] - log.time[0]) for log in problem.logs]
    walk = np.sqrt(slow * 6 / max(lengths))
    n_knots = [max(2, round(length / _KNOTS) + 1) for length in lengths]
    state = replace(
        fitted.state, knots=tuple(np.zeros((n, problem.tree.n_sus, 3)) for n in n_knots)
    )
    priors = replace(problem.priors, bias_walk=float(walk))
    walking = MotionProblem(problem.tree, problem.logs, priors, n_knots, problem.unseen)
    return walking, fit(walking, state)
