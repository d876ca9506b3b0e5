"""The paper's constraints (II-A.2, II-B.3) that a matrix violates, in the paper's words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from skin2urdf.paper.exploration.crossings import Crossing
from skin2urdf.paper.exploration.records import Group, Violation

_ONE_AT_A_TIME = "record larger moves of one DoF at a time, with a rest before and after each"
_TURN_BASE = (
    "record a second log with the static segment rotated by 90 degrees about a horizontal axis"
)


def crossing_violations(
    crossings: Sequence[Crossing], sus: Sequence[Sequence[str]], dofs: Sequence[Sequence[str]]
) -> Iterator[Violation]:
    """Say what makes the columns of a merged matrix cross.

    Args:
        crossings: the explanations.
        sus: names of the SUs of each row.
        dofs: names of the DoFs of each column.
    """
    for c in crossings:
        names = tuple(name for s in c.segments for name in sus[s])
        joints = [tuple(dofs[j]) for j in c.joints]
        moved = tuple(name for joint in joints for name in joint)
        if c.cause == "closed loop":
            words = (
                f"closed loop: the segment with {_list(names)} hangs on more than one joint: it "
                f"moves with {_list([_list(j) for j in joints])}, none of which carries another"
            )
            remedy = (
                "open the loop (or lock its joints) during calibration; if there is none, an SU "
                "touches two segments, or one before these joints missed a move of the other"
            )
        elif c.cause == "coupled DoFs":
            words = (
                f"coupled DoFs: moving {_list(joints[0])} also moves {_list(joints[1])}, which "
                f"hangs elsewhere (seen by {_list(names)})"
            )
            remedy = "actuate every DoF on its own (hold the others), or leave a mimic joint out"
        else:
            words = (
                f"missed reaction: {_list(joints[1])} moves {_list(names)}, but "
                f"{_list(joints[0])}, which moves the other SUs beyond {_list(joints[1])}, seems "
                "not to: an entry of the activity matrix is falsely 0"
            )
            remedy = (
                f"{_ONE_AT_A_TIME}, and check these SUs; if they still do not react, look for a "
                "closed kinematic loop"
            )
        yield Violation(c.cause, words, remedy, names, moved)


def no_static_segment(su_names: Sequence[str], always: Sequence[str]) -> Violation:
    """No null row in the merged matrix.

    Args:
        su_names: all SUs.
        always: DoFs that move all of them.
    """
    which = (
        f"the only SU, {su_names[0]}," if len(su_names) == 1 else f"each of the {len(su_names)} SUs"
    )
    whom = "it" if len(su_names) == 1 else "all of them"
    also = f" ({_list(always)} {'moves' if len(always) == 1 else 'move'} {whom})" if always else ""
    return Violation(
        "no static segment",
        f"no static segment: {which} is moved by some DoF{also}, so the "
        "reference segment carries no SU or does not keep still",
        "fix the base (the torso of a humanoid), and put an SU on it",
        tuple(su_names),
        tuple(always),
    )


def segment_without_su(before: Sequence[str], beyond: Sequence[Sequence[str]]) -> Violation:
    """No row for a segment on which several joints hang.

    Args:
        before: DoFs of the joint that carries the segment.
        beyond: DoFs of each joint that hangs on it.
    """
    return Violation(
        "segment without SU",
        f"segment without SU: {_list([_list(j) for j in beyond])} hang on a segment beyond "
        f"{_list(before)} on which no SU sits",
        "put at least one SU on every segment",
        (),
        tuple(before),
    )


def dofs_without_reaction(
    dof_names: Sequence[str], silent: Group, excited: Sequence[bool]
) -> Iterator[Violation]:
    """Null columns: DoFs that no SU reacts to.

    Args:
        dof_names: D DoF names.
        silent: the DoFs that no SU reacts to.
        excited: D flags: False for DoFs that never moved.
    """
    still = tuple(dof_names[d] for d in silent if not excited[d])
    bare = tuple(dof_names[d] for d in silent if excited[d])
    if bare:
        yield Violation(
            "end effector without SU",
            f"end effector without SU: no SU reacts to {_list(bare)}, so what this moves carries "
            "none, or its axis is vertical in the only orientation of the base",
            f"put at least one SU on every segment, or {_TURN_BASE}",
            (),
            bare,
        )
    if still:
        yield Violation(
            "DoF without motion",
            f"DoF without motion: {_list(still)} never moved",
            "actuate every DoF freely, one after the other",
            (),
            still,
        )


def sus_without_readings(names: Sequence[str]) -> Violation:
    """SUs that can not show any activity and are left out."""
    return Violation(
        "SU without readings",
        f"SU without readings: {_list(names)}",
        "check their cables and topics",
        tuple(names),
    )


def _list(names: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    *rest, last = names
    return f"{', '.join(rest)} and {last}" if rest else last
