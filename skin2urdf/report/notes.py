"""Words about notes, made of their names and numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import numpy as np

from skin2urdf.estimation.uncertainty.physics import (
    STAND_STILL,
    base_moves,
    felt_at_rest,
    in_odd_units,
)
from skin2urdf.geometry.units import IN_UNITS
from skin2urdf.notes import Note, Noted, ReadingNote
from skin2urdf.report.tables import number

_LISTED = 6
"""Poses that are listed at most."""
_WHY = {
    "no readings": "it has no usable readings",
    "no chain": "no chain of joints explains what it feels; put SUs on the segments before it if "
    "they have none, else see whether its clock is off (move from rest to rest, which shows it), "
    "or whether the position of a joint before it depends on another one (a coupled drive, a "
    "parallelogram): then give positions of the joints themselves",
    "never moved": "it never moved in this log",
    "not alone": "it moved, but neither alone nor in a pattern, so what it moves is not known",
    "turns no gravity": (
        "it turns no gravity: its axis is vertical, it slides, or nothing beyond carries an SU"
    ),
    "felt by none": "no SU feels it",
    "felt by none recorded": "no SU that was recorded while it moved feels it",
}


def note_words(notes: Iterable[Noted]) -> list[str]:
    """Notes in words a user can act on; those that have words keep them.

    Args:
        notes: of a calibration, or of any stage of it.
    """
    return [_words(note) if isinstance(note, Note) else _own_words(note) for note in notes]


def _own_words(note: ReadingNote | str) -> str:
    return note if isinstance(note, str) else note.words


def note_documents(notes: Iterable[Noted]) -> list[dict[str, Any]]:
    """Notes for a script: kinds, names and numbers, without those that are words alone."""
    return [asdict(note) for note in notes if not isinstance(note, str)]


def _words(note: Note) -> str:
    """One note in words."""
    sus, joints = ", ".join(note.sus), ", ".join(note.joints)
    match note.kind:
        case "su left out":
            return f"{sus} is left out: {_WHY[note.detail]}"
        case "joint left out":
            return f"{joints} is left out of the tree: {_why_joint(note)}"
        case "moves otherwise":
            move = "moves" if len(note.sus) == 1 else "move"
            return (
                f"{joints} is left out of the tree: {sus} {move} with it, but neither turns about "
                "an axis nor slides by as much as it does, as on a linkage: the place given is the "
                "one in the mean; log positions of the joints that carry it"
            )
        case "never together":
            return (
                f"{sus} were not recorded while {joints} moved and are taken not to move with "
                "them; if they do, record both in one log"
            )
        case "undecided":
            return (
                f"{sus} under {joints} was undecided and is taken as {note.detail}, which the rest "
                "of the activity matrix asks for"
            )
        case "bare base":
            return "no SU sits on the reference segment"
        case "moved alike":
            return (
                f"{joints} moved alike all along, so that the log does not tell which of them "
                "carries what sits beyond: the model holds as long as they move so; move them "
                "apart, or leave out of the log what is computed from another joint (mimic joints)"
            )
        case "positions lacking":
            logs = ", ".join(str(log + 1) for log in note.numbers)
            return (
                f"log {logs} lacks positions of joints before {sus}, which were not used from it: "
                "record all joint states in every log"
            )
        case "unit g":
            return f"{sus} reports g instead of m/s^2; its readings were converted"
        case "unit deg/s":
            return f"the gyroscope of {sus} reports deg/s; its rates were converted"
        case "odd unit":
            return f"{in_odd_units(note.joints)} (a range of {note.size:.3g}); {IN_UNITS}"
        case "base moves":
            return f"{base_moves(note.size)}; {STAND_STILL}"
        case "felt at rest":
            return f"{felt_at_rest(note.size)}; {STAND_STILL}"
        case "misfit" | "poses misfit" | "implausible shape" | "implausible bias":
            return _of_the_fit(note)
        case _:
            return _of_an_order(note)


def _why_joint(note: Note) -> str:
    """Why a joint is in no tree."""
    if note.detail != "not shown":
        return _WHY[note.detail]
    return (
        f"it moved by {note.size:.2g} rad (or m), but no SU that has a place in the tree shows it: "
        "none sits beyond it, or its axis is vertical and it moved slowly"
    )


def _of_the_fit(note: Note) -> str:
    """SUs and poses that fit worse than the rest, and sensors that can not be."""
    su = ", ".join(note.sus)
    if note.kind == "misfit":
        return (
            f"{su} fits {note.size:.0f} times worse than the other SUs and should not be trusted: "
            "check that it is fixed rigidly and that its axes are right-handed"
        )
    if note.kind == "implausible shape":
        return (
            f"{su} would need a scale or cross-axis error of {100 * note.size:.0f} %: check its "
            "unit and that its axes are right-handed"
        )
    if note.kind == "implausible bias":
        return f"{su} would need a bias of {note.size:.1f} m/s^2: check that sensor"
    n = len(note.numbers)
    listed = ", ".join(str(p + 1) for p in note.numbers[:_LISTED])
    listed += " and others" if n > _LISTED else ""
    verb = "fits badly and counts" if n == 1 else "fit badly and count"
    return (
        f"{n} of {note.of} poses {verb} little (number {listed} in the order of the log): "
        "something touched or moved the robot there, or its base moved"
    )


def _of_a_vertical_axis(note: Note) -> str:
    """Where an SU is taken to sit, and where it may, and what to record."""
    su, joint = " and ".join(note.sus), ", ".join(note.joints)
    are, an = ("is", "it") if len(note.sus) == 1 else ("are", "they")
    remedy = "record a log with the base tilted, or faster moves"
    if note.detail == "active":
        return (
            f"{su} {are} taken to sit on {joint}, which is vertical, but {an} may sit on a base "
            f"that gives way as well: {remedy}"
        )
    near = "on its axis" if np.isnan(note.size) else f"up to {1e3 * note.size:.2g} mm from its axis"
    return (
        f"{su} {are} taken to sit on the base, but {joint} is vertical: an SU {near} would look "
        f"the same; {remedy}"
    )


def _of_an_order(note: Note) -> str:
    """What is taken in one way and may be in another, and what to record."""
    su, joint = " and ".join(note.sus), ", ".join(note.joints)
    match note.kind:
        case "vertical axis":
            return _of_a_vertical_axis(note)
        case "placed by fit":
            taken = "to move" if note.detail == "active" else "not to move"
            return (
                f"{su} is taken {taken} with {joint}, for only then its readings fit, though their "
                f"activity says otherwise: record {joint} moving by itself to make it certain"
            )
        case "order from motion":
            doubt = "; the log shows the order weakly" if note.detail == "weak" else ""
            return (
                f"no SU sits between {' > '.join(note.joints)}: their order follows from the "
                f"motion{doubt}"
            )
        case "other order":
            where = ""
            if np.isfinite(note.size):
                where = f" (SUs would be elsewhere by {number(1e3 * note.size)} mm rms)"
            return (
                f"the log does not tell the order {' > '.join(note.joints)} from "
                f"{' > '.join(note.instead)}{where}: move each of these joints at several "
                "positions of the others, and quickly, or put an SU on every segment"
            )
        case "sense unknown":
            return (
                "the log does not tell the sense of every axis: record quicker moves, and the base "
                "tilted by 20 degrees or more"
            )
        case _:
            return (
                "the first look at the structure did not explain the readings; the tree is the one "
                "that the readings show once the joints' common motion is predicted: record "
                "structural moves of one DoF at a time to make it certain"
            )
