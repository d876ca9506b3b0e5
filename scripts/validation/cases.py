"""What is validated: one case per robot, seed and circumstance, with a key that names it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

from skin2urdf.errors import UsageError
from skin2urdf.simulation import GRADES, PLANTS, robot_names
from skin2urdf.simulation.robots import example_robot_data

Posture = Literal["tilted", "upright"]
Excitation = Literal["one", "all"]
Refinement = Literal["none", "casadi"]

ALL_ROBOTS = "all"
"""Every robot that has a file in robots/."""
ALL_URDFS = "urdfs"
"""Every URDF of the package example-robot-data in which a joint can move."""


@dataclass(frozen=True)
class Circumstance:
    """All of a case that is neither the robot nor the seed.

    Attributes:
        grade: sensor grade.
        posture: base tilted as the robot's file says, or upright.
        excite: one DoF after the other, or all at once.
        poses: number of poses.
        encoder_bits: resolution of the encoders; None for exact ones.
        tracking: how joints follow their reference.
        refine: last step of the estimation.
        through_mcap: write the recording into an MCAP file and read it back.
    """

    grade: str = "mems"
    posture: Posture = "tilted"
    excite: Excitation = "one"
    poses: int = 12
    encoder_bits: int | None = 17
    tracking: str = "servo"
    refine: Refinement = "none"
    through_mcap: bool = False

    @property
    def words(self) -> tuple[str, ...]:
        """What makes it different from others, in words that stand in a key."""
        bits = "exact" if self.encoder_bits is None else f"{self.encoder_bits}bit"
        words = (self.grade, self.posture, self.excite, f"{self.poses}poses", bits, self.tracking)
        extras = ((self.refine, self.refine != "none"), ("mcap", self.through_mcap))
        return (*words, *(word for word, given in extras if given))


@dataclass(frozen=True)
class Case:
    """One run: a robot, a seed, and everything else.

    Attributes:
        robot: name in robots/, path of a URDF, or path inside example-robot-data.
        seed: seed of the recording.
        circumstance: everything else.
    """

    robot: str
    seed: int
    circumstance: Circumstance

    @property
    def key(self) -> str:
        """Names the case; the same case has the same key on every machine."""
        return " ".join((self.robot, *self.circumstance.words, f"seed{self.seed}"))

    @property
    def robot_or_path(self) -> str:
        """What `skin2urdf.simulation.load_robot` takes."""
        inside = example_robot_data() / self.robot
        return str(inside) if self.robot.endswith(".urdf") and inside.is_file() else self.robot


def robots_named(names: Iterable[str]) -> tuple[str, ...]:
    """Robots, with `all` and `urdfs` replaced by what they stand for.

    Raises:
        UsageError: no such robot.
    """
    found: list[str] = []
    for name in names:
        if name == ALL_ROBOTS:
            found += robot_names()
        elif name == ALL_URDFS:
            folder = example_robot_data()
            moving = filter(_can_move, folder.rglob("*.urdf"))
            found += sorted(path.relative_to(folder).as_posix() for path in moving)
        else:
            found.append(name)
    for name in found:
        files = (Path(name), example_robot_data() / name)
        if name not in robot_names() and not any(path.is_file() for path in files):
            raise UsageError(
                f'no robot is named "{name}"',
                f"use {ALL_ROBOTS}, {ALL_URDFS}, the path of a URDF (its own or inside "
                f"example-robot-data), or names out of: {', '.join(robot_names())}",
            )
    return tuple(dict.fromkeys(found))


def _can_move(urdf: Path) -> bool:
    """Whether a URDF has a joint that is not fixed; three of the package have none."""
    joints = ET.parse(urdf).getroot().findall("joint")  # noqa: S314 - files of a package
    return any(joint.get("type") in ("revolute", "continuous", "prismatic") for joint in joints)


def circumstances(
    grades: Sequence[str], postures: Sequence[Posture], excitations: Sequence[Excitation]
) -> Iterator[tuple[str, Posture, Excitation]]:
    """Every combination, with its grade checked.

    Raises:
        UsageError: no such grade.
    """
    for grade in grades:
        if grade not in GRADES:
            raise UsageError(f'no grade is named "{grade}"', f"use one of: {', '.join(GRADES)}")
    yield from product(grades, postures, excitations)


TRACKINGS = tuple(PLANTS)
"""Names of how joints can follow their reference."""
