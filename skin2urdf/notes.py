"""What a calibration notes beside faults: the record of one note, in machine words and numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

NoteKind = Literal[
    "su left out",
    "joint left out",
    "never together",
    "undecided",
    "bare base",
    "other order",
    "sense unknown",
    "order from motion",
    "second look",
    "placed by fit",
    "positions lacking",
    "misfit",
    "poses misfit",
    "vertical axis",
    "implausible shape",
    "implausible bias",
    "unit g",
    "unit deg/s",
]
"""Of the structure: an SU and a joint that are in no tree; SUs that no log holds while joints move;
a bit of the activity that the rest decided; no SU on the base; another order of joints, or other
senses of axes, that the log does not tell from those taken; joints whose order follows from the
motion; a tree that a second look gave; an SU that sits where its readings fit; logs that lack
positions of joints before SUs.
Of the fit: an SU and poses that fit worse than the rest; SUs that may sit on a vertical axis;
errors that no working sensor has.
Of the streams: readings in g, rates in deg/s, both converted."""

Detail = Literal[
    "",
    "no readings",
    "no chain",
    "never moved",
    "not alone",
    "turns no gravity",
    "felt by none",
    "felt by none recorded",
    "not shown",
    "active",
    "inactive",
    "weak",
]
"""Which way a note holds, where a kind has several."""


@dataclass(frozen=True)
class Note:
    """What was found, mended or left out, in numbers; the report makes words of them.

    Attributes:
        kind: what sort of note.
        sus: the SUs it is about.
        joints: the joints it is about, in the order that was taken.
        detail: which way it holds.
        instead: of an order of joints, the other one.
        size: how large it is: how many times worse, an error [1 or m/s^2], a span [rad or m]; NaN
            where nothing is measured.
        numbers: of poses in the order of the logs, or of logs, from 0.
        of: how many there are of what is numbered.
    """

    kind: NoteKind
    sus: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    detail: Detail = ""
    instead: tuple[str, ...] = ()
    size: float = math.nan
    numbers: tuple[int, ...] = ()
    of: int = 0


def of_kind(notes: Iterable[Note | str], kind: NoteKind) -> list[Note]:
    """Notes of one kind; what a reader of logs says in words is of none."""
    return [note for note in notes if isinstance(note, Note) and note.kind == kind]
