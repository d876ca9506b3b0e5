"""Robots to simulate: one small TOML file each, or any URDF with default settings.

All keys of a robot's file but ``urdf`` are optional::

    description = "one line"
    urdf = "panda_description/urdf/panda.urdf"  # beside the file, or in example-robot-data
    base_rpy_deg = [25, 15, 0]                  # tilt of the base
    moving = ["*"]                              # shell patterns of the joints that move
    [locked]                                    # shell pattern = position [rad or m]
    "panda_finger_joint*" = 0.0                 # (or a list of patterns: locked = ["..."])
    [skin]
    sus_per_segment = 1
    sus_on_base = 1
    distance = [0.04, 0.08]                     # from the middle of the segment [m]
    [[skin.su]]                                 # an SU with a given place
    link = "panda_link7"
    xyz = [0.05, 0.0, 0.1]                      # [m]
    rpy_deg = [0, 90, 0]
    [motion]                                    # any field of `MotionSettings`
    frequency = 2.0
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from importlib.metadata import PackageNotFoundError, distribution
from math import radians
from pathlib import Path
from types import MappingProxyType
from typing import Any

from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.simulation.motion_settings import MotionSettings

Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class GivenSu:
    """An SU whose place is given instead of drawn at random.

    Attributes:
        link: the URDF link it sits on.
        xyz: its position in the link's frame [m].
        rpy: its roll, pitch, yaw in the link's frame [rad].
    """

    link: str
    xyz: Vector3
    rpy: Vector3


@dataclass(frozen=True)
class SkinLayout:
    """How many SUs sit where.

    Attributes:
        sus_per_segment: SUs at random places on every moving segment.
        sus_on_base: SUs at random places on the reference segment.
        distance: nearest and farthest an SU lies from the middle of its segment [m].
        given: SUs with a given place, in addition to the random ones.
    """

    sus_per_segment: int = 1
    sus_on_base: int = 1
    distance: tuple[float, float] = (0.04, 0.08)
    given: tuple[GivenSu, ...] = ()


@dataclass(frozen=True)
class RobotSpec:
    """A robot, what of it moves, and what it carries.

    Attributes:
        name: its name in messages.
        urdf: path of the URDF.
        description: one line about the robot.
        moving: shell patterns of the joints that move; ``("*",)`` for all that can.
        locked: shell pattern of joint names -> position to lock them at [rad or m], None for the
            neutral position clipped into the limits; takes precedence over ``moving``.
        base_rpy: roll, pitch, yaw of the base in the world [rad].
        skin: the SUs.
        motion: shape of the motion.
    """

    name: str
    urdf: Path
    description: str = ""
    moving: tuple[str, ...] = ("*",)
    locked: Mapping[str, float | None] = field(default_factory=lambda: MappingProxyType({}))
    base_rpy: Vector3 = (radians(25.0), radians(15.0), 0.0)
    skin: SkinLayout = SkinLayout()
    motion: MotionSettings = field(default_factory=MotionSettings)


def robot_names() -> tuple[str, ...]:
    """Names that `load_robot` knows, sorted."""
    return tuple(sorted(path.stem for path in _robots_folder().glob("*.toml")))


def load_robot(name_or_path: str | Path) -> RobotSpec:
    """Find a robot by its name, by the path of its TOML file, or by the path of its URDF.

    Args:
        name_or_path: a name of `robot_names`, or a path that ends in ``.toml`` or ``.urdf``.

    Returns:
        The robot; default settings for a bare URDF.

    Raises:
        UsageError: no such robot or file.
        UnreadableInputError: the TOML file does not say what a robot's file should.
    """
    text = str(name_or_path)
    path = Path(text)
    if path.suffix.lower() == ".urdf" or (path.is_file() and path.suffix.lower() == ".xml"):
        return RobotSpec(name=path.stem, urdf=_existing(path))
    if path.suffix.lower() == ".toml":
        return _from_toml(_existing(path))
    if text not in robot_names():
        near = get_close_matches(text, robot_names(), n=1)
        guess = f"did you mean {near[0]}? Else " if near else ""
        raise UsageError(
            f'no robot is named "{text}"',
            f"{guess}use the path of a .urdf file, or one of: {', '.join(robot_names())}",
            text,
        )
    return _from_toml(_robots_folder() / f"{text}.toml")


def example_robot_data() -> Path:
    """Folder of the URDFs of the package example-robot-data.

    Raises:
        UsageError: the package is not installed.
    """
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError as error:
        raise UsageError(
            "the package example-robot-data is not installed",
            "pip install example-robot-data, or give the path of a URDF",
        ) from error
    return Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots")))


def _robots_folder() -> Path:
    """Where the TOML files are: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "robots"
    return inside if inside.is_dir() else package.parent / "robots"


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise UsageError(f"{path}: no such file", "check the path", str(path))
    return path


def _from_toml(path: Path) -> RobotSpec:
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
        return _spec(path, data)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, KeyError, TypeError, ValueError) as error:
        raise UnreadableInputError(
            str(path),
            f"not a robot's file: {error}",
            "compare with the files in the folder robots/",
        ) from error


def _spec(path: Path, data: dict[str, Any]) -> RobotSpec:
    """Build a `RobotSpec` from a parsed TOML file.

    Raises:
        KeyError, TypeError, ValueError: a key is missing, unknown, or of the wrong shape.
    """
    known = {"description", "urdf", "moving", "locked", "base_rpy_deg", "skin", "motion"}
    _refuse_unknown("the file", set(data), known)
    urdf = Path(data["urdf"])
    candidates = [urdf, path.parent / urdf, example_robot_data() / urdf]
    found = next((c for c in candidates[not urdf.is_absolute() :] if c.is_file()), None)
    if found is None:
        raise ValueError(f"urdf {urdf} is neither beside the file nor in example-robot-data")
    default = RobotSpec(name=path.stem, urdf=found)
    locked = data.get("locked", {})
    if isinstance(locked, list):
        locked = dict.fromkeys(locked)
    return RobotSpec(
        name=path.stem,
        urdf=found,
        description=str(data.get("description", "")),
        moving=_strings(data.get("moving", default.moving)),
        locked=MappingProxyType({k: None if v is None else float(v) for k, v in locked.items()}),
        base_rpy=_radians(data["base_rpy_deg"]) if "base_rpy_deg" in data else default.base_rpy,
        skin=_skin(data.get("skin", {})),
        motion=_motion(data.get("motion", {})),
    )


def _skin(data: dict[str, Any]) -> SkinLayout:
    _refuse_unknown("[skin]", set(data), {"sus_per_segment", "sus_on_base", "distance", "su"})
    default = SkinLayout()
    return SkinLayout(
        sus_per_segment=int(data.get("sus_per_segment", default.sus_per_segment)),
        sus_on_base=int(data.get("sus_on_base", default.sus_on_base)),
        distance=_pair(data.get("distance", default.distance)),
        given=tuple(
            GivenSu(su["link"], _vector(su["xyz"]), _radians(su.get("rpy_deg", (0, 0, 0))))
            for su in data.get("su", [])
        ),
    )


def _motion(data: dict[str, Any]) -> MotionSettings:
    _refuse_unknown("[motion]", set(data), {f.name for f in fields(MotionSettings)})
    values: dict[str, Any] = {
        key: _pair(value) if isinstance(value, list) else float(value)
        for key, value in data.items()
    }
    return replace(MotionSettings(), **values)


def _refuse_unknown(where: str, keys: set[str], known: set[str]) -> None:
    if keys - known:
        raise ValueError(
            f"{where} has unknown keys {', '.join(sorted(keys - known))}; "
            f"known are {', '.join(sorted(known))}"
        )


def _strings(values: Any) -> tuple[str, ...]:
    if isinstance(values, str):
        raise TypeError(f'"{values}" should be a list of names')
    return tuple(str(value) for value in values)


def _pair(values: Any) -> tuple[float, float]:
    low, high = (float(v) for v in values)
    return low, high


def _vector(values: Any) -> Vector3:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _radians(degrees: Any) -> Vector3:
    roll, pitch, yaw = (radians(v) for v in _vector(degrees))
    return roll, pitch, yaw
