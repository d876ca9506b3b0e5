"""How far joints may go: what a log saw, what does not bind, or what somebody says who knows.

A log tells where joints have been, and not where their stops are. Limits that end where the log
ended shut out most of the range of a real joint, and often zero, at which many tools begin: so the
default is wide ones, marked as placeholders. For planning on a real robot the range that was seen
can stand beside them as soft limits (URDF's ``safety_controller``): MoveIt and ros_control keep
within these, other readers skip them (Drake says so in a warning).
"""

from __future__ import annotations

import math
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.files import read_text
from skin2urdf.urdf.records import JointLimits

Choice = Literal["wide", "soft", "seen"]
CHOICES: tuple[Choice, ...] = ("wide", "soft", "seen")

NOMINAL_VELOCITY = 3.2
"""Velocity limit where none is given [rad/s or m/s]; URDF demands one."""


@dataclass(frozen=True)
class GivenLimit:
    """What a file says of one joint; None for what it does not say.

    Attributes:
        lower: lower position limit [rad or m].
        upper: upper position limit.
        velocity: velocity limit [rad/s or m/s].
    """

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None


def seen_limits(seen: F64, velocity: F64) -> JointLimits:
    """Limits at the ends of what a log saw.

    Args:
        seen: (D, 2) ranges of the joints' positions in the log [rad or m].
        velocity: (D,) largest speeds in the log.
    """
    n = len(seen)
    return JointLimits(seen, velocity, np.full((n, 2), np.nan), np.ones(n, bool))


def wide_limits(seen: F64, velocity: F64, prismatic: Bool, *, soft: bool = False) -> JointLimits:
    """Limits that do not bind.

    Half a turn either way for what turns, and for what slides the range seen, with zero, and as
    much again on both sides; more where the log went further.

    Args:
        seen: (D, 2) ranges of the joints' positions in the log [rad or m].
        velocity: (D,) largest speeds in the log [rad/s or m/s].
        prismatic: (D,) which joints slide.
        soft: whether what was seen are soft limits.
    """
    low, high = np.minimum(seen[:, 0], 0.0), np.maximum(seen[:, 1], 0.0)
    span = seen[:, 1] - seen[:, 0]
    slides = np.stack([low - span, high + span], axis=1)
    turns = np.stack([np.minimum(low, -np.pi), np.maximum(high, np.pi)], axis=1)
    return JointLimits(
        np.where(np.asarray(prismatic)[:, None], slides, turns),
        np.maximum(velocity, NOMINAL_VELOCITY),
        seen if soft else np.full(seen.shape, np.nan),
        np.zeros(len(seen), bool),
    )


def with_given(
    limits: JointLimits, names: Sequence[str], given: Mapping[str, GivenLimit], source: str
) -> JointLimits:
    """Limits with those put in that a file gives; joints it does not name keep theirs.

    Args:
        limits: of D joints.
        names: their D names.
        given: what the file says, by joint name.
        source: the file, for messages.

    Raises:
        UsageError: the file names none of the joints, or a lower limit is not below its upper one.
    """
    if not any(name in given for name in names):
        raise UsageError(
            f"{source} has limits of none of the joints {', '.join(names[:4])}",
            "name the joints as the log does",
        )
    position, velocity = limits.position.copy(), limits.velocity.copy()
    soft, known = limits.soft.copy(), limits.known.copy()
    for j, name in enumerate(names):
        one = given.get(name, GivenLimit())
        if one.velocity is not None:
            velocity[j] = one.velocity
        if one.lower is None or one.upper is None:
            continue
        if not one.lower < one.upper:
            raise UsageError(
                f"{source} limits joint {name!r} to [{one.lower:g}, {one.upper:g}]",
                "a lower limit below the upper one is needed",
            )
        position[j] = one.lower, one.upper
        soft[j], known[j] = np.nan, True
    return JointLimits(position, velocity, soft, known)


def read_limits(path: str | Path) -> dict[str, GivenLimit]:
    """Read limits by joint name from a URDF, or from YAML or TOML.

    YAML and TOML hold a table by joint name, at the top or below ``joint_limits`` as MoveIt writes
    it. A joint has ``[lower, upper]``, or a table with ``lower``, ``upper`` and ``velocity``, or
    with ``min_position``, ``max_position`` and ``max_velocity``; in rad and m.

    Args:
        path: a file whose name ends in .urdf, .xml, .yaml, .yml or .toml.

    Raises:
        UnreadableInputError: it can not be read as what its name says, or holds no limits.
        UsageError: the name ends in something else.
    """
    path = Path(path)
    readers = {".urdf": _of_urdf, ".xml": _of_urdf, ".toml": _of_toml, ".yaml": _of_yaml}
    readers[".yml"] = _of_yaml
    if path.suffix.lower() not in readers:
        raise UsageError(
            f"can not read limits from {path}",
            "give `seen`, `wide`, `soft`, or a file .urdf, .yaml or .toml",
            str(path),
        )
    try:
        found = readers[path.suffix.lower()](read_text(path))
    except ValueError as error:  # ParseError, TOMLDecodeError and wrong numbers are such
        raise UnreadableInputError(
            str(path), f"holds no limits that can be read: {error}", _FORM
        ) from error
    if not found:
        raise UnreadableInputError(str(path), "holds no limits of joints", _FORM)
    return found


_FORM = "give limits by joint name, such as `joint1: [-2.9, 2.9]`"


def _of_urdf(text: str) -> dict[str, GivenLimit]:
    """Limits of a URDF's joints."""
    try:
        root = ET.fromstring(text)  # noqa: S314 - plain expat, see urdf.loading
    except ET.ParseError as error:
        raise ValueError(str(error)) from error
    found = {}
    for joint in root.iter("joint"):
        limit = joint.find("limit")
        if limit is not None:
            keys = ("lower", "upper") if joint.get("type") != "continuous" else ()
            values = {key: limit.get(key) for key in (*keys, "velocity")}
            found[joint.get("name", "")] = GivenLimit(
                **{key: _finite(value) for key, value in values.items() if value is not None}
            )
    return found


def _of_toml(text: str) -> dict[str, GivenLimit]:
    return _of_table(tomllib.loads(text))


def _of_yaml(text: str) -> dict[str, GivenLimit]:
    import yaml

    try:
        return _of_table(yaml.safe_load(text))
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error


_KEYS = {
    "lower": ("lower", "min_position"),
    "upper": ("upper", "max_position"),
    "velocity": ("velocity", "max_velocity"),
}


def _of_table(table: Any) -> dict[str, GivenLimit]:
    """Limits of a table by joint name; entries that are no limits are skipped."""
    if isinstance(table, dict) and isinstance(table.get("joint_limits"), dict):
        table = table["joint_limits"]
    found = {}
    for name, entry in table.items() if isinstance(table, dict) else ():
        if isinstance(entry, list) and len(entry) == 2:
            found[str(name)] = GivenLimit(_finite(entry[0]), _finite(entry[1]))
        elif isinstance(entry, dict):
            parts = {
                ours: _finite(entry[key])
                for ours, keys in _KEYS.items()
                for key in keys
                if entry.get(key) is not None
            }
            if parts:
                found[str(name)] = GivenLimit(**parts)
    return found


def _finite(value: Any) -> float:
    """A finite number; ValueError where it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"{value!r} is no number")  # noqa: TRY004 - told as a bad file
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{value!r} is no limit")
    return number
