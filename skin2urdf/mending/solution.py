"""What the rounds of a calibration make of logs, and what was mended for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from skin2urdf.calibration import GOOD_FIT, CalibrationSettings
from skin2urdf.errors import StructureError
from skin2urdf.estimation.encoders import suspicions
from skin2urdf.estimation.estimate import Estimate
from skin2urdf.estimation.health import unlike_the_rest
from skin2urdf.faults import Fault
from skin2urdf.mending.slips import Parting, slips_parted
from skin2urdf.mending.swaps import names_agreeing
from skin2urdf.recording.records import Recording
from skin2urdf.rounds import Clock, Rounds
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import sampled_together
from skin2urdf.structure.activity import Activity
from skin2urdf.structure.records import KinematicTree


@dataclass(frozen=True, eq=False)
class Solution:
    """An estimate with all it came from.

    Attributes:
        rounds: the logs on their grids, mended.
        seen: activity in the first features.
        found: the estimate.
        features: the features it rests on.
        faults: what was mended.
    """

    rounds: Rounds
    seen: Activity
    found: Estimate
    features: Features
    faults: tuple[Fault, ...] = ()

    def again(self, rounds: Rounds, faults: Sequence[Fault]) -> Solution:
        """The same structure estimated from mended logs.

        Args:
            rounds: the mended logs.
            faults: what was mended in them.
        """
        found, features = rounds.relinearised(self.found.tree, rounds.features())
        return replace(
            self, rounds=rounds, found=found, features=features, faults=(*self.faults, *faults)
        )


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
    recordings: Sequence[Recording], settings: CalibrationSettings, clock: Clock
) -> Solution:
    """Look at recordings, and estimate until it settles.

    Names that are swapped between logs come first, since they spoil the structure; then SUs that
    slipped, since they would make a right structure look wrong.

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
        if len(sampled) == 1:
            raise
    if first is None or (len(sampled) > 1 and not _explains(first.found)):
        first = _with_names_agreeing(rounds, first)
    # A joint whose encoder jumps turns the SUs beyond it as if they had slipped.
    parting = (
        Parting(first.rounds, first.found, first.features)
        if _an_encoder_jumps(first)
        else slips_parted(first.rounds, first.found, first.features)
    )
    found, features = parting.rounds.settled(parting.found, parting.features)
    return replace(
        first,
        rounds=parting.rounds,
        found=found,
        features=features,
        faults=(*first.faults, *parting.faults),
    )


def _estimated(rounds: Rounds) -> Solution:
    """The estimate of the structure that the first features show."""
    features = rounds.features()
    seen, tree = rounds.structure(features)
    return Solution(rounds, seen, *rounds.relinearised(tree, features))


def _with_names_agreeing(rounds: Rounds, first: Solution | None) -> Solution:
    """The estimate with the SUs' names made to agree, where that explains the readings better."""
    renamed, swapped = names_agreeing(rounds)
    if first is not None and not swapped:
        return first
    second = replace(_estimated(renamed), faults=tuple(swapped))
    if first is None or second.found.cost_per_dof < _BETTER * first.found.cost_per_dof:
        return second
    return first


_BETTER = 0.5
"""Cost with other names, over that with the logs' own, below which the names were swapped."""


_NEARLY_ALL = 0.9
"""Share of the misfit that one offset of an encoder explains where it is the cause."""


def _an_encoder_jumps(first: Solution) -> bool:
    """Whether one number, an encoder's offset, explains nearly all of what an estimate leaves."""
    if _explains(first.found):
        return False
    suspects = suspicions(first.found, first.features)[:1]
    return any(
        s.error.kind == "offset" and s.significant and s.share > _NEARLY_ALL for s in suspects
    )


def _explains(found: Estimate) -> bool:
    """Whether an estimate leaves nothing to explain."""
    return found.cost_per_dof <= GOOD_FIT and not unlike_the_rest(found)
