"""A base that moves as the SUs on it feel: taken off what all SUs read.

A robot on wheels is pushed back by what its arm does, a table rocks, a ship rolls. To an arm's own
SUs a push that goes with the arm is no other than links that are longer or shorter: all are carried
back by the same share of what they move by. An SU on the base feels it, and nothing else.

Whether the base moves is asked of the SUs on the joints alone, whose noise is none of that of the
SUs on the base: with free numbers, of which nothing is known before. That what the SUs on the base
read is explained as well then proves that it is the base which moves, and not sensors that warm up
together. How these are turned is known from there on, and what they feel is what the base does
(:mod:`felt_on_the_base`).

Of a base that yields to the robot's loads these tell what the noise of such an SU hides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse
from skin2urdf.estimation.trajectory.base_clock import read_with_others
from skin2urdf.estimation.trajectory.felt_on_the_base import (
    UNIT,
    Felt,
    Numbers,
    about,
    felt_as_it_yields,
    felt_on_the_base,
    free_motion,
)
from skin2urdf.estimation.trajectory.fit import Fitted, Led, fit, fit_following, held, leading
from skin2urdf.estimation.trajectory.misfit import SPAN
from skin2urdf.estimation.trajectory.on_the_base import turned_as_the_base
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import CERTAIN, Size, lacking, with_unseen
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.estimation.trajectory.yielding import fit_yielding
from skin2urdf.signals.filters import Spline
from skin2urdf.signals.trajectory import Trajectory

FELT = "felt"
"""What it is called beside causes that are looked for."""
_MOST_SUS = 3
"""SUs on the base that are asked, those with most samples: three tell all motion of a body."""
_COVERED = 0.9
"""Part of a log in which an SU has to read so that it is asked: where it does not, nothing is known
of the base, and no SU is compared."""
_STEPS = 12
"""Steps at most until the motion of the base is found."""
_ITS_OWN = 0.5
"""Part of what SUs on the base read that may be left: where more is, they feel something else."""


@dataclass(frozen=True, eq=False)
class MovingBase(Record):
    """Motion of the base that was taken off the readings.

    Attributes:
        sus: (B,) SUs on the base that felt it, and
        names: their names.
        motion: what the base does by more of each number that makes its motion.
        felt: (B,) by how much they feel it accelerate, or tilt, rms [m/s^2].
        by_noise: per log (N, U, 3) by how much readings would be others if the noise of what is
            felt had a part in the numbers [m/s^2].
        goes_with_loads: whether loads of the robot explain all that others feel of it.
    """

    sus: Int
    names: tuple[str, ...]
    motion: Unseen
    felt: F64
    by_noise: tuple[F64, ...]
    goes_with_loads: bool

    def unsure(self, problem: MotionProblem, fitted: Fitted) -> list[tuple[F64, F64]]:
        """Parts (J,) and (U, n) of the gradient by which the base's motion may be off.

        Args:
            problem: what was fitted to readings without that motion.
            fitted: its fit.
        """
        seen = lacking(*_without(problem, fitted, self.sus), [self.motion])
        joint, su = seen.pulls(0)
        known = eliminated(seen.minimised, seen.problem.free_joint, seen.problem.free_su)
        at = seen.groups[0]
        covariance = joint_inverse(known.schur, seen.problem.free_joint)[np.ix_(at, at)]
        lam, V = np.linalg.eigh(covariance)
        roots = V * np.sqrt(lam.clip(min=0.0))
        parts = [
            np.where(p.measured[:, :, None], w[..., :3] * each[log.kept], 0.0)
            for log, p, w, each in zip(
                problem.logs, fitted.predicted, fitted.weights, self.by_noise, strict=True
            )
        ]
        for part in parts:
            part[:, self.sus] = 0.0
        of_noise = problem.gradients(fitted.state, fitted.predicted, [parts])
        of_numbers = zip(roots.T @ joint, np.einsum("sr,sun->run", roots, su), strict=True)
        return [*of_numbers, *of_noise]


def standing_still(
    problem: MotionProblem, fitted: Fitted, *, yields: bool = True
) -> tuple[MotionProblem, Fitted, MovingBase | None]:
    """What was fitted, with readings as they would be if the base stood still.

    Args:
        problem: the logs, of a robot on a base that stands still.
        fitted: its fit.
        yields: whether the base may yield to the robot's loads.

    Returns:
        The same, and None, where no SU on the base feels anything that the others do as well.
    """
    asked = _asked(problem)
    if not len(asked) or problem.unseen is not None:
        return problem, fitted, None
    given = problem, fitted, None
    problem, fitted = read_with_others(problem, fitted, asked)
    whole = problem.again(logs=[_where_known(log, asked) for log in problem.logs])
    state, asked = _with_sus_turned(whole, fitted, asked)
    if not len(asked):
        return given
    by_loads, goes_with_loads = None, False
    if yields:
        yielding, there = fit_yielding(problem, fitted, elastic=False, base=True)
        if yielding.unseen is not None:
            goes_with_loads = not _shown(yielding, there, asked).gain > CERTAIN
            by_loads = felt_as_it_yields(yielding.unseen, whole.logs, there.state, asked)
    felt = felt_on_the_base(whole.logs, state.placements, state.gravity, asked, by_loads)
    none = Numbers.none(problem.priors.sensors)
    others = whole.again(logs=_of_others(whole.logs, asked))

    def moved_by(felt: Sequence[Felt], numbers: Numbers) -> MotionProblem:
        motion = about(problem.tree, felt, numbers)
        priors = replace(problem.priors, unseen=np.full(motion.n_numbers, UNIT))
        return MotionProblem(problem.tree, others.logs, priors, problem.layout.n_knots, motion)

    def found_by(felt: Sequence[Felt], begin: MotionState) -> MotionState:
        def follow(_: MotionProblem, at: MotionState) -> Led:
            there = moved_by(felt, none.at(at.unseen))
            return Led(there, at, lambda: there)

        first = moved_by(felt, none.at(begin.unseen))
        return fit_following(first, begin, follow, iterations=_STEPS)[1].state

    begin = replace(state, unseen=np.zeros(none.n_numbers))
    # Where noise is part of what is felt, it pays to choose turns and places that cancel it.
    quiet = [replace(each, s=each.likeliest) for each in felt]
    moved = found_by(quiet, begin)
    other = found_by(felt, moved)
    state = replace(moved, unseen=np.zeros(0))
    motion, otherwise = (about(problem.tree, felt, none.at(x.unseen)) for x in (moved, other))
    still = _taken_off(whole, state, motion, moved.unseen)
    by_noise = tuple(
        one.readings - two.readings
        for one, two in zip(still, _taken_off(whole, state, otherwise, other.unseen), strict=True)
    )
    problem = problem.again(logs=[_told_by_gravity(log, asked) for log in still])
    names = tuple(problem.tree.su_names[u] for u in asked)
    found = MovingBase(
        asked, names, motion, felt_beside_the_mean(whole.logs, asked), by_noise, goes_with_loads
    )
    return problem, fit(problem, state, near=True), found


def _with_sus_turned(whole: MotionProblem, fitted: Fitted, asked: Int) -> tuple[MotionState, Int]:
    """A state with SUs on the base turned as they feel, and those whose motion all others feel.

    Args:
        whole: the logs where the SUs that are asked read.
        fitted: a fit of them.
        asked: (B,) SUs on the base.

    Returns:
        The state, and which of these SUs it explains; none where the others feel none of it.
    """
    few = leading(whole)
    size = _shown(*((whole, fitted) if few is None else (few, held(few, fitted.state))), asked)
    if size.gain <= CERTAIN:
        return fitted.state, asked[:0]
    free = free_motion(whole.tree, whole.logs, fitted.state.gravity, asked)
    others = whole.again(logs=_of_others(whole.logs, asked))
    begin = replace(fitted.state, unseen=size.numbers)
    state = fit(with_unseen(others, free, size.size), begin, near=True).state
    state = turned_as_the_base(with_unseen(whole, free, size.size), state, SPAN)
    still = _taken_off(whole, replace(state, unseen=np.zeros(0)), free, state.unseen)
    before, after = (felt_beside_the_mean(logs, asked) for logs in (whole.logs, still))
    return replace(state, unseen=np.zeros(0)), asked[after**2 < _ITS_OWN * before**2]


def _shown(problem: MotionProblem, fitted: Fitted, asked: Int) -> Size:
    """What other SUs show, beyond a fit, of motion of the base that SUs on it feel.

    Args:
        problem: the logs.
        fitted: their fit.
        asked: (B,) SUs on the base.
    """
    free = free_motion(problem.tree, problem.logs, fitted.state.gravity, asked)
    return lacking(*_without(problem, fitted, asked), [free]).size(0)


def _asked(problem: MotionProblem) -> Int:
    """(B,) SUs on the base that read nearly all the time, those that do most first."""
    on_base = np.flatnonzero(problem.tree.su_joint < 0)
    read = np.min([log.valid[:, on_base].mean(axis=0) for log in problem.logs], axis=0)
    order = np.argsort(-read, kind="stable")[:_MOST_SUS]
    return np.asarray(on_base[order[read[order] >= _COVERED]])


def _where_known(log: Trajectory, asked: Int) -> Trajectory:
    """A log in which no SU is compared where one of those that are asked does not read."""
    return replace(log, valid=log.valid & log.valid[:, asked].all(axis=1, keepdims=True))


def _but(log: Trajectory, asked: Int) -> Bool:
    """(K, U) what is compared of all but some SUs."""
    valid = np.array(log.valid)
    valid[:, asked] = False
    return valid


def _told_by_gravity(log: Trajectory, asked: Int) -> Trajectory:
    """A log in which one sample a span is compared of the SUs that were asked, which is their mean.

    Their motion has been taken for the base's: nothing is left but how they are turned.
    """
    valid = _but(log, asked)
    _, some = np.unique(log.time // SPAN, return_index=True)
    valid[np.ix_(some, asked)] = log.valid[np.ix_(some, asked)]
    whole = log.kept[log.valid[:, asked].all(axis=1)]
    readings = np.array(log.readings)
    readings[:, asked] = readings[whole][:, asked].mean(axis=0)
    if log.rates is None:
        return replace(log, valid=valid, readings=readings)
    rates = np.array(log.rates)
    rates[:, asked] = rates[whole][:, asked].mean(axis=0)
    return replace(log, valid=valid, readings=readings, rates=rates)


def _of_others(logs: Sequence[Trajectory], asked: Int) -> list[Trajectory]:
    """The logs where SUs that are asked read, without what they do."""
    return [replace(log, valid=_but(_where_known(log, asked), asked)) for log in logs]


def _without(problem: MotionProblem, fitted: Fitted, asked: Int) -> tuple[MotionProblem, Fitted]:
    """A problem and its fit without what SUs on the base read."""
    logs = _of_others(problem.logs, asked)
    predicted = tuple(
        replace(p, measured=p.measured & log.valid)
        for p, log in zip(fitted.predicted, logs, strict=True)
    )
    weights = tuple(
        np.where(log.valid[:, :, None], w, 0.0) for w, log in zip(fitted.weights, logs, strict=True)
    )
    about = problem.again(logs=logs)
    return about, replace(fitted, problem=about, predicted=predicted, weights=weights)


def _taken_off(
    problem: MotionProblem, state: MotionState, motion: Unseen, numbers: F64
) -> list[Trajectory]:
    """The logs without what a motion of the base makes of their readings.

    Args:
        problem: of a base that stands still.
        state: of that.
        motion: of the base.
        numbers: (S,) that make it.
    """
    dense = problem.again(logs=[_at_all_samples(log) for log in problem.logs])
    moving = with_unseen(dense, motion, UNIT)
    moved = replace(state, unseen=numbers)
    out = []
    for g, log in enumerate(problem.logs):
        still, there = dense.predict(state, g), moving.predict(moved, g)
        at = np.arange(len(log.q))[:, None] - log.rate * dense.lags(state, g)
        readings = _less(log.readings, still.residual - there.residual, at)
        rates = log.rates
        if rates is not None and still.turned is not None and there.turned is not None:
            rates = _less(rates, still.turned.residual - there.turned.residual, at)
        out.append(replace(log, readings=readings, rates=rates))
    return out


def _less(values: F64, more: F64, at: F64) -> F64:
    """Values (N, U, 3) of each SU's clock, without what was felt (N, U, 3) at samples (N, U)."""
    out = np.array(values)
    for u in range(out.shape[1]):
        felt = np.where(np.isfinite(more[:, u]), more[:, u], 0.0)
        out[:, u] -= Spline(felt).within(at[:, u].clip(0, len(felt) - 1))
    return out


def _at_all_samples(log: Trajectory) -> Trajectory:
    """A log that is compared at all samples of its grid."""
    N, U = log.readings.shape[:2]
    nothing = np.zeros((N, log.q.shape[1]))
    whole = np.ones((N, U), dtype=bool)
    return replace(
        log,
        kept=np.arange(N),
        valid=whole,
        moving=nothing.astype(bool),
        shaken=nothing,
        turning=None if log.turning is None else whole,
        beyond=None,
        thin=1,
    )


def felt_beside_the_mean(logs: Sequence[Trajectory], asked: Int) -> F64:
    """What SUs feel beside its mean in each log, while all of them read.

    Args:
        logs: trajectories, in some of which they read.
        asked: (B,) which SUs.

    Returns:
        (B,) of each, rms [m/s^2].
    """
    felt = []
    for log in logs:
        known = log.valid[:, asked].all(axis=1)
        if not known.any():
            continue
        x = log.readings[log.kept[known]][:, asked]
        felt.append(x - x.mean(axis=0))
    return np.asarray(np.sqrt((np.concatenate(felt) ** 2).sum(axis=2).mean(axis=0)))
