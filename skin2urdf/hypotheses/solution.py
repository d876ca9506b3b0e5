"""What the rounds of a calibration make of logs, and what was mended for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import BAD_FIT, GOOD_FIT
from skin2urdf.calibration.rounds import (
    Logs,
    Solution,
    Structure,
    estimate_again,
    estimate_robot,
    find_structure,
    relinearise,
    sample_logs,
    settle,
    take_features,
)
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import StructureError
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.uncertainty.health import unlike_the_rest
from skin2urdf.hypotheses.changes import changes_within
from skin2urdf.hypotheses.contact import with_contacts_left_out
from skin2urdf.hypotheses.mirrored import mirrored_negated
from skin2urdf.hypotheses.slips import slips_parted
from skin2urdf.hypotheses.suspicions import gross_scales, suspicions
from skin2urdf.hypotheses.swaps import names_agreeing
from skin2urdf.recording.records import Recording
from skin2urdf.signals.records import Features


def solved(
    recordings: Sequence[Recording],
    settings: CalibrationSettings,
    clock: Clock,
    *,
    steady: bool = False,
) -> Solution:
    """Look at recordings, estimate until it settles, and mend what shows in the estimate.

    Args:
        recordings: the logs.
        settings: choices.
        clock: runs the stages.
        steady: whether names and senses are known to stay the same within logs.

    Raises:
        InsufficientDataError: the logs lack what a calibration needs.
        StructureError: the SUs' activity contradicts every kinematic tree.
    """
    logs = sample_logs(recordings, settings, clock)
    features = take_features(logs, clock)
    structure = find_structure(logs, features, clock)
    first = estimate_robot(logs, features, structure, clock)
    return mended(logs, structure, first, clock, steady=steady)


def mended(
    logs: Logs,
    structure: Structure,
    first: Solution | None,
    clock: Clock,
    *,
    steady: bool = False,
) -> Solution:
    """An estimate with what shows in it mended.

    Names that are swapped come first, since they spoil the structure, and encoders that change
    their sense, which spoil everything; then SUs that slipped, since they would make a right
    structure look wrong.

    Args:
        logs: the logs.
        structure: what their features show.
        first: the estimate of that structure, where there is one.
        clock: runs the stages.
        steady: whether names and senses are known to stay the same within logs.

    Raises:
        InsufficientDataError: the logs lack what a calibration needs.
        StructureError: the SUs' activity contradicts every kinematic tree.
    """
    several = len(logs.sampled) > 1
    if structure.contradiction is not None and steady and not several:
        raise structure.contradiction
    if first is not None:
        first = _with_mirrored_negated(first, clock)
    if several and (first is None or not _explains(first.found)):
        first = _with_names_agreeing(logs, first, clock)
    if first is None or not (steady or _explains(first.found)):
        first = _with_names_kept(first.logs if first else logs, first, clock)
        if first.turns:
            return first
    # An SU on a wrong joint looks as if it had slipped whenever that joint moved on.
    looked = settle(first.logs, first.found, first.features, clock)
    if _explains(looked[0]):
        first = replace(first, found=looked[0], features=looked[1])
    # A joint whose encoder is wrong turns the SUs beyond it as if they had slipped.
    if _an_encoder_errs(first):
        return replace(first, found=looked[0], features=looked[1])
    return _with_slips_parted(first, looked, clock)


def slips_after_all(solution: Solution, clock: Clock) -> Solution:
    """A solution whose misfit looked like an encoder's, which it was not: slips look like that."""
    if not _an_encoder_errs(solution):
        return solution
    return _with_slips_parted(solution, (solution.found, solution.features), clock)


def _with_slips_parted(
    first: Solution, looked: tuple[Estimate, Features], clock: Clock
) -> Solution:
    """A solution with SUs that slipped taken apart.

    Args:
        first: the solution.
        looked: its estimate, and the features for it, after a second look at the structure.
        clock: runs the stages.
    """
    seen = first.found
    parting = slips_parted(first.logs, first.found, first.features, clock)
    if parting.parted and (calm := with_contacts_left_out(first, clock)) is not first:
        # So does something that hits the robot, in that pose.
        first, parting = calm, slips_parted(calm.logs, calm.found, calm.features, clock)
    if parting.found is not seen:
        looked = settle(parting.logs, parting.found, parting.features, clock)
    return replace(
        first,
        logs=parting.logs,
        found=looked[0],
        features=looked[1],
        faults=(*first.faults, *parting.faults),
    )


def _estimated(logs: Logs, clock: Clock) -> Solution:
    """The estimate of the structure that the first features show, mirrored SUs negated.

    Raises:
        StructureError: the SUs' activity contradicts every kinematic tree.
    """
    features = take_features(logs, clock)
    structure = find_structure(logs, features, clock)
    found, refined = relinearise(logs, structure.certain_tree, features, clock)
    first = Solution(logs, structure.seen, found, refined)
    return _with_mirrored_negated(first, clock)


def _with_mirrored_negated(first: Solution, clock: Clock) -> Solution:
    """The estimate with mirrored SUs negated, where that explains the readings better."""
    if _explains(first.found):
        return first
    negated, mirrored = mirrored_negated(first.logs, first.found)
    return _better(first, estimate_again(first, negated, mirrored, clock)) if mirrored else first


def _with_names_agreeing(logs: Logs, first: Solution | None, clock: Clock) -> Solution | None:
    """The estimate with the SUs' names the same in all logs, where that explains them better."""
    renamed, swapped = names_agreeing(logs, clock)
    if not swapped:
        return first
    try:
        second = _estimated(renamed, clock)
    except StructureError:
        return first
    return _better(first, replace(second, faults=(*second.faults, *swapped)))


def _with_names_kept(logs: Logs, first: Solution | None, clock: Clock) -> Solution:
    """The estimate with the SUs' names kept within logs, where that explains them better.

    Raises:
        StructureError: there is no estimate even so.
    """
    changes = changes_within(logs, first.found if first else None, clock)
    if first is None or changes.faults:
        second = _estimated(changes.logs, clock)
        earlier = first.faults if first else ()
        faults = (*earlier, *second.faults, *changes.faults)
        first = _better(first, replace(second, faults=faults))
    return replace(first, turns=changes.turns)


def _better(first: Solution | None, second: Solution) -> Solution:
    """The second solution, if it is clearly better than the first one, or the only one."""
    if first is None or second.found.misfit < _BETTER * first.found.misfit:
        return second
    return first


_BETTER = 0.5
"""Misfit of mended logs, over that of the logs as they are, below which they were at fault."""


_CAUSE = {"offset": 0.9, "scale": 0.5}
"""Share of the misfit that one error of an encoder explains where it is the cause. An SU that slips
about the axis of its joint looks like an offset; nothing that an SU does looks like a scale."""


def _an_encoder_errs(first: Solution) -> bool:
    """Whether one number, an encoder's offset or scale, explains what an estimate leaves."""
    if _explains(first.found):
        return False
    suspects = suspicions(first.found, first.features)[:1]
    return bool(gross_scales(first.found)) or any(
        s.significant and s.share > _CAUSE.get(s.error.kind, np.inf) for s in suspects
    )


def _explains(found: Estimate) -> bool:
    """Whether an estimate leaves nothing to explain, nor weighs down what it does not explain."""
    fits = found.cost_per_dof <= GOOD_FIT and found.misfit <= BAD_FIT
    return fits and not unlike_the_rest(found)
