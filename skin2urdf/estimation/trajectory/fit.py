"""Levenberg-Marquardt on all samples of all logs, with weights that follow the residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Bool, give_back_freed_memory
from skin2urdf.estimation.problem.state import N_SU
from skin2urdf.estimation.trajectory.arrow import eliminated, newton_step
from skin2urdf.estimation.trajectory.bending import bends_among
from skin2urdf.estimation.trajectory.gyro import rate_weights
from skin2urdf.estimation.trajectory.kinematics import levers
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Equations, Predicted
from skin2urdf.estimation.trajectory.shaken import Shaken, made_by_encoders
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.threads import MANY

_HUBER = 3.0
"""Residual, in standard deviations, beyond which a sample counts less; noise is one in 400."""
_DAMPING, _FELT, _FALL = 1e-4, 1e-2, 10.0
"""Share of its own information by which each coordinate is held at first, and of which steps are
held back at all. It grows to that, and by ten, with every step that fails, and falls by ten with
every one that succeeds at once: what had to be held back to succeed would fail again."""
_ARRIVED = 0.5
"""Length of a last step in standard deviations, those of placements, biases and shapes together.
Some hundred coordinates share the rest."""
_SHRINK = 3.0
"""By how much each step is shorter than the one before at least, as weights follow the residuals.
Of a step that is followed by a last one the next need not be worked out where it would be as much
shorter again and too short to be taken."""
_SHORT = 0.1
"""Length of a step, over that of a last one, from which it is worth taking."""
_FEW_SUS = 10
"""SUs whose own coordinates together may be as far off as that: more than any robot has segments,
of which each has one. The lengths of a thousand add up to ten times that, wherever a fit is."""
_ROUGHLY = 30.0
"""Length of a step, in standard deviations, from which all coordinates may move."""
_ENOUGH, _THINNEST = 1500, 4
"""Samples that lead near, and the part of all that they are at least."""
MOST_VALUES = 1 << 24
"""Values of all samples, SUs and axes from which samples that tell nothing of their own are left
out: one array of so many takes 128 MiB, and about ten are needed at a time."""
_QUIET = 1e-5
"""Noise of a sample at least [m/s^2], 1 ug: no accelerometer has less, and simulated ones without
noise are fitted no worse for it."""
_NO_GAIN = 1e-7
"""Part of chi-squared below which an iteration gains nothing: a hundredth of its scatter with a
hundred thousand measurements."""
_OF_CHANCE = 1.0
"""Fall of chi-squared up to which a step that follows what it finds gains nothing: that of one
standard deviation. Of joints that seem to yield and do not, further steps take as long as all
before, and change no position by a hundredth of its deviation."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A state that explains all samples as well as it can.

    Attributes:
        problem: what was fitted.
        state: the state.
        noise: per log (K, U, 3) standard deviation of each sample as the residuals show it; with
            gyroscopes (K, U, 6), theirs last [m/s^2, rad/s].
        weights: per log, of the same shape, information that each sample counted with.
        predicted: per log, residuals at the state.
        chi2: sum of squared residuals over noise, times independence, priors included.
    """

    problem: MotionProblem
    state: MotionState
    noise: tuple[F64, ...]
    weights: tuple[F64, ...]
    predicted: tuple[Predicted, ...]
    chi2: float

    @cached_property
    def equations(self) -> Equations:
        """Normal equations at the state."""
        return self.problem.equations(self.state, self.predicted, self.weights)

    @cached_property
    def shaken(self) -> Shaken:
        """What the noise of encoders makes of predictions at the state, with these weights."""
        return shaken_by(self.problem, self.state, self.weights)

    def shaken_with(self, wider: MotionProblem, state: MotionState) -> Shaken:
        """The same of a problem with more unseen motion, at the state with its numbers.

        A fit on springs has not been paid for cutting noise off, and further ones are not either.
        Of a fit without any nothing is known of that: where rounding is far from white, what it is
        taken to be would make springs certain. What noise makes of them shows where they are
        followed.
        """
        before, there = (len(bends_among(each.unseen)) for each in (self.problem, wider))
        return shaken_by(wider, state, self.weights) if 0 < before < there else self.shaken

    def minimised(self, equations: Equations) -> Equations:
        """Normal equations at the state, without what is gained by cutting noise off.

        Of what a fit minimises that is no part, so that its optimum is where these are zero.

        Args:
            equations: of its samples.
        """
        return self.shaken.taken_off(equations, self.problem, self.state)

    def keep(self, equations: Equations) -> None:
        """Take normal equations at the state, which need not be worked out again."""
        vars(self)["equations"] = equations


def shaken_by(problem: MotionProblem, state: MotionState, weights: Sequence[F64]) -> Shaken:
    """What the noise of encoders makes of predictions at a state, with weights per log."""
    return Shaken.of(problem.tree, problem.logs, state, weights, problem.unseen)


def fit(
    problem: MotionProblem,
    start: MotionState,
    *,
    iterations: int = 30,
    tolerance: float = _ARRIVED,
    near: bool = False,
    far: bool = False,
    predicted: tuple[Predicted, ...] | None = None,
    equations: Equations | None = None,
    tell: Callable[[float], None] = lambda _: None,
) -> Fitted:
    """Minimise chi-squared of all samples.

    Args:
        problem: the logs, the tree and what is known before.
        start: where to begin; orientations to some ten degrees are enough.
        iterations: at most that many linearisations.
        tolerance: length of the last step in standard deviations, all coordinates together.
        near: whether it begins at an optimum of nearly the same problem, where all coordinates may
            move at once.
        far: whether it begins so far away that steps have to be held back on the way, and that
            placements can not be found without what encoders do not see.
        predicted: per log, residuals where it begins, if they are known.
        equations: normal equations where it begins, if they are known, and it is near.
        tell: told the share of the work that is done.
    """
    if not near:
        rough = _near(problem, start, iterations, lambda share: tell(0.5 * share), far)
        start, predicted = rough.state, rough.predicted if rough.problem is problem else None
    begin = 0.0 if near else 0.5
    free = problem.free_joint, problem.free_su
    found = _descend(
        problem, start, free, tolerance, iterations,
        lambda share: tell(begin + (1.0 - begin) * share), far,
        predicted=predicted, known=equations if near else None,
    )[1]  # fmt: skip
    if problem.tree.n_sus >= MANY:
        give_back_freed_memory()
    return found


def independent(logs: Sequence[Trajectory], most: int = MOST_VALUES) -> list[Trajectory]:
    """Logs with about as many samples as are independent of each other, where they hold very many.

    Low-passed as they are, neighbours share most of their noise: to leave some out loses little.

    Args:
        logs: trajectories.
        most: values of all samples, SUs and axes up to which none is left out.
    """
    if sum(3 * log.valid.size for log in logs) <= most:
        return list(logs)
    return [log.thinned(round(1 / log.independence)) for log in logs]


def leading(problem: MotionProblem) -> MotionProblem | None:
    """The problem with a part of the samples, enough to lead near; None where all are few."""
    thin = min(_THINNEST, sum(len(log.kept) for log in problem.logs) // _ENOUGH)
    return problem.again(logs=[log.thinned(thin) for log in problem.logs]) if thin > 1 else None


def _near(
    problem: MotionProblem,
    start: MotionState,
    iterations: int,
    tell: Callable[[float], None],
    far: bool,
) -> Fitted:
    """A state as near to the optimum as part of the samples leads.

    All coordinates move once those are near that the others would make up for.
    """
    few = leading(problem)
    thin, problem = few is not None, few or problem

    def descend(free: tuple[Bool, Bool], begin: Fitted | None) -> Fitted:
        state, predicted = (start, None) if begin is None else (begin.state, begin.predicted)
        _, found = _descend(
            problem, state, free, _ROUGHLY, iterations, tell, far, predicted=predicted
        )
        return found

    # Where nothing is felt to change, as by an SU on the axis that turns it, no lag changes
    # anything either: placements come first.
    found = descend(problem.coarse(unseen=far, lags=False), None)
    found = descend(problem.coarse(unseen=far), found)
    return descend((problem.free_joint, problem.free_su), found) if thin else found


@dataclass(frozen=True, eq=False)
class Led:
    """Where a step leads in a problem that is linear about a state.

    Attributes:
        problem: about there, as far as the step is judged by it.
        state: the same place in its numbers.
        whole: makes the problem with all derivatives, for steps that are taken.
    """

    problem: MotionProblem
    state: MotionState
    whole: Callable[[], MotionProblem]


Follow = Callable[[MotionProblem, MotionState], Led | None]
"""What makes a problem that is linear about a state from one that is so about another; None where
there is none."""


def _stay(problem: MotionProblem, state: MotionState) -> Led:
    """The same problem, about whatever state."""
    return Led(problem, state, lambda: problem)


def fit_following(
    problem: MotionProblem,
    start: MotionState,
    follow: Follow,
    *,
    iterations: int,
    tolerance: float = 0.1,
) -> tuple[MotionProblem, Fitted]:
    """Minimise chi-squared of a problem that is known about each state only.

    Every step is judged by the problem about where it leads, so that chi-squared falls.

    Args:
        problem: about where it begins.
        start: where to begin.
        follow: makes the problem about another state.
        iterations: at most that many steps.
        tolerance: length of the last step in standard deviations, all coordinates together.

    Returns:
        The problem about where it ends, and the fit.
    """
    free = problem.free_joint, problem.free_su
    # A step that was held back says nothing of how far it still is.
    return _descend(problem, start, free, tolerance, iterations, lambda _: None, True, follow)


def _descend(
    problem: MotionProblem,
    start: MotionState,
    free: tuple[Bool, Bool],
    tolerance: float,
    iterations: int,
    tell: Callable[[float], None],
    far: bool = False,
    follow: Follow = _stay,
    predicted: tuple[Predicted, ...] | None = None,
    known: Equations | None = None,
) -> tuple[MotionProblem, Fitted]:
    """Minimise chi-squared over some coordinates; from far away steps may have to be held back."""
    free_joint, free_su = free
    state = start
    predicted = predicted or tuple(problem.predict(state, g) for g in range(len(problem.logs)))
    noise, weights = _noise(problem, state, predicted)
    shaken = shaken_by(problem, state, weights)
    cost = _cost(problem, state, predicted, weights, shaken)
    damping = _DAMPING
    longest, before = 0.0, np.inf
    for _ in range(iterations):
        equations, known = known or problem.equations(state, predicted, weights), None
        at_once, enough = True, _SHORT * tolerance
        while True:
            pulled = shaken.taken_off(equations, problem, state)
            system = eliminated(pulled, free_joint, free_su, damping)
            joint, sus = newton_step(system, free_joint)
            length = step_length(equations, joint, sus, free)
            if not length >= enough:  # NaN is not
                tell(1.0)
                here = Fitted(problem, state, noise, weights, predicted, cost)
                here.keep(equations)
                return problem, here
            led = follow(problem, problem.layout.moved(state, joint, sus))
            if led is not None:
                about, trial = led.problem, led.state
                ahead = tuple(about.predict(trial, g) for g in range(len(problem.logs)))
                trial = about.refit_sensors(trial, ahead, weights, free_su)
                there = _cost(about, trial, ahead, weights, shaken)
                if there <= cost:
                    break
            if not far or length < tolerance:
                # There is nothing to gain any more: it is as near as it was to come.
                enough = tolerance
            damping = max(_FALL * damping, _FELT)
            at_once = False
        if far and damping > _DAMPING:
            length = np.inf  # a step that was held back says nothing of how far it still is
        fell, gain = cost - there, (cost - there) / max(cost, 1e-12)
        problem, state, predicted = led.whole(), trial, ahead
        if at_once:
            damping = max(damping / _FALL, 1e-12)
        noise, weights = _noise(problem, state, predicted)
        shaken = shaken_by(problem, state, weights)
        cost = _cost(problem, state, predicted, weights, shaken)
        shrinks = length / before if at_once and length < before < np.inf else 1.0
        longest, before = max(longest, length) if length < np.inf else longest, length
        if tolerance < length < longest:
            # Steps become shorter by a factor each time: what counts is how many such are left.
            tell(float(np.log(longest / length) / np.log(longest / tolerance)))
        last = length < tolerance
        last = last or (length < _SHRINK * tolerance and length * shrinks < _SHORT * tolerance)
        # Clocks and front ends, which a length leaves out, are still on their way where chi-squared
        # falls by more than a step of that length explains.
        if (last and fell < max(1.0, tolerance**2, len(sus) / _FEW_SUS)) or gain < _NO_GAIN:
            break
        # What is known about a state only is never known well enough for the last of it.
        if follow is not _stay and fell < _OF_CHANCE:
            break
    tell(1.0)
    return problem, Fitted(problem, state, noise, weights, predicted, cost)


def held(problem: MotionProblem, state: MotionState) -> Fitted:
    """All samples held against a state.

    Args:
        problem: the logs, the tree and what is known before.
        state: where.
    """
    if problem.tree.n_sus >= MANY:
        give_back_freed_memory()
    predicted = tuple(problem.predict(state, g) for g in range(len(problem.logs)))
    noise, weights = _noise(problem, state, predicted)
    shaken = shaken_by(problem, state, weights)
    cost = _cost(problem, state, predicted, weights, shaken)
    return Fitted(problem, state, noise, weights, predicted, cost)


def cost_with(weights: Sequence[F64], shaken: Shaken, fitted: Fitted) -> float:
    """Chi-squared of a fit with the weights of another, so that the two can be compared.

    Args:
        weights: per log, information of each sample, as in :class:`Fitted`.
        shaken: what encoders' noise makes of predictions with these weights.
        fitted: the fit.
    """
    return _cost(fitted.problem, fitted.state, fitted.predicted, weights, shaken)


def step_length(equations: Equations, joint: F64, sus: F64, free: tuple[Bool, Bool]) -> float:
    """Length of a step in standard deviations of placements, biases and shapes.

    What clocks and front ends would make up for does not count: where a sensor has no low-pass that
    shows, these wander along a valley without an end, in which nothing else moves. Of many SUs what
    each moves beside its link counts as that of a few: together they are never as near as one.
    """
    free_joint, free_su = free
    towards = np.einsum("unm,um->un", equations.su, sus) + equations.mixed @ joint
    follows = np.einsum("unj,un->j", equations.mixed, sus)
    square = float(joint @ (equations.joint @ joint + follows) + np.einsum("un,un->", sus, towards))
    sensors = free_su & (np.arange(free_su.shape[1]) >= N_SU)
    inverse = eliminated(equations, np.zeros(len(joint), dtype=bool), sensors).su_inverse
    square -= float(np.einsum("unm,un,um->", inverse, towards, towards))
    if len(sus) > _FEW_SUS:
        shared = float(joint @ eliminated(equations, free_joint, free_su).schur @ joint)
        square = shared + (square - shared) * _FEW_SUS / len(sus)
    return float(np.sqrt(max(0.0, square)))


def _cost(
    problem: MotionProblem,
    state: MotionState,
    predicted: Sequence[Predicted],
    weights: Sequence[F64],
    shaken: Shaken,
) -> float:
    """Chi-squared with given weights, without what is gained by cutting noise off."""
    data = shaken.cut_off(state, problem.unseen)
    for w, p in zip(weights, predicted, strict=True):
        square = np.einsum("kuc,kuc,kuc->ku", w[..., :3], p.residual, p.residual)
        data += float(square[p.measured].sum())
        if p.turned is not None:
            data += float((w[..., 3:] * p.turned.residual**2).sum())
    return data + problem.prior_chi2(state)


def _noise(
    problem: MotionProblem, state: MotionState, predicted: Sequence[Predicted]
) -> tuple[tuple[F64, ...], tuple[F64, ...]]:
    """Noise of each sample and weights.

    It is what residuals of the SU show at rest and in motion, what encoders leave around a rest
    beside what the most of it shows, what its sampling leaves open where a joint on its way leaps,
    and by what its digits are off alike for a while.
    """
    noise, weights = [], []
    arms = levers(problem.tree, state.placements)
    for log, p in zip(problem.logs, predicted, strict=True):
        # By SU, as all axes have the same; which views give to each.
        shape = p.residual.shape
        sd = np.full(shape[1::-1], np.inf).T
        around = made_by_encoders(problem.tree, log, state.placements)
        square = np.einsum("kuc,kuc->uk", p.residual, p.residual).T
        for joint in np.unique(problem.tree.su_joint).tolist():
            sus = np.flatnonzero(problem.tree.su_joint == joint)
            moves = log.moving[:, list(problem.tree.chain(joint))].any(axis=1)
            for which in (moves, ~moves):
                some = square.T[sus][:, which], p.measured.T[sus][:, which]
                sd[np.ix_(which, sus)] = _spreads(*some)
            if around is not None:
                still = np.ix_(~moves, sus)
                sd[still] = np.hypot(sd[still], np.sqrt(around[sus][:, ~moves]).T)
        if log.leaps is not None:
            sd = np.hypot(sd, np.sqrt(log.leaps.variance(arms)))
        sd = np.hypot(sd, np.sqrt(log.rounded))
        size = np.where(p.measured, np.sqrt(square / 3) / sd, 0.0)
        share = _HUBER / np.maximum(size, _HUBER)
        w = np.where(p.measured, log.independence * share, 0.0) / sd**2
        w = np.where(np.isfinite(w), w, 0.0)
        noise.append(np.broadcast_to(sd[..., None], shape))
        weights.append(np.broadcast_to(w[..., None], shape))
    turned = [p.turned for p in predicted]
    if any(t is not None for t in turned):
        rates = rate_weights(problem.tree, problem.logs, problem.gyros, turned)
        noise = [np.concatenate(each, axis=2) for each in zip(noise, rates[0], strict=True)]
        weights = [np.concatenate(each, axis=2) for each in zip(weights, rates[1], strict=True)]
    return tuple(noise), tuple(weights)


def _spreads(square: F64, measured: Bool) -> F64:
    """(S,) standard deviations of residuals of squares (S, K), all axes together.

    They are those of their medians, which outliers do not move.

    Args:
        square: sums over the axes of an SU.
        measured: (S, K) which count.
    """
    out, count = np.full(len(square), np.inf), measured.sum(axis=1)
    enough = count >= 8
    whole = enough & (count == square.shape[1])
    if whole.any():
        out[whole] = np.median(square[whole], axis=1)
    for s in np.flatnonzero(enough & ~whole).tolist():
        out[s] = np.median(square[s, measured[s]])
    # The median of chi-squared with three degrees of freedom is 2.366.
    return np.maximum(np.sqrt(out / 2.366), _QUIET)
