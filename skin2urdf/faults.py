"""What can be wrong with an SU, an encoder or the recording of them: the record of one fault."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

FaultKind = Literal[
    "dead",
    "frozen",
    "saturated",
    "intermittent",
    "noisy",
    "unattached",
    "loose",
    "bias step",
    "swapped",
    "mirrored",
    "wrong unit",
    "encoder sign",
    "encoder scale",
    "encoder jump",
    "contact",
]
"""Of SUs: no readings at all or zeros; one value repeated; readings cut off at the end of the
range; samples missing again and again; far noisier than the others, or values among
its readings that no motion made; motion of its own while all joints rest; another placement from
some time on, or another bias; two names exchanged between logs; negated or left-handed; a unit that
is no m/s^2.
Of joints: one value repeated while it moves; an encoder that counts the other way; by another
factor; from another zero from some time on; a joint that something touched."""


_TO_REPAIR: tuple[FaultKind, ...] = (
    "dead", "frozen", "unattached", "loose", "swapped", "wrong unit",
    "encoder sign", "encoder scale", "encoder jump",
)  # fmt: skip


Detail = Literal[
    "",
    "no samples",
    "no samples at rest",
    "silent",
    "always",
    "encoder",
    "x axis",
    "y axis",
    "z axis",
    "impulses",
    "between logs",
    "in a log",
    "or its encoder",
]
"""Which way a fault shows, where a kind has several."""


@dataclass(frozen=True)
class Fault:
    """A fault that was found in the logs, in numbers; the report makes words of them.

    Times are those of the log [s]; what does not apply or is not known is NaN.

    Attributes:
        kind: what sort of fault.
        subject: the SU or joint that has it.
        detail: which way it shows.
        log: index of the log it is in, or begins in; None where it is in all of them.
        begin: when it begins, of a slip or a bias the last moment at which the SU certainly was as
            before; of a silent SU its first sample, of an intermittent one the beginning of its
            longest gap; NaN from the beginning on.
        end: when it ends, of a slip or a bias the first moment at which the SU certainly is as
            after; of a silent SU its last sample; NaN where it lasts.
        end_log: index of the log of ``end``.
        size: how large it is.
        unit: of ``size`` and ``deviation``: ``rad``, ``m``, ``g``, ``s``, or ``1`` for a factor or
            a share.
        deviation: standard deviation of ``size``.
        turn: of a slip, how far the SU turned [rad].
        sus: of a contact the SUs that felt it, of an SU that is loose or whose bias stepped its
            name, and the one that its earlier readings have, of a swapped SU the name it has.
    """

    kind: FaultKind
    subject: str
    detail: Detail = ""
    log: int | None = None
    begin: float = math.nan
    end: float = math.nan
    end_log: int | None = None
    size: float = math.nan
    unit: str = "1"
    deviation: float = math.nan
    turn: float = math.nan
    sus: tuple[str, ...] = ()

    @property
    def to_repair(self) -> bool:
        """Whether something has to be set right before the URDF fits the robot as it is."""
        return self.kind in _TO_REPAIR


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
