"""What kinds of hypotheses and the search tell each other.

A kind looks at an attempt to explain the logs and proposes candidates; a candidate amends the logs
or the model; the search attempts the logs again with it. Findings of the amendments that last are
:class:`skin2urdf.faults.Fault`, in numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

from skin2urdf.calibration.rounds import Logs, Solution
from skin2urdf.recording.records import Recording
from skin2urdf.structure.records import KinematicTree


class Amendment:
    """One thing that is allowed for in the logs or in the model.

    Amendments are frozen records that change what they are given and keep what they do not concern.
    """

    @property
    def key(self) -> Hashable:
        """What it is about: a later amendment with the same key takes the place of this one."""
        return self

    @property
    def subject(self) -> str:
        """The one joint or SU that it is about; empty where there are several, or none."""
        return ""

    @property
    def parameters(self) -> int:
        """Number of parameters that it adds."""
        return 1

    @property
    def apart(self) -> float:
        """Chi-squared that it takes off samples which no feature counts."""
        return 0.0

    def of_recordings(self, recordings: list[Recording]) -> list[Recording]:
        """The recordings without what was wrong."""
        return recordings

    def of_logs(self, logs: Logs) -> Logs:
        """The sampled logs without what was wrong."""
        return logs

    def of_structure(self, tree: KinematicTree | None) -> KinematicTree | None:
        """The structure, given what the features show; None where they contradict each."""
        return tree

    def of_placements(self, logs: Logs, tree: KinematicTree) -> tuple[Logs, KinematicTree]:
        """Logs and tree in which an SU has several placements."""
        return logs, tree

    def left_out(self, logs: Logs) -> Logs:
        """The logs without the moments that say nothing of the robot."""
        return logs


@dataclass(frozen=True, eq=False)
class Attempt:
    """The logs explained with some amendments.

    Attributes:
        amendments: in the order in which they are applied.
        solution: the estimate with all it came from.
        whole: the logs with all amendments but what was left out.
    """

    amendments: tuple[Amendment, ...]
    solution: Solution
    whole: Logs


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hypothesis that may be worth its price.

    Attributes:
        kind: of which kind of hypotheses it is.
        subject: the SU or joint it is about, or several.
        amendments: what it amends.
        drop: of chi-squared, nothing weighed down, that a score test expects.
        among: number of hypotheses that the score test has compared it with, itself included.
        holds: what else the attempt must show for the hypothesis; None where nothing.
        instead: amendments of the attempt that it takes the place of, since they may imitate it.
        sharpen: makes better amendments from the features of an attempt, at the cost of some
            estimates; none where it sees nothing of them. None where there is nothing to sharpen.
    """

    kind: str
    subject: tuple[str, ...]
    amendments: tuple[Amendment, ...]
    drop: float
    among: int = 1
    holds: Callable[[Attempt], bool] | None = None
    instead: tuple[Amendment, ...] = ()
    sharpen: Callable[[Attempt], Sequence[Amendment]] | None = None

    @property
    def apart(self) -> float:
        """Drop of chi-squared in samples that no feature counts, which no estimate has to show."""
        return sum(a.apart for a in self.amendments)

    @property
    def key(self) -> Hashable:
        """What it is about."""
        return self.kind, tuple(a.key for a in self.amendments)
