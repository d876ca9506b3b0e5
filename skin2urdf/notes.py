"""What a calibration notes beside faults: the record of one note, in machine words and numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

NoteKind = Literal[
    "su left out",
    "joint left out",
    "moves otherwise",
    "never together",
    "undecided",
    "bare base",
    "other order",
    "moved alike",
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
    "odd unit",
    "base moves",
    "felt at rest",
]
"""Of the structure: an SU and a joint that are in no tree; SUs that such a joint moves all the
same; SUs that no log holds while joints move; a bit of the activity that the rest decided; no SU on
the base; another order of joints, or other senses of axes, that the log does not tell from those
taken; joints that always moved alike; joints whose order follows from the motion; a tree that a
second look gave; an SU that sits where its readings fit; logs that lack positions of joints before
SUs.
Of the fit: an SU and poses that fit worse than the rest; SUs that may sit on a vertical axis;
errors that no working sensor has.
Of the streams: readings in g, rates in deg/s, both converted; a joint that goes farther and faster
than any does in rad or m; what turns all SUs at rest, or changes what they feel there."""

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
        size: how large it is: how many times worse, an error [1 or m/s^2], a span [rad or m], an
            angle [rad], by how much SUs may be elsewhere [m]; NaN where nothing is measured.
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


ReadingKind = Literal[
    "cut short",
    "damaged",
    "encrypted",
    "too large",
    "contradicted index",
    "undefined channel",
    "part left out",
    "part missing",
    "no list of parts",
    "passed over",
    "several topics",
    "joints of one name",
    "several publishers",
    "absurd values",
    "spikes",
    "too few",
    "held values",
    "sent on change",
    "copied readings",
    "renamed",
    "no stamps",
    "contradicting stamps",
    "noisy stamps",
    "late messages",
    "other clock",
    "clock jump",
    "own clock jump",
    "clock step",
    "bad cells",
    "bad rows",
    "unused columns",
    "not converted",
]
"""What a reader of logs meets: files that end early, are damaged, encrypted or too large, and what
in them can not be used; streams that are left out in whole or in part, named anew or joined; times
that are not simply the stamps; cells, rows and columns of tables that are not used."""


@dataclass(frozen=True)
class ReadingNote:
    """What a reader of logs mended or passed over; its words are made where it is met.

    Attributes:
        kind: what sort of note.
        words: the same for the user.
        sources: the files, topics, joints and SUs it is about.
        number: of bytes, messages, samples, cells or rows, or how many times; NaN without any.
    """

    kind: ReadingKind
    words: str
    sources: tuple[str, ...] = ()
    number: float = math.nan


Noted = Note | ReadingNote | str
"""A note, or a remark that is nothing but words."""


def of_kind(notes: Iterable[Noted], kind: NoteKind) -> list[Note]:
    """Notes of one kind."""
    return [note for note in notes if isinstance(note, Note) and note.kind == kind]


def of_reading(notes: Iterable[Noted], kind: ReadingKind) -> list[ReadingNote]:
    """Notes of one kind of what a reader met."""
    return [note for note in notes if isinstance(note, ReadingNote) and note.kind == kind]
