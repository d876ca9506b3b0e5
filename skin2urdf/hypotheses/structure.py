"""Another structure than the one that the first features show.

Features taken again with what an estimate predicts may show the structure more clearly, and gaps
may leave so little of an SU that the activity of its last joint is missed.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Literal

from skin2urdf.calibration.rounds import settle
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.attempts import Search
from skin2urdf.hypotheses.measure import explains
from skin2urdf.hypotheses.records import Amendment, Attempt, Candidate
from skin2urdf.structure.records import KinematicTree


@dataclass(frozen=True, eq=False)
class Known(Amendment):
    """A structure that is taken for known.

    Attributes:
        tree: the structure.
    """

    tree: KinematicTree

    @property
    def key(self) -> Hashable:
        """There is one structure."""
        return "structure"

    @property
    def parameters(self) -> int:
        """It has none; that it was chosen is paid for as with every candidate."""
        return 0

    def of_structure(self, tree: KinematicTree | None) -> KinematicTree | None:  # noqa: ARG002
        """The structure that is known."""
        return self.tree


class Structures:
    """Structures that the activity of the SUs leaves possible."""

    rank: Literal[0, 1, 2] = 2

    def propose(self, search: Search, now: Attempt | None) -> Sequence[Candidate]:
        """The structure that a second look shows, where what is known does not fit."""
        if now is None or explains(now.solution.found):
            return []
        before = now.solution.found
        found, _ = settle(now.solution.logs, before, now.solution.features, search.clock)
        if found.tree.is_like(before.tree):
            return []
        drop = (before.misfit - found.misfit) * int(before.count.sum())
        moved = [n for n in found.tree.su_names if _joint(found.tree, n) != _joint(before.tree, n)]
        return [Candidate("structure", tuple(moved), (Known(found.tree),), drop)]

    def findings(self, last: Attempt) -> Sequence[Fault]:  # noqa: ARG002
        """None: a structure is no fault; the tree's notes tell what to record."""
        return []


def _joint(tree: KinematicTree, su: str) -> str | None:
    """Name of the joint an SU sits on; None for the reference segment, or for no such SU."""
    if su not in tree.su_names:
        return None
    joint = int(tree.su_joint[tree.su_names.index(su)])
    return tree.joint_names[joint] if joint >= 0 else None
