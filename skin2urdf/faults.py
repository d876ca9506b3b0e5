"""What can be wrong with an SU, an encoder or the recording of them: the record of one fault."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

FaultKind = Literal[
    "dead",
    "frozen",
    "saturated",
    "intermittent",
    "noisy",
    "loose",
    "swapped",
    "mirrored",
    "wrong unit",
    "encoder sign",
    "encoder scale",
    "encoder jump",
    "contact",
]
"""Of SUs: no readings at all or zeros; one value repeated; readings cut off at the end of the
range; samples missing again and again; far noisier than the others; another placement from some
time on; two names exchanged between logs; negated or left-handed; a unit that is no m/s^2.
Of joints: an encoder that counts the other way; by another factor; from another zero from some
time on; a joint that something touched."""


_TO_REPAIR: tuple[FaultKind, ...] = (
    "dead", "frozen", "loose", "swapped", "wrong unit",
    "encoder sign", "encoder scale", "encoder jump",
)  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """A fault that was found in the logs.

    Attributes:
        kind: what sort of fault.
        subject: the SU or joint that has it.
        words: a sentence: what, where, and what was done about it.
        remedy: what to check or to record.
        sus: of a contact the SUs that felt it, of a loose SU its names before and after.
    """

    kind: FaultKind
    subject: str
    words: str
    remedy: str = ""
    sus: tuple[str, ...] = ()

    @property
    def to_repair(self) -> bool:
        """Whether something has to be set right before the URDF fits the robot as it is."""
        return self.kind in _TO_REPAIR

    def __str__(self) -> str:
        """All of it in one line."""
        return f"{self.words}: {self.remedy}" if self.remedy else self.words


def distinct(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Faults in their order, each kind of each subject once."""
    seen: dict[tuple[str, str], Fault] = {}
    for fault in faults:
        seen.setdefault((fault.kind, fault.subject), fault)
    return tuple(seen.values())


def without_slips(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Faults without contacts that only SUs which slipped have felt: those were the slips."""
    faults = tuple(faults)
    slipped = {su for fault in faults if fault.kind == "loose" for su in fault.sus}
    return tuple(f for f in faults if f.kind != "contact" or not slipped.issuperset(f.sus))
