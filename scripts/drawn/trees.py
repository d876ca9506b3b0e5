"""Robots that are in no repository: random trees of joints as URDFs.

Axes are drawn in URDF's own terms (origin, roll-pitch-yaw, axis), never in those of the package:
parallel, intersecting and square neighbours as well as skew ones, ranges from half a radian,
continuous and prismatic joints, branches anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.simulation import RobotSpec
from skin2urdf.simulation.robots import SkinLayout

Vector = tuple[float, ...]


@dataclass(frozen=True)
class Joint:
    """A joint and the link it carries, ``link_`` and the joint's name.

    Attributes:
        name: its name.
        parent: index of the joint before it, -1 for the base.
        kind: revolute, continuous or prismatic.
        xyz: origin in the parent link [m].
        rpy: orientation there [rad].
        axis: unit vector in the joint's own frame.
        limits: lowest and highest position [rad or m].
    """

    name: str
    parent: int
    kind: str
    xyz: Vector = (0.02, 0.03, 0.25)
    rpy: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    limits: tuple[float, float] = (-2.0, 2.0)


def random_joints(rng: np.random.Generator, n: int) -> tuple[Joint, ...]:
    """A random tree of n joints."""
    return tuple(_random_joint(rng, d) for d in range(n))


def _random_joint(rng: np.random.Generator, d: int) -> Joint:
    parent = int(rng.integers(-1, d)) if d and rng.random() < 0.3 else d - 1
    kind = rng.choice(["revolute", "continuous", "prismatic"], p=[0.65, 0.15, 0.2])
    xyz: F64 = np.asarray(rng.uniform([-0.15, -0.15, 0.0], [0.15, 0.15, 0.3]))
    rpy = np.asarray(rng.uniform(-np.pi, np.pi, 3))
    if rng.random() < 0.5:
        rpy = np.asarray(np.pi / 2 * rng.integers(-1, 3, 3))
        xyz = np.asarray(xyz * rng.choice([[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 1, 1]]))
    axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.7 else rng.standard_normal(3)
    span = rng.uniform(0.15, 0.5) if kind == "prismatic" else rng.choice([0.5, 1.0, 2.5, 4.0])
    middle = rng.uniform(-0.2, 0.2) if kind == "prismatic" else rng.uniform(-1.0, 1.0)
    return Joint(
        f"m{rng.integers(1000):03d}_{d}", parent, str(kind), tuple(xyz), tuple(rpy),
        tuple(axis / np.linalg.norm(axis)), (middle - span / 2, middle + span / 2),
    )  # fmt: skip


def robot_of(joints: tuple[Joint, ...], folder: Path, skin: SkinLayout | None = None) -> RobotSpec:
    """Joints as a URDF on disk, ready to be simulated."""
    parts = ['<robot name="robot"><link name="base"/>']
    for joint in joints:
        parent = f"link_{joints[joint.parent].name}" if joint.parent >= 0 else "base"
        limits = (
            "" if joint.kind == "continuous" else 'lower="{}" upper="{}" '.format(*joint.limits)
        )
        speed = 0.6 if joint.kind == "prismatic" else 3.0
        parts.append(
            f'<link name="link_{joint.name}"><inertial>'
            '<origin xyz="0.02 0.03 0.1"/><mass value="1"/>'
            '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>'
            f'<joint name="{joint.name}" type="{joint.kind}">'
            f'<origin xyz="{_text(joint.xyz)}" rpy="{_text(joint.rpy)}"/>'
            f'<parent link="{parent}"/><child link="link_{joint.name}"/>'
            f'<axis xyz="{_text(joint.axis)}"/><limit {limits}effort="100" velocity="{speed}"/>'
            "</joint>"
        )
    path = folder / "robot.urdf"
    path.write_text("".join([*parts, "</robot>"]), encoding="utf-8")
    return RobotSpec("robot", path, skin=skin or SkinLayout())


def _text(values: Vector) -> str:
    return " ".join(repr(float(v)) for v in values)
