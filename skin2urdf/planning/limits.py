"""Limits of joints: from a URDF, from a file of limits, and what is usual where neither says.

A file of limits is what MoveIt and ros2_control read, as YAML or as TOML::

    joint_limits:
      shoulder:
        min_position: -2.8        # [rad or m]; both left out: turns without end
        max_position: 2.8
        max_velocity: 2.0         # [rad/s or m/s]
        max_acceleration: 8.0     # [rad/s^2 or m/s^2]
        max_jerk: 200.0           # [rad/s^3 or m/s^3]
        type: prismatic           # or revolute, which goes without saying

A limit with ``has_.._limits: false`` beside it counts as not given.
"""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.errors import PlanError, UnreadableInputError, UsageError
from skin2urdf.planning.records import Limits

_VELOCITY = (1.5, 0.3)
"""Speed of a joint that no limit of speed is known of [rad/s, m/s]: that of careful moves."""
_ACCELERATION = (10.0, 3.0)
"""Largest acceleration that is assumed [rad/s^2, m/s^2]; the first is what MoveIt assumes."""
_TO_SPEED = 0.25
"""Time to reach full speed in that is assumed [s]; of arms of 1 to 30 kg, data sheets have 0.1 to
0.3 s."""
_TO_ACCELERATION = 0.04
"""Time to reach full acceleration in that is assumed [s]: 1 / (2 pi 4 Hz), so that patterns of up
to 4 Hz may use all of it."""
_LEAST_RANGE = (0.2, 0.02)
"""Range of positions below which there is no room for a move and a pattern [rad, m]."""
_KEYS = {
    "min_position": ("lower", "position"),
    "max_position": ("upper", "position"),
    "max_velocity": ("velocity", "velocity"),
    "max_acceleration": ("acceleration", "acceleration"),
    "max_jerk": ("jerk", "jerk"),
}


@dataclass(frozen=True)
class Given:
    """What is known of one joint; None where nothing is said.

    Attributes:
        prismatic: True where it slides.
        lower: lower position [rad or m].
        upper: upper position [rad or m].
        velocity: largest speed [rad/s or m/s].
        acceleration: largest acceleration [rad/s^2 or m/s^2].
        jerk: largest jerk [rad/s^3 or m/s^3].
    """

    prismatic: bool = False
    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    jerk: float | None = None


def read_limits(path: str | Path) -> dict[str, Given]:
    """Limits by joint name from a file.

    Args:
        path: YAML, or TOML by its ending.

    Raises:
        UnreadableInputError: the file can not be read, or says something else.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text) if path.suffix.lower() == ".toml" else _yaml(text)
    except OSError as error:
        raise UnreadableInputError(
            str(path), f"can not be read: {error.strerror or error}", "check the path"
        ) from error
    except (ValueError, UnicodeDecodeError) as error:
        raise _not_limits(path, f"is neither YAML nor TOML: {_line(error)}") from error
    table = data.get("joint_limits", data) if isinstance(data, dict) else None
    if not isinstance(table, dict) or not table:
        raise _not_limits(path, "has no joint_limits")
    return {str(name): _given(path, str(name), values) for name, values in table.items()}


def acceleration_and_jerk(xml: ET.Element) -> dict[str, Given]:
    """What a URDF says beyond what Pinocchio reads: limits of acceleration and jerk, by joint."""
    found = {}
    for joint in xml.findall("joint"):
        limit = joint.find("limit")
        if limit is not None:
            found[str(joint.get("name"))] = Given(
                acceleration=_positive(limit.get("acceleration")), jerk=_positive(limit.get("jerk"))
            )
    return found


def merged(first: Given, second: Given) -> Given:
    """What one source says, or else another; positions together."""
    out = {
        name: getattr(first, name) if getattr(first, name) is not None else getattr(second, name)
        for name in ("lower", "upper", "velocity", "acceleration", "jerk")
    }
    return replace(second, **out)


def complete(names: Sequence[str], given: Mapping[str, Given]) -> Limits:
    """Limits of joints, with what is usual where nothing is said.

    Args:
        names: D joint names.
        given: what is known of each.

    Raises:
        PlanError: limits contradict each other or leave no room.
    """
    rows: list[tuple[float, ...]] = []
    missing: dict[str, list[str]] = {"speed": [], "acceleration": [], "jerk": []}
    for name in names:
        joint = given[name]
        kind = int(joint.prismatic)
        lower = -np.inf if joint.lower is None else joint.lower
        upper = np.inf if joint.upper is None else joint.upper
        if not upper - lower >= _LEAST_RANGE[kind]:
            unit = "m" if joint.prismatic else "rad"
            raise PlanError(
                f"{name} may be from {lower:g} to {upper:g} {unit}, which leaves no room for a "
                "move and a pattern",
                f"give it a range of {_LEAST_RANGE[kind]} {unit} or more, or lock the joint",
            )
        velocity = joint.velocity
        if velocity is None:
            velocity = _VELOCITY[kind]
            missing["speed"].append(name)
        acceleration = joint.acceleration
        if acceleration is None:
            acceleration = min(velocity / _TO_SPEED, _ACCELERATION[kind])
            missing["acceleration"].append(name)
        jerk = joint.jerk
        if jerk is None:
            jerk = acceleration / _TO_ACCELERATION
            missing["jerk"].append(name)
        for what, value in (("speed", velocity), ("acceleration", acceleration), ("jerk", jerk)):
            if not 0 < value < np.inf:
                raise PlanError(
                    f"the {what} of {name} is limited to {value:g}: it can not move",
                    "give every limit a positive number, or lock the joint",
                )
        rows.append((lower, upper, velocity, acceleration, jerk))
    lower, upper, velocity, acceleration, jerk = np.array(rows).T
    assumed = {"speed": velocity, "acceleration": acceleration, "jerk": jerk}
    notes = [
        f"no limit of {what} is given for {_named(of, names)}: {_values(assumed[what], of, names)} "
        "is assumed"
        for what, of in missing.items()
        if of
    ]
    slides = np.array([given[name].prismatic for name in names])
    return Limits(tuple(names), slides, lower, upper, velocity, acceleration, jerk, tuple(notes))


def scaled(limits: Limits, share: float) -> Limits:
    """Limits of which but a share is used; positions stay."""
    return replace(
        limits,
        velocity=limits.velocity * share,
        acceleration=limits.acceleration * share,
        jerk=limits.jerk * share,
    )


def _named(of: Sequence[str], names: Sequence[str]) -> str:
    if len(of) == len(names):
        return "any joint"
    return ", ".join(of[:4]) + (f" and {len(of) - 4} more" if len(of) > 4 else "")


def _values(values: Any, of: Sequence[str], names: Sequence[str]) -> str:
    chosen = [values[names.index(name)] for name in of]
    low, high = min(chosen), max(chosen)
    return f"{low:.3g}" if high - low < 1e-9 else f"{low:.3g} to {high:.3g}"


def _yaml(text: str) -> Any:
    import yaml

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error


def _given(path: Path, name: str, values: Any) -> Given:
    if not isinstance(values, dict):
        raise _not_limits(path, f"has no limits under {name}")
    known = {*_KEYS, "type", "min_velocity", "max_effort", "max_deceleration", "angle_wraparound"}
    unknown = {k for k in values if k not in known and not str(k).startswith("has_")}
    if unknown:
        raise _not_limits(path, f"{name} has unknown keys {', '.join(sorted(map(str, unknown)))}")
    kind = values.get("type", "revolute")
    if kind not in ("revolute", "continuous", "prismatic"):
        raise _not_limits(path, f"{name} is of type {kind!r}")
    out: dict[str, float] = {}
    for key, (field, what) in _KEYS.items():
        if key in values and values.get(f"has_{what}_limits", True) is not False:
            value = values[key]
            if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
                raise _not_limits(path, f"{key} of {name} is {value!r}, not a number")
            out[field] = float(value)
    if kind == "continuous":
        out.pop("lower", None), out.pop("upper", None)
    return Given(prismatic=kind == "prismatic", **out)


def _not_limits(path: Path, what: str) -> UnreadableInputError:
    return UnreadableInputError(
        str(path),
        what,
        "write joint_limits: {JOINT: {min_position: -2.8, max_position: 2.8, max_velocity: 2.0}}, "
        "as MoveIt and ros2_control have it",
    )


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


def _positive(text: str | None) -> float | None:
    try:
        value = float(text) if text is not None else 0.0
    except ValueError:
        return None
    return value if 0 < value < np.inf else None


def check_names(given: Mapping[str, Given], names: Sequence[str], path: str) -> None:
    """Refuse limits of joints that a robot does not have.

    Raises:
        UsageError: a name is none of the robot's.
    """
    unknown = sorted(given.keys() - set(names))
    if unknown:
        raise UsageError(
            f"{path} limits {', '.join(unknown[:6])}, which the robot does not have",
            f"its joints are {', '.join(names)}",
        )
