"""A comparison with the truth as text that a person understands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.urdf.records import Comparison, JointError, Spread, SuError

_MM = 1e3
_DEG = float(np.rad2deg(1.0))
_COLUMNS = ("rms", "max", "rms", "max")


def as_text(comparison: Comparison) -> str:
    """A comparison as plain text: verdict on the tree, one row per SU and joint, the overall.

    Args:
        comparison: what :func:`skin2urdf.urdf.compare.compare` found.

    Returns:
        Lines without colour or trailing spaces; lengths in mm, angles in deg.
    """
    c = comparison
    lines = ["Tree: right" if c.tree_equal else "Tree: WRONG"]
    lines += [f"  - {difference.words}" for difference in c.tree_differences]
    lines.append("")
    lines += _table(
        "SU",
        ("position [mm]", "orientation [deg]"),
        [(*_su_row(su), _note(su)) for su in c.sus]
        + [("all SUs", _cells(c.position, _MM), _cells(c.orientation, _DEG), "")],
    )
    lines.append("")
    lines += _table(
        "joint",
        ("axis line [mm]", "axis angle [deg]"),
        [_joint_row(joint) for joint in c.joints]
        + [("all joints", _cells(c.axis_distance, _MM), _cells(c.axis_angle, _DEG), "")],
    )
    lines.append("")
    lines.append(
        f"Errors over {c.n_configurations} random configurations inside the limits, {_aligned(c)}."
    )
    if c.n_open:
        directions = "1 direction" if c.n_open == 1 else f"{c.n_open} directions"
        lines.append(
            f"Branches moved along {directions} that the log leaves open between them, to fit best."
        )
    if c.placed:
        lines.append(
            "The truth has none of the SUs: each was put onto its link where it fits best, and its "
            "errors are those of its motion with that link."
        )
    for words, names in (
        ("Joints that have other names in the truth", [f"{a} ({b})" for a, b in c.matched.items()]),
        ("Not observable from the log, left out", c.not_observable),
        ("Joints of limbs without an observable SU, left out", c.joints_left_out),
        ("Links of the estimate that the truth does not have", c.unmatched),
        ("Joints of one robot only, held still", c.held_joints),
    ):
        if names:
            lines.append(f"{words}: {', '.join(names)}.")
    return "\n".join(lines) + "\n"


def _aligned(c: Comparison) -> str:
    """How the robots were aligned, in words."""
    if len(c.alignments) == 1:
        return "base frames aligned"
    limbs = ", ".join(str(alignment.limb) for alignment in c.alignments)
    return (
        f"{len(c.alignments)} limbs aligned one by one (from {limbs} on), since a log does not "
        "tell their yaw and position relative to each other; they agree on gravity within "
        f"{c.tilt_between_limbs * _DEG:.3f} deg"
    )


_Row = tuple[str, tuple[str, str], tuple[str, str], str]


def _table(title: str, groups: tuple[str, str], rows: Sequence[_Row]) -> list[str]:
    """Lines of a table with a name, two pairs of numbers and a note; the last row is the sum."""
    width = max(len(title), *(len(row[0]) for row in rows))
    span = max(20, *(len(group) + 2 for group in groups))
    half = span // 2
    head = f"{title:<{width}}" + "".join(f"{group:>{2 * half}}" for group in groups)
    below = " " * width + "".join(f"{column:>{half}}" for column in _COLUMNS)
    rule = "-" * len(below)
    body = [
        (f"{name:<{width}}" + "".join(f"{cell:>{half}}" for cell in (*a, *b)) + f"  {note}")
        for name, a, b, note in rows
    ]
    lines = [head, below, rule, *body[:-1], rule, body[-1]]
    return [line.rstrip() for line in lines]


def _su_row(su: SuError) -> tuple[str, tuple[str, str], tuple[str, str]]:
    """Name and cells of one SU."""
    return su.name, _cells(su.position, _MM), _cells(su.orientation, _DEG)


def _joint_row(joint: JointError) -> _Row:
    """Name, cells and note of one joint."""
    note = "prismatic" if joint.joint_type == "prismatic" else ""
    return joint.name, _cells(joint.distance, _MM), _cells(joint.angle, _DEG), note


def _note(su: SuError) -> str:
    """What is not told of an SU, in words."""
    return f"{su.n_unobservable} of 6 directions not observable" if su.n_unobservable else ""


def _cells(spread: Spread | None, scale: float) -> tuple[str, str]:
    """Both numbers of a spread, a dash where there is none."""
    if spread is None or not np.isfinite(spread.rms):
        return "-", "-"
    return f"{spread.rms * scale:.3f}", f"{spread.max * scale:.3f}"
