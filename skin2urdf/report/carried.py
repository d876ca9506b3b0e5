"""What it means where SUs follow the motion of a joint that does not turn them."""

from __future__ import annotations

from collections.abc import Sequence

from skin2urdf.calibration.result import Calibration
from skin2urdf.recording.naming import shortened

_NAMED = 3


def recoils(calibration: Calibration) -> tuple[str, str] | None:
    """What was found of a base that recoils, and what to do about it; None where none does.

    Args:
        calibration: a finished calibration.
    """
    sus, joints = _each_once(calibration.recoiling)
    if not sus:
        return None
    follow = "follows" if len(sus) == 1 else "follow"
    return (
        f"the base recoils from what the robot does: {shortened(sus, _NAMED)} {follow} the "
        f"accelerations of {shortened(joints, _NAMED)}, further out on the robot",
        "fix the base more stiffly, or move more slowly, from pose to pose without patterns",
    )


def carried_without_turning(calibration: Calibration) -> tuple[str, str] | None:
    """What was found, and what to do about it; None where nothing is carried along.

    Args:
        calibration: a finished calibration.
    """
    sus, joints = _each_once(calibration.carried_along)
    if not sus:
        return None
    carry = "carries" if len(joints) == 1 else "carry"
    names = " and ".join(joints)
    return (
        f"{names} {carry} {shortened(sus, _NAMED)} along, which do not turn with it against "
        "gravity, as on a parallelogram",
        "where an encoder reads the sum of two joints, log the angle between the two links, which "
        f"is its reading less, or plus, that of {names}; see otherwise whether these SUs sit "
        f"beyond {names}, and whether the base stands firmly",
    )


def _each_once(pairs: Sequence[tuple[str, str]]) -> tuple[list[str], list[str]]:
    """The SUs and the joints of pairs of both, each once, in their order."""
    sus, joints = ([pair[i] for pair in pairs] for i in (0, 1))
    return list(dict.fromkeys(sus)), list(dict.fromkeys(joints))
