"""Whether what a search called wrong is physics that real robots have.

Features are of second order in the patterns, and tell less of abrupt ones than samples do. What an
elastic gear, a slow sensor or coarse encoders do to them may look like a hit, an encoder that is
wrong or an SU that came loose. All samples tell the two apart, by how much better they fit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.calibration.clock import Tell
from skin2urdf.calibration.moments import anything_stands_out, stands_out
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.calibration.rounds import Logs, Solution
from skin2urdf.calibration.samples import fit_samples, rejected
from skin2urdf.estimation.problem.state import N_PLACEMENT
from skin2urdf.estimation.trajectory.attempt import (
    BENDS,
    CLOCK,
    LAGS,
    PLAY,
    SMOOTHED,
)
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.slack import CERTAIN
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.hypotheses.measure import price_of

_OF_PLACES = frozenset({"encoder jump", "encoder scale", "loose"})
"""Faults that leave what is felt off by other amounts from place to place."""
_FELT_IN_HITS = frozenset({*BENDS, PLAY, CLOCK, LAGS, SMOOTHED})
"""Causes without which moments of a log are not explained that another fit has left out."""
_STAYS = 0.5
"""Share of the slack that stays where encoders were mended that had nothing."""


def is_explained_by_physics(along: MotionEstimate) -> bool:
    """Whether what real robots have explains all samples, so that nothing need be wrong.

    An elastic gear, an uneven one or a drifting bias makes patterns look as if joints were hit or
    encoders bent; so these are tried before anything is said to be wrong. Slack from place to place
    explains nothing by a cause, nor does a sensor with a scale that none has, as a mirrored one
    seems to; what stands out at some moment is left to the search.

    Args:
        along: the fit of all samples of logs that nothing was mended in.
    """
    if "slack" in along.causes or not are_plausible(along.state).all():
        return False
    return along.misfit <= GOOD_FIT and not anything_stands_out(along)


def leaves_only_noise(along: MotionEstimate) -> bool:
    """Whether no SU shows more than noise, over spans of time or at any moment."""
    quiet = np.nan_to_num(along.misfit_of_sus) <= 1 + along.scatter
    return bool(quiet.all()) and not anything_stands_out(along)


def without_false_hits(
    solution: Solution,
    along: MotionEstimate,
    whole: Logs,
    first: Solution | None,
    tell: Tell,
    plain: MotionEstimate | None = None,
) -> tuple[Solution, MotionEstimate]:
    """Hits that all samples explain, those that were left out included, are none.

    What a slow sensor or an elastic gear does to a pattern looks like a hit, or like an SU that
    came loose, as long as the model lacks it, and is explained once the fit has it.

    Args:
        solution: the estimate, with hits among its faults.
        along: the fit of its logs, without the moments of the hits.
        whole: the logs with them.
        first: the estimate before anything was taken to be wrong; None where there is none.
        tell: told the share of the work that is done.
        plain: the fit of all samples of that estimate, where there is one.
    """
    kinds = {fault.kind for fault in solution.faults}
    if not kinds or not kinds <= {"contact", "loose"}:
        return solution, along
    loose = "loose" in kinds
    # An SU that came loose is two in the tree of what was mended.
    everything = first if loose else replace(solution, logs=whole)
    if everything is None:
        return solution, along
    # An SU that did leaves so much that every cause would be tried in vain. So would they be where
    # the logs without the hits leave only noise to a stiff robot on steady clocks: what yields or
    # wanders shows there as well.
    stiff = not set(along.causes) & _FELT_IN_HITS and (loose or leaves_only_noise(along))
    again = None if stiff or first is None or not _is_of(first, everything) else plain
    if again is None:
        most = 0.0 if stiff else np.inf
        again = fit_samples(everything, tell, without=rejected(along), most=most)
    if again is None:
        return solution, along
    if loose and not leaves_only_noise(again) and not differs_by_physics(solution, along, again):
        return solution, along
    real = tuple(
        f for f in solution.faults
        if f.kind == "contact"
        and stands_out(again, whole.sampled, f.log or 0, f.begin, f.end, pushed=f.subject)
    )  # fmt: skip
    if real:
        return (solution if loose else replace(solution, faults=real)), along
    return replace(everything, faults=()), again


def _is_of(first: Solution, other: Solution) -> bool:
    """Whether two estimates are of the same logs and tree, so that all samples say the same."""
    same_logs = first.logs.sampled is other.logs.sampled
    return same_logs and first.found.tree.is_like(other.found.tree)


def names_what_differs_by_place(solution: Solution) -> bool:
    """Whether some encoder's zero or scale, or an SU's place from some time on, is called wrong."""
    return any(fault.kind in _OF_PLACES for fault in solution.faults)


def differs_by_physics(
    solution: Solution, along: MotionEstimate, plain: MotionEstimate | None
) -> bool:
    """Whether what was found of encoders and loose SUs is rounding, the play of gears or a drift.

    An encoder that is wrong is off from place to place, and so are links that have play. What was
    wrong is gone once it is mended, and less is left; play stays. What encoders round off bends
    features by more than they tell: all samples are as likely without what it looks like. So do
    gears that yield: what was taken off for them alone comes back as slack. A bias that drifts
    looks like an SU that was turned, to features alone; play that stays says nothing of whether one
    was.

    Args:
        solution: the estimate, with its faults.
        along: the fit of its logs.
        plain: the fit of the logs in which nothing was mended; None where there is none.
    """
    kinds = {fault.kind for fault in solution.faults}
    if plain is None or not kinds & _OF_PLACES or not kinds <= {"contact", *_OF_PLACES}:
        return False
    if not (plain.misfit <= max(GOOD_FIT, along.misfit) and are_plausible(plain.state).all()):
        return False
    if "loose" not in kinds and 0 < plain.slack * _STAYS < along.slack:
        return True
    # Slack and other causes would explain what is wrong as well.
    as_stiff = plain.slack <= along.slack and set(plain.causes) <= set(along.causes)
    needs_more = set(plain.causes) < set(along.causes)
    return as_stiff and (needs_more or gained(plain, along) <= _worth(solution, along))


def _worth(solution: Solution, along: MotionEstimate) -> float:
    """Logarithm of the likelihood that what was found of encoders and loose SUs has to gain."""
    return worth_of(
        sum(
            N_PLACEMENT if fault.kind == "loose" else 1
            for fault in solution.faults
            if fault.kind in _OF_PLACES
        ),
        along,
    )


def worth_of(parameters: int, along: MotionEstimate) -> float:
    """Logarithm of the likelihood that so many parameters have to gain of all samples.

    Args:
        parameters: number of them.
        along: the fit of all samples, which tells how many measurements there are.
    """
    measured = sum(
        3 * log.independence * float(p.measured.sum())
        for log, p in zip(along.problem.logs, along.fitted.predicted, strict=True)
    )
    # A likelihood's logarithm is half of chi-squared.
    return max(CERTAIN, 0.5 * price_of(parameters, measured))


def gained(plain: MotionEstimate, along: MotionEstimate) -> float:
    """Logarithm of the likelihood that another fit gains, of the readings that both compare.

    Where mended logs leave readings out, as those while an encoder jumps, what is in one fit alone
    tells nothing of the other. An SU that came loose counts from then on.

    Args:
        plain: a fit.
        along: the other one, in whose noise the gain is.
    """
    names = plain.problem.tree.su_names, along.problem.tree.su_names
    _, here, there = np.intersect1d(*names, return_indices=True)
    mended = {log.log: h for h, log in enumerate(along.problem.logs)}
    gain = 0.0
    for g, log in enumerate(plain.problem.logs):
        if log.log not in mended:
            continue
        h = mended[log.log]
        other = along.problem.logs[h]
        _, i, j = np.intersect1d(log.time.round(6), other.time.round(6), return_indices=True)
        before, after = plain.fitted.predicted[g], along.fitted.predicted[h]
        both = before.measured[np.ix_(i, here)] & after.measured[np.ix_(j, there)]
        squares = before.residual[np.ix_(i, here)] ** 2 - after.residual[np.ix_(j, there)] ** 2
        weights = along.fitted.weights[h][np.ix_(j, there)][..., :3]
        gain += 0.5 * float((weights * squares)[both].sum())
    return gain
