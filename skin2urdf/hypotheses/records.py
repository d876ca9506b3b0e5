"""What is known after a round of mending."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from skin2urdf.calibration.rounds import Rounds
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.faults import Fault
from skin2urdf.signals.records import Features
from skin2urdf.structure.activity import Activity


@dataclass(frozen=True)
class Turn:
    """An encoder that counts the other way from a moment in a log on.

    Attributes:
        dof: the joint.
        log: index of the log.
        between: times between which it is [s].
    """

    dof: str
    log: int
    between: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Solution:
    """An estimate with all it came from.

    Attributes:
        rounds: the logs on their grids, mended.
        seen: activity in the first features.
        found: the estimate.
        features: the features it rests on.
        faults: what was mended.
        turns: encoders that change their sense within a log; where there are any, the estimate is
            of no use before they are mended.
    """

    rounds: Rounds
    seen: Activity
    found: Estimate
    features: Features
    faults: tuple[Fault, ...] = ()
    turns: tuple[Turn, ...] = ()

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
