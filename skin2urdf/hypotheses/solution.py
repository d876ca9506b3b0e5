"""What the rounds of a calibration make of logs, and what was mended for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.calibration.result import BAD_FIT, GOOD_FIT
from skin2urdf.calibration.rounds import Clock, Rounds
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import StructureError
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.uncertainty.health import unlike_the_rest
from skin2urdf.hypotheses.changes import changes_within
from skin2urdf.hypotheses.contact import with_contacts_left_out
from skin2urdf.hypotheses.mirrored import mirrored_negated
from skin2urdf.hypotheses.records import Solution
from skin2urdf.hypotheses.slips import slips_parted
from skin2urdf.hypotheses.suspicions import gross_scales, suspicions
from skin2urdf.hypotheses.swaps import names_agreeing
from skin2urdf.recording.records import Recording
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import sampled_together
from skin2urdf.structure.activity import Activity
from skin2urdf.structure.records import KinematicTree


def first_look(
    recordings: Sequence[Recording], settings: CalibrationSettings, clock: Clock
) -> tuple[Rounds, Features, Activity, KinematicTree]:
    """Sample recordings, take features and find the structure that they show.

    Raises:
        InsufficientDataError: the logs lack what a calibration needs.
        StructureError: the SUs' activity contradicts every kinematic tree.
    """
    sampled, su_names = clock.run("sampling", lambda _: sampled_together(recordings))
    rounds = Rounds(sampled, su_names, settings, clock)
    features = rounds.features()
    return rounds, features, *rounds.structure(features)


def solved(
    recordings: Sequence[Recording],
    settings: CalibrationSettings,
    clock: Clock,
    *,
    steady: bool = False,
) -> Solution:
    """Look at recordings, and estimate until it settles.

    Names that are swapped come first, since they spoil the structure, and encoders that change
    their sense, which spoil everything; then SUs that slipped, since they would make a right
    structure look wrong.

    Args:
        recordings: the logs.
        settings: choices.
        clock: runs the stages.
        steady: whether names and senses are known to stay the same within logs.

    Raises:
        InsufficientDataError: the logs lack what a calibration needs.
        StructureError: the SUs' activity contradicts every kinematic tree.
    """
    sampled, su_names = clock.run("sampling", lambda _: sampled_together(recordings))
    rounds = Rounds(sampled, su_names, settings, clock)
    try:
        first = _estimated(rounds)
    except StructureError:
        first = None
        if steady and len(sampled) == 1:
            raise
    if len(sampled) > 1 and (first is None or not _explains(first.found)):
        first = _with_names_agreeing(rounds, first)
    if first is None or not (steady or _explains(first.found)):
        first = _with_names_kept(first.rounds if first else rounds, first)
        if first.turns:
            return first
    # An SU on a wrong joint looks as if it had slipped whenever that joint moved on.
    looked = first.rounds.settled(first.found, first.features)
    if _explains(looked[0]):
        first = replace(first, found=looked[0], features=looked[1])
    # A joint whose encoder is wrong turns the SUs beyond it as if they had slipped.
    if _an_encoder_errs(first):
        return replace(first, found=looked[0], features=looked[1])
    return _with_slips_parted(first, looked)


def slips_after_all(solution: Solution) -> Solution:
    """A solution whose misfit looked like an encoder's, which it was not: slips look like that."""
    if not _an_encoder_errs(solution):
        return solution
    return _with_slips_parted(solution, (solution.found, solution.features))


def _with_slips_parted(first: Solution, looked: tuple[Estimate, Features]) -> Solution:
    """A solution with SUs that slipped taken apart.

    Args:
        first: the solution.
        looked: its estimate, and the features for it, after a second look at the structure.
    """
    seen = first.found
    parting = slips_parted(first.rounds, first.found, first.features)
    if parting.parted and (calm := with_contacts_left_out(first)) is not first:
        # So does something that hits the robot, in that pose.
        first, parting = calm, slips_parted(calm.rounds, calm.found, calm.features)
    if parting.found is not seen:
        looked = parting.rounds.settled(parting.found, parting.features)
    return replace(
        first,
        rounds=parting.rounds,
        found=looked[0],
        features=looked[1],
        faults=(*first.faults, *parting.faults),
    )


def _estimated(rounds: Rounds) -> Solution:
    """The estimate of the structure that the first features show, mirrored SUs negated."""
    features = rounds.features()
    seen, tree = rounds.structure(features)
    first = Solution(rounds, seen, *rounds.relinearised(tree, features))
    if _explains(first.found):
        return first
    negated, mirrored = mirrored_negated(rounds, first.found)
    return _better(first, first.again(negated, mirrored)) if mirrored else first


def _with_names_agreeing(rounds: Rounds, first: Solution | None) -> Solution | None:
    """The estimate with the SUs' names the same in all logs, where that explains them better."""
    renamed, swapped = names_agreeing(rounds)
    if not swapped:
        return first
    try:
        second = _estimated(renamed)
    except StructureError:
        return first
    return _better(first, replace(second, faults=(*second.faults, *swapped)))


def _with_names_kept(rounds: Rounds, first: Solution | None) -> Solution:
    """The estimate with the SUs' names kept within logs, where that explains them better.

    Raises:
        StructureError: there is no estimate even so.
    """
    changes = changes_within(rounds, first.found if first else None)
    if first is None or changes.faults:
        second = _estimated(changes.rounds)
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
