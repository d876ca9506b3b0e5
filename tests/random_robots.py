"""Robots that are in no repository: random trees, and chains of alike joints, as URDFs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from drawn.trees import Joint, random_joints, robot_of

from skin2urdf.simulation import RobotSpec

__all__ = ["Joint", "chain", "random_joints", "robot_of", "small_arm"]


def chain(n: int, *, turns: float = 0.0, **every: object) -> tuple[Joint, ...]:
    """A chain of alike joints, each turned by +-``turns`` about x against the one before [rad]."""
    joints = (
        Joint(f"j{d}", d - 1, "revolute", rpy=((-1.0) ** d * turns, 0.0, 0.3)) for d in range(n)
    )
    return tuple(replace(joint, **every) for joint in joints)  # type: ignore[arg-type]


@cache
def small_arm(n_joints: int) -> RobotSpec:
    """An arm without a parallel axis, an SU on every segment: the least that calibrates well."""
    return robot_of(chain(n_joints, turns=1.4), Path(mkdtemp()))
