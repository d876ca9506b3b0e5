"""Notes in words: every kind has its own, and names what it is about."""

from __future__ import annotations

from typing import get_args

import pytest

from skin2urdf.notes import Detail, Note, NoteKind, ReadingNote, of_kind, of_reading
from skin2urdf.report.notes import note_documents, note_words

DETAILS: dict[NoteKind, tuple[Detail, ...]] = {
    "su left out": ("no readings", "no chain"),
    "joint left out": (
        "never moved", "not alone", "turns no gravity", "felt by none", "felt by none recorded",
        "not shown",
    ),
    "undecided": ("active", "inactive"),
    "placed by fit": ("active", "inactive"),
    "vertical axis": ("active", "inactive"),
    "order from motion": ("", "weak"),
}  # fmt: skip
OF_NOTHING = {
    "bare base",
    "sense unknown",
    "second look",
    "poses misfit",
    "base moves",
    "felt at rest",
}
OF_JOINTS_ALONE = {
    "joint left out",
    "order from motion",
    "other order",
    "moved alike",
    "odd unit",
}
OF_SUS_ALONE = {
    "su left out", "positions lacking", "misfit", "unit g", "unit deg/s",
    "implausible shape", "implausible bias",
}  # fmt: skip
EVERY = [(kind, detail) for kind in get_args(NoteKind) for detail in DETAILS.get(kind, ("",))]


def made(kind: NoteKind, detail: Detail) -> Note:
    sus = () if kind in OF_NOTHING | OF_JOINTS_ALONE else ("su_a",)
    joints = () if kind in OF_NOTHING | OF_SUS_ALONE else ("j1", "j2")
    return Note(kind, sus, joints, detail, joints[::-1], 37.0, (4, 8), 12)


@pytest.mark.parametrize(("kind", "detail"), EVERY)
def test_words_name_what_a_note_is_about(kind: NoteKind, detail: Detail) -> None:
    note = made(kind, detail)
    (words,) = note_words([note])
    assert all(name in words for name in (*note.sus, *note.joints))
    assert words.isprintable()


def test_no_two_notes_have_the_same_words() -> None:
    said = note_words(made(kind, detail) for kind, detail in EVERY)
    assert len(set(said)) == len(said) == len(EVERY)


def test_logs_and_poses_are_numbered_from_one_in_words() -> None:
    poses = note_words([Note("poses misfit", numbers=(4, 8), of=12)])[0]
    assert "5, 9" in poses
    assert "12" in poses
    assert "3" in note_words([Note("positions lacking", ("su_a",), numbers=(2,))])[0].split()


def test_what_a_reader_says_stays_as_it_is() -> None:
    read = ReadingNote("spikes", "words of the reader", ("su_a", "/imu"), 3)
    notes = [read, "a remark", Note("unit g", ("su_a",))]
    assert note_words(notes)[:2] == [read.words, notes[1]]
    told, document = note_documents(notes)
    assert (told["kind"], told["sources"], told["number"]) == ("spikes", ("su_a", "/imu"), 3)
    assert (document["kind"], document["sus"]) == ("unit g", ("su_a",))
    assert of_kind(notes, "unit g") == notes[2:]
    assert of_reading(notes, "spikes") == [read]
