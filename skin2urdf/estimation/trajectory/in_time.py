"""When joints and SUs were read, where that is not what their stamps say.

Clocks wander against each other, joints are read one after another under one stamp, and drivers
smooth what they read. Each goes with the motion, and may pass for noise of SUs that move: so it is
looked for in any log, whether it lacks something or not. One look at the residuals tells what each
would gain. It counts where that is more for certain than gears, joints or a base that yield would
gain, and where it explains what is left.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory import smoothed
from skin2urdf.estimation.trajectory.attempt import (
    CLOCK,
    EXPLAINED,
    LAGS,
    SMOOTHED,
    Attempt,
    Explained,
    explains_most,
)
from skin2urdf.estimation.trajectory.fit import cost_with, fit
from skin2urdf.estimation.trajectory.reading_times import LATE, ReadingTimes
from skin2urdf.estimation.trajectory.slack import CERTAIN, Size, lacking, with_unseen
from skin2urdf.estimation.trajectory.wandering import wandering, with_steady_clocks
from skin2urdf.estimation.trajectory.yielding import is_in_balance

_OF_JOINTS: Mapping[str, ReadingTimes] = {
    LAGS: LATE,
    SMOOTHED: smoothed.SMOOTHED,
}
"""Ways in which joints are read, by cause."""
_LEFT = 0.01
"""Share of what a cause gained that it may leave for the others, since it is followed in steps that
leave a hundredth each: of clocks that wander by 10 ms 0.5 % looked like lags, of joints behind
low-passes of 5 to 15 Hz 0.6 % like a clock that wanders."""


def in_time(attempt: Attempt) -> Attempt:
    """An attempt with joints and SUs at the times, and as quick, as they were read.

    Args:
        attempt: the attempt without; returned as it is where the readings show none of it for
            certain.
    """
    best, denied, left = attempt, set[str](), 0.0
    while shown := _shown(best, {*best.causes, *denied}):
        cause = max(shown, key=lambda each: shown[each].gain)
        if cause == SMOOTHED and LAGS in shown:
            # Lags alone are simpler.
            cause = cause if shown[cause].gain > shown[LAGS].gain + CERTAIN else LAGS
        # It has to be certain that there is something, and that it is nothing else.
        gain = shown[cause].gain
        if gain <= CERTAIN + left or gain <= CERTAIN + left + _of_others(best, cause):
            break
        other = _with(best, cause, shown[cause].size)
        if other is not None and _comes_true(other, best, gain):
            best, left = other, left + _LEFT * gain
        else:
            denied.add(cause)
    return best


def with_times_open(found: Explained) -> Explained:
    """An explanation with numbers for what times of joints that were set right may be off by.

    Whatever they leave open is in what the fit states of all else.

    Args:
        found: the explanation.
    """
    problem, state = found.problem, found.fitted.state
    # Slack stands last.
    behind = int("slack" in found.causes)
    for read in found.read.values():
        more, numbers = read.way.unseen(problem.logs, read.numbers), read.numbers
        if more is None:
            continue
        problem = with_unseen(problem, more, float(np.sqrt((numbers**2).mean())), behind)
        groups = problem.unseen.several if problem.unseen is not None else ()
        first = sum(each.n_numbers for each in groups[: len(groups) - 1 - behind])
        state = replace(state, unseen=np.insert(state.unseen, first, np.zeros(len(numbers))))
    if problem is found.problem:
        return found
    return replace(found, problem=problem, fitted=fit(problem, state, near=True))


def how_joints_were_read(found: Explained) -> tuple[F64, F64, float]:
    """How old each joint's positions are, and how smoothed.

    Args:
        found: the explanation.

    Returns:
        (D,) by how much older than in the mean they are [s], (D,) by how much the joint is further
        per acceleration than it was read [s^2], and the part of a joint's accelerations that the
        last term of what undoes the smoothing makes up.
    """
    problem = found.problem
    n = problem.tree.n_joints
    ages, smoothing, unreached = np.zeros(n), np.zeros(n), 0.0
    for read in found.read.values():
        ages = ages + read.way.ages(read.numbers, n)
        smoothing = smoothing + read.way.smoothing(read.numbers, n)
        unreached = max(unreached, read.way.unreached(problem.logs, read.numbers))
    return ages, smoothing, unreached


def _shown(attempt: Attempt, without: Collection[str]) -> dict[str, Size]:
    """What the readings show of each cause but for some, where anything does that."""
    logs = attempt.problem.logs
    makers = {CLOCK: wandering, **{cause: each.told_by for cause, each in _OF_JOINTS.items()}}
    motions = {cause: make(logs) for cause, make in makers.items() if cause not in without}
    known = {cause: motion for cause, motion in motions.items() if motion is not None}
    if not known:
        return {}
    found = lacking(attempt.problem, attempt.fitted, list(known.values()))
    sizes = {cause: found.size(group) for group, cause in enumerate(known)}
    n = attempt.problem.tree.n_joints
    return {
        cause: size
        for cause, size in sizes.items()
        if cause not in _OF_JOINTS or _OF_JOINTS[cause].is_possible(size.numbers, n)
    }


def _of_others(attempt: Attempt, cause: str) -> float:
    """Logarithm of the likelihood that the best of what is no such cause would gain.

    Slack from place to place stays where joints rest, and what is late or smoothed is there by
    then; of a clock that wanders slack is no rival: it follows whatever moves.
    """
    few = [size.gain for _, size in attempt.few_sizes.values()]
    slack = attempt.slack_size if cause != CLOCK else None
    return max([*attempt.gains.values(), *few, slack.gain if slack is not None else 0.0])


def _comes_true(other: Attempt, attempt: Attempt, promised: float) -> bool:
    """Whether an attempt with one cause more leaves as much less as one look at residuals promised.

    Beside joints that yield their numbers go where they may without loads' being followed, which
    then are those of no robot, and more is left than before.

    Args:
        other: the attempt with it.
        attempt: the one without.
        promised: logarithm of the likelihood.
    """
    if attempt.misfit > EXPLAINED and not explains_most(other, attempt):
        return False
    before = attempt.fitted
    gained = 0.5 * (before.chi2 - cost_with(before.weights, before.shaken, other.fitted))
    return gained > 0.5 * promised and is_in_balance(other.problem, other.fitted)


def _with(attempt: Attempt, cause: str, size: float) -> Attempt | None:
    """An attempt with one cause more, of the size that the readings show; None where it is none."""
    problem, fitted, causes = attempt.problem, attempt.fitted, (*attempt.causes, cause)
    if cause == CLOCK:
        problem, fitted, wander = with_steady_clocks(problem, fitted)
        return replace(attempt, problem=problem, fitted=fitted, causes=causes, wander=wander)
    found = _OF_JOINTS[cause].followed(problem, fitted, size)
    if found is None:
        return None
    problem, fitted, how = found
    read = {**attempt.read, cause: how}
    return replace(attempt, problem=problem, fitted=fitted, causes=causes, read=read)
