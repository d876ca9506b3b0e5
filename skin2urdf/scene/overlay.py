"""Another robot, such as the truth or a vendor's model, and an estimate laid onto it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import InsufficientDataError, UsageError
from skin2urdf.scene.robot import BASE, Segment, placed, segments
from skin2urdf.urdf.compare import compare, load_determined, load_open, load_unobservable
from skin2urdf.urdf.kinematics import kinematics
from skin2urdf.urdf.loading import Robot
from skin2urdf.urdf.records import Comparison

_CONFIGURATIONS = 200
"""As many as ``skin2urdf compare`` takes."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """Another robot, and where an estimate's limbs belong in its base frame.

    Attributes:
        robot: the other robot.
        comparison: the estimate against it; None where nothing can be compared.
        why: why not, in words.
    """

    robot: Robot
    comparison: Comparison | None
    why: str = ""

    def limb(self, chain: tuple[str, ...]) -> F64:
        """(4, 4) T_other_estimate of the limb that a chain of the estimate's joints belongs to.

        What belongs to no limb that could be aligned, as the base, stands with the first one.
        """
        found = self.comparison.alignments if self.comparison else ()
        by_limb = {each.limb: each.T_truth_estimate for each in found}
        for name in (None, *chain, *by_limb):
            if name in by_limb:
                return by_limb[name]
        return np.eye(4)


def overlay(estimate: Path, other: Robot, beside: Path | None) -> Overlay:
    """Lay an estimate onto another robot.

    Args:
        estimate: the estimate's URDF.
        other: the other robot.
        beside: the estimate's JSON, which tells what the log leaves open; None without one.
    """
    try:
        comparison = compare(
            estimate,
            other.path,
            unobservable=load_unobservable(beside) if beside else None,
            anchors=load_determined(beside) if beside else None,
            open_directions=load_open(beside) if beside else (),
            n_configurations=_CONFIGURATIONS,
            rng=np.random.default_rng(0),
        )
    except (InsufficientDataError, UsageError) as error:
        return Overlay(other, None, str(error))
    return Overlay(other, comparison)


def alongside(
    other: Robot, positions: Mapping[str, float], frames: Mapping[str, F64]
) -> list[tuple[Segment, F64]]:
    """The segments of another robot, with joints where an estimate has them on the same axes.

    Where on its axis a joint's frame sits is a choice of whoever writes a URDF. So each joint is
    moved along its axis to where it is next to the estimate's, and what still differs is an error.

    Args:
        other: the other robot.
        positions: of the joints [rad or m].
        frames: (4, 4) the estimate's joints and SUs in the other's base frame, by name.

    Returns:
        Segments with their (4, 4) frames in the other's base frame.
    """
    own = placed(other, positions)
    names = [name for name in other.joint_types if name in frames]
    at = np.array([[positions.get(name, 0.0) for name in names]])
    axes = kinematics(other, [], names, at)[1][0]
    points = {name: T[:3, 3] for name, T in own.items()}
    for name, axis in zip(names, axes, strict=True):
        there = frames[name][:3, 3]
        if other.joint_types[name] == "prismatic":
            points[name] = there  # it has a direction only
            continue
        w = axis[3:] / np.linalg.norm(axis[3:])
        points[name] = points[name] + w * (w @ (there - points[name]))
    parts = segments(other, [name for name in other.fixed_leaves if name in frames])
    found = []
    for part in parts:
        here = np.eye(4)
        here[:3, 3] = points[part.joint]
        after = [p.joint for p in parts if p.parent == part.joint and p.joint != BASE]
        children = [points[name] - points[part.joint] for name in after]
        back = np.linalg.inv(here) @ own[part.joint]
        sus = {name: back @ T for name, T in part.sus.items()}
        moved = Segment(part.joint, part.parent, np.array(children).reshape(-1, 3), sus)
        found.append((moved, here))
    return found
