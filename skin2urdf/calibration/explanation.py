"""What explains the readings: physics that real robots have, or something that is wrong.

A first estimate whose features leave more than noise is looked at with all samples. Where elastic
gears, slow sensors and their like explain these, nothing is wrong. Otherwise a search finds what
is, and all samples have the last word about that as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from skin2urdf.calibration.at_rest import estimate_at_rest
from skin2urdf.calibration.beginning import Beginning
from skin2urdf.calibration.by_loads import by_loads_or_felt
from skin2urdf.calibration.by_physics import (
    differs_by_physics,
    is_explained_by_physics,
    leaves_only_noise,
    names_what_differs_by_place,
    without_false_hits,
)
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.handedness import with_handedness
from skin2urdf.calibration.moments import stands_out
from skin2urdf.calibration.orders import in_told_order
from skin2urdf.calibration.places import in_told_place, is_told, with_one_on_the_base
from skin2urdf.calibration.refusal import check_hope
from skin2urdf.calibration.result import (
    BAD_FIT,
    BAD_MISFIT,
    GOOD_FIT,
    HOPELESS_FIT,
    unexplained_sus,
)
from skin2urdf.calibration.rounds import Solution
from skin2urdf.calibration.samples import fit_samples, rejected
from skin2urdf.calibration.taken_apart import retold, with_sus_apart, with_sus_together
from skin2urdf.errors import BadFitError, Skin2UrdfError, StructureError
from skin2urdf.estimation.trajectory.attempt import BASE, BENDS, DRIFT, TILTS, WARMING
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.hypotheses.attempts import StandsOut
from skin2urdf.hypotheses.encoder import named_leaps
from skin2urdf.hypotheses.kinds import KINDS
from skin2urdf.hypotheses.search import explain
from skin2urdf.signals.sampling import Sampled


def explain_readings(begun: Beginning, clock: Clock) -> tuple[Solution, MotionEstimate | None]:
    """The robot, with all that was found wrong, and what all samples say of it.

    Args:
        begun: logs, structure and first estimate.
        clock: runs the stages.

    Returns:
        The estimate of features, and that of all samples; None where features alone count.

    Raises:
        BadFitError: no model explains the features.
        StructureError: the SUs' activity contradicts every kinematic tree.
    """
    solution, along = _explained(begun, clock)
    if along is None:
        return solution, along
    # What a first look at the structure says of a single SU, or of joints without any, is little.
    for place in (with_one_on_the_base, partial(in_told_place, of_patterns=begun.of_patterns)):
        placed = place(solution, along, clock)
        if (fitted := _of_another_tree(solution, along, placed, clock)) and is_told(along, fitted):
            solution, along = with_sus_apart(placed, fitted, clock, of_patterns=begun.of_patterns)
    if not begun.of_patterns:
        solution, along = with_handedness(solution, along, clock)
    along = by_loads_or_felt(solution, along, clock)
    ordered = in_told_order(solution, along, clock)
    if fitted := _of_another_tree(solution, along, ordered, clock):
        return with_sus_apart(ordered, fitted, clock, of_patterns=begun.of_patterns)
    # The same tree, with notes on what the log does not tell of it.
    return (ordered if ordered.found.tree.is_like(solution.found.tree) else solution), along


def _of_another_tree(
    solution: Solution, along: MotionEstimate, other: Solution, clock: Clock
) -> MotionEstimate | None:
    """The fit of all samples with another tree; None of the same one, or where it leaves more."""
    if other.found.tree.is_like(solution.found.tree):
        return None
    fitted = clock.run("all samples", partial(fit_samples, other))
    return fitted if fitted and fitted.misfit <= max(along.misfit, GOOD_FIT) else None


def _explained(begun: Beginning, clock: Clock) -> tuple[Solution, MotionEstimate | None]:
    """The same with joints in the order, and SUs in the places, that were found first."""
    first = begun.first
    unexplained = first is not None and first.found.cost_per_dof > GOOD_FIT
    looked = None
    if begun.of_patterns and first is not None and unexplained:
        first, looked = _look(first, clock)
        begun = replace(begun, first=first)
    trusted = not begun.of_patterns or (looked is not None and is_explained_by_physics(looked))
    if first is not None and trusted:
        first = _naming_leaps(begun, first)
        begun = replace(begun, first=first)
        return _fit_along(begun, first, looked, looked, frozenset(), clock)
    search = partial(
        explain,
        begun.recordings,
        begun.leaps,
        (begun.logs, begun.structure, first),
        KINDS,
        clock,
        stands_out=_what_stands_out(looked, begun.logs.sampled),
    )
    try:
        solution = clock.run("what is wrong", search)
    except StructureError:
        of_moves = _of_moves(begun, 0, clock)
        if of_moves is None:
            raise
        return of_moves
    try:
        check_hope(solution.found)
    except BadFitError:
        # Around a pose features take the base to stand, wherever it stood around the last one.
        of_moves = _of_moves(begun, solution.found.tree.n_sus, clock) if begun.of_patterns else None
        if of_moves is None:
            raise
        return of_moves
    known = looked if first is not None and _untouched(first, solution) else None
    if not unexplained and names_what_differs_by_place(solution) and not begun.leaps:
        # Features that leave hardly more than noise did not ask for a look: coarse encoders do.
        # Leaps are off these logs already, and certain.
        looked = None if first is None else _look(first, clock)[1]
    return _fit_along(begun, solution, known, looked, rejected(looked), clock)


def _naming_leaps(begun: Beginning, solution: Solution) -> Solution:
    """A solution of logs without leaps, with the encoders that leapt among its faults."""
    errors = [leap.error for leap in begun.leaps]
    return replace(solution, faults=(*solution.faults, *named_leaps(errors, solution)))


def _look(first: Solution, clock: Clock) -> tuple[Solution, MotionEstimate | None]:
    """What all samples say of a first estimate; None where it explains too little."""
    if first.logs.settings.motion != "all" or first.found.misfit > BAD_FIT:
        return first, None
    # What is bent by more is first to be mended.
    first, along = _fit_placed(first, clock, most=BAD_MISFIT)
    return first, along if along is not None and along.misfit <= BAD_MISFIT else None


def _fit_placed(
    solution: Solution,
    clock: Clock,
    *,
    most: float = np.inf,
    without: frozenset[str] = frozenset(),
    unless_one_changed: bool = False,
) -> tuple[Solution, MotionEstimate | None]:
    """What all samples say, with an SU on the base where that is what a vertical joint lacks.

    Arguments are those of :func:`fit_samples`.

    Returns:
        The robot with the SU where it is, and the fit.
    """
    fitting = partial(
        fit_samples, solution, most=most, without=without, unless_one_changed=unless_one_changed
    )
    along = clock.run("all samples", partial(fitting, unless_on_the_base=True))
    if along is None or not along.left_to_place:
        return solution, along
    placed = with_one_on_the_base(solution, along, clock)
    if not placed.found.tree.is_like(solution.found.tree):
        # What else robots have takes long to be tried, and does not tell where an SU sits.
        others = frozenset({*BENDS, DRIFT, WARMING, TILTS} - {BASE}) | without
        there = clock.run("all samples", partial(fit_samples, placed, without=others))
        if there is not None and leaves_only_noise(there):
            if "slack" not in there.causes:
                return placed, there
            return placed, clock.run("all samples", partial(fit_samples, placed, without=without))
    return solution, clock.run("all samples", fitting)


def _what_stands_out(along: MotionEstimate | None, sampled: Sequence[Sampled]) -> StandsOut:
    """What tells hits from the play of gears; where samples are not explained, all are hits."""
    if along is None or not along.misfit <= GOOD_FIT:
        return lambda *_: True
    return partial(stands_out, along, sampled)


def _untouched(first: Solution, solution: Solution) -> bool:
    """Whether a search has left the logs and the structure as they were."""
    same_logs = solution.logs.sampled is first.logs.sampled
    return same_logs and solution.found.tree is first.found.tree and not solution.faults


def _fit_along(
    begun: Beginning,
    solution: Solution,
    known: MotionEstimate | None,
    plain: MotionEstimate | None,
    in_vain: frozenset[str],
    clock: Clock,
) -> tuple[Solution, MotionEstimate | None]:
    """What all samples say of a solution, and what they leave of its faults.

    Args:
        begun: logs, structure and first estimate.
        solution: what features say.
        known: the fit of all samples, where there is one already.
        plain: that of the logs in which nothing was mended, where there is one.
        in_vain: causes that need not be tried.
        clock: runs the stages.
    """
    if begun.logs.settings.motion != "all":
        return solution, None
    # No physics leaves so much in the features of any SU, be it weighed down or not.
    most = np.inf if solution.found.misfit <= HOPELESS_FIT else 0.0
    along = known
    if along is None:
        # On an SU that slipped, or whose bias stepped, physics would be tried in vain.
        solution, along = _fit_placed(
            solution, clock, most=most, without=in_vain, unless_one_changed=not solution.faults
        )
    if along is not None and along.left_to_one:
        apart = with_sus_apart(solution, along, clock, of_patterns=begun.of_patterns)
        if apart[1] is not along and not apart[1].causes and leaves_only_noise(apart[1]):
            return apart
        again = partial(fit_samples, solution, without=in_vain, most=most)
        along = clock.run("all samples", again)
    if along is None:
        return solution, None
    first = begun.first
    if first is not None and plain is not None and differs_by_physics(solution, along, plain):
        solution, along = first, plain
    fitted = along
    solution, along = clock.run(
        "all samples",
        lambda tell: without_false_hits(solution, fitted, begun.logs, first, tell, plain),
    )
    solution, along = with_sus_together(solution, along, clock)
    solution, along = with_sus_apart(
        retold(solution, along), along, clock, of_patterns=begun.of_patterns
    )
    if begun.of_patterns and _leaves_more(solution, along):
        return _of_moves(begun, solution.found.tree.n_sus, clock) or (solution, along)
    return solution, along


def _of_moves(begun: Beginning, n_sus: int, clock: Clock) -> tuple[Solution, MotionEstimate] | None:
    """What rests and moves say, where that explains all samples of as many SUs.

    Moves of single joints look like patterns, and may be too slow to show which SUs feel a joint:
    where what patterns say leaves the readings unexplained, they may have been none.
    """
    try:
        solution = _naming_leaps(begun, estimate_at_rest(begun.logs, begun.structure, clock))
    except Skin2UrdfError:
        return None
    if solution.found.tree.n_sus < n_sus:
        return None
    # What explains all rests is no wrong tree, whatever a base does between them.
    most = np.inf if solution.found.cost_per_dof <= GOOD_FIT else BAD_MISFIT
    along = clock.run("all samples", lambda tell: fit_samples(solution, tell, most=most))
    if along is None:
        return None
    found = with_sus_apart(solution, along, clock, of_patterns=False)
    return None if _leaves_more(*found) else found


def _leaves_more(solution: Solution, along: MotionEstimate) -> bool:
    """Whether the tree does not explain all samples, or not what an SU without a fault feels."""
    unexplained = along.misfit > GOOD_FIT or along.slack_is_none
    return unexplained or bool(unexplained_sus(along, solution.faults))
