"""A check of a calibration in words, in a table, as JSON, and as a line of a history."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from skin2urdf.report.document import fault_document
from skin2urdf.report.faults import fault_words
from skin2urdf.report.notes import note_documents, note_words
from skin2urdf.report.plain import to_plain, versions
from skin2urdf.report.tables import bullets, count, number, table
from skin2urdf.vendor.checking import Checked, SuCheck

SCHEMA = "skin2urdf/check/1"
_MM, _DEG = 1e3, float(np.rad2deg(1.0))


def as_text(checked: Checked) -> str:
    """A check as plain text: the verdict, and every SU."""
    lines = [
        _verdict(checked),
        "",
        *_table(checked),
        "",
        "finds: the smallest slip that a log like this one tells in 99 of 100 cases, whatever its "
        "direction; a longer log, or quicker moves, tell smaller ones",
        *bullets("What changed", [_words(su) for su in checked.sus if su.changed]),
        *bullets("Faults", [str(fault_words(f, len(checked.sources))) for f in checked.faults]),
        *bullets("Notes", [*_in_common(checked), *_new(checked), *note_words(checked.notes)]),
    ]
    return "\n".join(lines) + "\n"


def _verdict(checked: Checked) -> str:
    changed = [su.name for su in checked.sus if su.changed]
    open_ = [su.name for su in checked.sus if su.what == "open"]
    n, source = len(checked.sus), checked.skin.description.text.source
    same = n - len(changed) - len(open_)
    told = f"{same} of {count(n, 'SU')} {'is where it was' if same == 1 else 'are where they were'}"
    tail = f"; the log does not tell of {', '.join(open_)}" if open_ else ""
    for kind, unseen in (
        ("shifts", [su.name for su in checked.sus if np.isnan(su.off.shift)]),
        ("turns", [su.name for su in checked.sus if np.isnan(su.off.turn)]),
    ):
        others = [name for name in unseen if name not in (*open_, *changed)]
        tail += f"; it tells no {kind} of {', '.join(others)}" if others else ""
    left = f"(what is left of the readings is {checked.left.mean:.2g} times noise)"
    if not changed:
        return f"still true: {told} in {source} {left}{tail}"
    return f"no longer true: {told} in {source}, {', '.join(changed)} not {left}{tail}"


def _table(checked: Checked) -> list[str]:
    rows = []
    for su in checked.sus:
        (shift, shift_sd), (turn, turn_sd) = su.shift, su.turn
        rows.append(
            (
                su.name,
                su.link,
                f"{number(shift * _MM)} +- {number(shift_sd * _MM)}" if su.told else "-",
                f"{number(turn * _DEG, 3)} +- {number(turn_sd * _DEG, 3)}" if su.told else "-",
                number(su.off.shift * _MM),
                number(su.off.turn * _DEG, 3),
                number(su.off.chi2 / su.off.dof if su.off.dof else np.nan, 1),
                su.what,
            )
        )
    head = ("SU", "on link", "shift [mm]", "turn [deg]", "finds [mm]", "[deg]", "chi2/dof", "")
    return table(head, rows, "<<>>>>><")


def _words(su: SuCheck) -> str:
    """What became of an SU."""
    (shift, shift_sd), (turn, turn_sd) = su.shift, su.turn
    by = (
        f"{number(shift * _MM)} +- {number(shift_sd * _MM)} mm and {number(turn * _DEG, 3)} +- "
        f"{number(turn_sd * _DEG, 3)} deg"
    )
    return {
        "moved": f"{su.name} moved on {su.link} by {by}",
        "elsewhere": f"{su.name} sits on {su.link}, where it was not before",
        "exchanged": f"{su.name} is in the place of {su.place_of}: names or cables were exchanged",
        "gone": f"{su.name} has no usable readings",
        "does not fit": f"{su.name} fits on no link: it is loose, or its sensor is broken",
    }.get(su.what, f"{su.name}: {su.what}")


def _in_common(checked: Checked) -> list[str]:
    joint = checked.in_common
    if not joint:
        return []
    return [
        f"all SUs beyond {joint} changed and no others: rather than these, the zero of its encoder "
        "may have; hold the joints against their model with skin2urdf calibrate --model --correct "
        "zeros, or calibrate again"
    ]


def _new(checked: Checked) -> list[str]:
    return [f"{name} of the log is not in the calibration" for name in checked.new]


def as_document(checked: Checked) -> dict[str, Any]:
    """A check as dictionaries, lists, strings and finite numbers; lengths in m, angles in rad."""
    plain: dict[str, Any] = to_plain(
        {
            "schema": SCHEMA,
            "versions": versions(),
            "inputs": [asdict(source) for source in checked.sources],
            "urdf": {
                "file": checked.skin.description.text.source,
                "sha256": checked.skin.description.text.digest,
            },
            "true": checked.true,
            "words": _verdict(checked),
            "left": checked.left.mean,
            "sus": {su.name: _su(su) for su in checked.sus},
            "joint_in_common": checked.in_common or None,
            "new_sus": checked.new,
            "faults": [fault_document(f, len(checked.sources)) for f in checked.faults],
            "notes": note_words(checked.notes),
            "noted": note_documents(checked.notes),
            "seconds": checked.seconds,
        }
    )
    return plain


def _su(su: SuCheck) -> dict[str, Any]:
    unknown = np.nan, np.nan
    (shift, shift_sd), (turn, turn_sd) = (su.shift, su.turn) if su.told else (unknown, unknown)
    return {
        "what": su.what,
        "link": su.link,
        "in_place_of": su.place_of or None,
        "shift": shift,
        "shift_sd": shift_sd,
        "turn": turn,
        "turn_sd": turn_sd,
        "twist": su.twist,
        "finds_shift": su.off.shift,
        "finds_turn": su.off.turn,
        "chi2": su.off.chi2,
        "dof": su.off.dof,
        "probability": su.off.probability,
        "T_link_su": su.T_link_su,
    }


def history_line(checked: Checked, when: str) -> dict[str, Any]:
    """What a history keeps of a check, for one line.

    Args:
        checked: the check.
        when: date and time of it (ISO 8601).
    """
    document = as_document(checked)
    kept = (
        "what", "shift", "shift_sd", "turn", "turn_sd", "finds_shift", "finds_turn", "chi2", "dof",
    )  # fmt: skip
    return {
        "when": when,
        "urdf": document["urdf"],
        "logs": [source["digest"] for source in document["inputs"]],
        "true": document["true"],
        "left": document["left"],
        "sus": {name: {key: su[key] for key in kept} for name, su in document["sus"].items()},
    }
