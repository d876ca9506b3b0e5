"""Directions in which a log says nothing about where SUs and branches sit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.model.records import OpenDirection
from skin2urdf.urdf.alignment import projector

_RANK = 1e-6  # singular values below this count as 0 in given directions


def load_unobservable(path: str | Path) -> dict[str, F64] | None:
    """Read the unobservable directions of SUs from the JSON beside an estimated URDF.

    Args:
        path: the JSON file; ``observability.sus[name].unobservable`` is a list of k vectors of 6
            numbers, or null where nothing is known of the SU.

    Returns:
        (k, 6) directions per SU, as :func:`skin2urdf.urdf.compare.compare` takes them; all six
        for null. None where there is no such file or it holds no observability.

    Raises:
        UnreadableInputError: the file is no JSON, or the entry has another shape.
    """
    content = _json(path)
    entry = content.get("observability") if isinstance(content, dict) else None
    sus = entry.get("sus") if isinstance(entry, dict) else None
    if not isinstance(sus, dict):
        return None
    result: dict[str, F64] = {}
    for name, su in sus.items():
        if not isinstance(su, dict) or "unobservable" not in su:
            continue
        try:
            result[name] = spanned(name, su["unobservable"], nothing_known=np.eye(6))
        except UsageError as error:
            raise UnreadableInputError(str(path), str(error), error.remedy) from error
    return result


def load_open(path: str | Path) -> tuple[OpenDirection, ...]:
    """Read the open directions between branches from the JSON beside an estimated URDF.

    Args:
        path: the JSON file; ``observability.between_branches`` lists objects whose ``joints`` and
            ``sus`` give twists of 6 numbers by name. Those of the kind "limb" are passed over:
            limbs are aligned one by one anyway, or meant to be compared as they are.

    Returns:
        The directions, as :func:`skin2urdf.urdf.compare.compare` takes them; none where there is
        no such file or it holds none.

    Raises:
        UnreadableInputError: the file is no JSON, or an entry has another shape.
    """
    content = _json(path)
    entry = content.get("observability") if isinstance(content, dict) else None
    given = entry.get("between_branches") if isinstance(entry, dict) else None
    try:
        return tuple(
            OpenDirection(_twists(each["joints"]), _twists(each["sus"]))
            for each in given or ()
            if each.get("kind") != "limb"
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UnreadableInputError(
            str(path),
            "holds open directions between branches that are not twists of 6 numbers by name",
            "calibrate again, or remove it to compare without it",
        ) from error


def _twists(given: Mapping[str, Any]) -> dict[str, F64]:
    """Twists (6,) by name; ValueError where these are no 6 finite numbers each."""
    twists = {str(name): np.asarray(xi, float) for name, xi in given.items()}
    if any(xi.shape != (6,) or not np.isfinite(xi).all() for xi in twists.values()):
        raise ValueError("not 6 finite numbers")
    return twists


def load_ranges(path: str | Path) -> dict[str, tuple[float, float]]:
    """Read the ranges of the joints that the log saw from the JSON beside an estimated URDF.

    Args:
        path: the JSON file; ``joints[name].limits`` are the ends.

    Returns:
        Lower and upper end by joint name [rad or m]; joints without are missing.

    Raises:
        UnreadableInputError: the file is no JSON.
    """
    content = _json(path)
    joints = content.get("joints") if isinstance(content, dict) else None
    ranges = {}
    for name, joint in joints.items() if isinstance(joints, dict) else ():
        ends = joint.get("limits") if isinstance(joint, dict) else None
        if isinstance(ends, list) and len(ends) == 2 and all(isinstance(e, float) for e in ends):
            ranges[str(name)] = (ends[0], ends[1])
    return ranges


def load_determined(path: str | Path) -> frozenset[str] | None:
    """Read which SUs are determined from the JSON beside an estimated URDF.

    Args:
        path: the JSON file; ``sus[name].verdict`` says "determined" of these SUs. Those that
            ``faults`` calls "mirrored" are left out: their frames are no other robot's.

    Returns:
        Their names, as ``anchors`` of :func:`skin2urdf.urdf.compare.compare`; None where there is
        no such file or it holds no verdicts.

    Raises:
        UnreadableInputError: the file is no JSON.
    """
    content = _json(path)
    sus = content.get("sus") if isinstance(content, dict) else None
    if not isinstance(sus, dict):
        return None
    verdicts = {name: su.get("verdict") for name, su in sus.items() if isinstance(su, dict)}
    if not any(verdicts.values()):
        return None
    faults = content.get("faults")
    mirrored = {
        fault.get("subject")
        for fault in (faults if isinstance(faults, list) else ())
        if isinstance(fault, dict) and fault.get("kind") == "mirrored"
    }
    return frozenset(
        name
        for name, verdict in verdicts.items()
        if verdict == "determined" and name not in mirrored
    )


def spanned(name: str, given: Any, nothing_known: F64 | None = None) -> F64:
    """Orthonormal directions (k, 6) that span given ones; k is their rank.

    Args:
        name: the SU's name, for messages.
        given: rows of 6 numbers; None for none.
        nothing_known: the result for None, where that is not the empty one.

    Raises:
        UsageError: these are no rows of 6 finite numbers.
    """
    if given is None:
        return np.zeros((0, 6)) if nothing_known is None else nothing_known
    try:
        rows = np.asarray(given, float)
        rows = rows.reshape(0, 6) if rows.size == 0 else rows
    except (TypeError, ValueError):
        rows = np.zeros(0)
    if rows.ndim != 2 or rows.shape[1] != 6 or not np.isfinite(rows).all():
        raise UsageError(
            f"the unobservable directions of SU {name!r} are not rows of 6 numbers",
            "give (k, 6) twists, linear part first",
        )
    _, values, Vt = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(Vt[values > _RANK])


def of_base_su(free: F64, R_base_su: F64, *, yaw: bool) -> F64:
    """Directions (k, 6) that count as free for an SU on the reference segment.

    Args:
        free: (k, 6) directions that are free anyway.
        R_base_su: (3, 3) orientation of the SU in a base frame whose z is up.
        yaw: whether the turn about gravity is free, beside the position that always is.
    """
    turn = np.concatenate([np.zeros(3), R_base_su[2]])[None]
    rows = np.concatenate([free, np.eye(6)[:3], turn[: 1 if yaw else 0]])
    return spanned("", rows)


def told(free: F64) -> tuple[bool, bool]:
    """Whether any part of the position, and of the orientation, is not free (k, 6)."""
    P = projector(free)
    return float(np.trace(P[:3, :3])) < 3 - _RANK, float(np.trace(P[3:, 3:])) < 3 - _RANK


def _json(path: str | Path) -> Any:
    """What a JSON file holds; None where there is no file."""
    path = Path(path)
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise UnreadableInputError(
            str(path), f"is not a JSON file: {error}", "remove it to compare without it"
        ) from error
