"""SUs that are negated or left-handed, unlike the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from skin2urdf.calibration.rounds import Logs
from skin2urdf.estimation.uncertainty.health import mirrored_sus
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.alone import negated
from skin2urdf.hypotheses.attempts import Search
from skin2urdf.hypotheses.measure import excess, explains
from skin2urdf.hypotheses.records import Amendment, Attempt, Candidate


@dataclass(frozen=True)
class Negated(Amendment):
    """An SU whose readings are negated.

    Attributes:
        su: its name.
    """

    su: str

    @property
    def subject(self) -> str:
        """The SU."""
        return self.su

    def of_logs(self, logs: Logs) -> Logs:
        """The logs with its readings negated."""
        return negated(logs, [self.su])


class Mirrored:
    """The readings themselves tell an SU's handedness where nothing is wrong with the joints."""

    rank: Literal[0, 1, 2] = 0

    def propose(self, search: Search, now: Attempt | None) -> Sequence[Candidate]:  # noqa: ARG002
        """All SUs together that look mirrored: a few of them bend the others."""
        if now is None or explains(now.solution.found):
            return []
        found = now.solution.found
        names = [found.tree.su_names[u] for u in mirrored_sus(found)]
        new = tuple(Negated(name) for name in names if Negated(name) not in now.amendments)
        if not new:
            return []
        return [Candidate("mirrored", tuple(n.su for n in new), new, excess(found))]

    def findings(self, last: Attempt) -> Sequence[Fault]:
        """The SUs that were negated."""
        return [Fault("mirrored", a.su) for a in last.amendments if isinstance(a, Negated)]
