"""From a Pinocchio model to placements with z axes, as estimation has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.geometry.se3 import inverse, placement
from skin2urdf.model.records import KinematicModel
from skin2urdf.structure.records import JointType, KinematicTree

_BESIDE = 0.06
"""How far an SU whose place is not given is taken to be from the middle of its segment [m]: about
the radius of a robot's link."""


@dataclass(frozen=True, eq=False)
class PlacedSu(Record):
    """An SU on a robot.

    Attributes:
        name: its name.
        joint: the last joint before it; -1 for the base.
        T_joint_su: (4, 4) its frame in the joint's (in the base frame on the base) [m].
    """

    name: str
    joint: int
    T_joint_su: F64


def usual_sus(model: Any, parent: Sequence[int]) -> tuple[PlacedSu, ...]:
    """One SU on the base and on every moving segment, where SUs usually are.

    Each sits beside the middle of its segment: between its joint and the joints that it carries, or
    at its center of mass at the end of a chain.

    Args:
        model: ``pinocchio.Model`` of D joints.
        parent: (D,) joint before each joint, -1 for the base.
    """
    aside = np.full(3, _BESIDE / np.sqrt(3.0))
    out = []
    for joint in range(-1, len(parent)):
        children = [c for c, p in enumerate(parent) if p == joint]
        if children:
            origins = [np.array(model.jointPlacements[c + 1].translation) for c in children]
            middle = 0.5 * np.mean(origins, axis=0)
        else:
            middle = np.array(model.inertias[joint + 1].lever)
        name = "base" if joint < 0 else str(model.names[joint + 1])
        out.append(PlacedSu(f"SU beyond {name}", joint, placement(np.eye(3), middle + aside)))
    return tuple(out)


def sus_on_links(model: Any, links: Sequence[str]) -> tuple[PlacedSu, ...]:
    """SUs that are links of the URDF.

    Args:
        model: ``pinocchio.Model``.
        links: their names.
    """
    frames = [model.frames[model.getBodyId(link)] for link in links]
    return tuple(
        PlacedSu(link, int(frame.parentJoint) - 1, np.array(frame.placement.homogeneous))
        for link, frame in zip(links, frames, strict=True)
    )


def kinematic_model(
    model: Any,
    prismatic: Sequence[bool],
    R_world_base: F64,
    sus: Sequence[PlacedSu],
) -> KinematicModel:
    """Placements of joints that turn about their z axes, in a base frame that stands upright.

    Args:
        model: ``pinocchio.Model`` of D joints of one DoF.
        prismatic: (D,) True where a joint slides.
        R_world_base: (3, 3) how the base stands in the world, whose z axis is up.
        sus: U SUs.
    """
    parent = [int(p) - 1 for p in list(model.parents)[1:]]
    turn = [_to_axis(model.joints[j + 1]) for j in range(len(parent))]
    root = placement(R_world_base, np.zeros(3))
    T = np.empty((len(parent), 4, 4))
    for j, p in enumerate(parent):
        before = root if p < 0 else inverse(turn[p])
        T[j] = before @ np.array(model.jointPlacements[j + 1].homogeneous) @ turn[j]
    types: list[JointType] = ["prismatic" if slides else "revolute" for slides in prismatic]
    tree = KinematicTree(
        tuple(str(name) for name in list(model.names)[1:]),
        np.array(parent, dtype=np.int64),
        tuple(types),
        tuple(su.name for su in sus),
        np.array([su.joint for su in sus], dtype=np.int64),
    )
    on = [(root if su.joint < 0 else inverse(turn[su.joint])) @ su.T_joint_su for su in sus]
    return KinematicModel(tree, T, np.reshape(on, (-1, 4, 4)))


def _to_axis(joint: Any) -> F64:
    """(4, 4) rotation of a joint's frame that turns its z axis onto the joint's axis."""
    data = joint.createData()
    q = np.zeros(joint.nq)
    q[0] = float(joint.nq == 2)  # cosine and sine of a joint without end
    joint.calc(data, q)
    S = np.asarray(data.S).ravel()
    axis = S[:3] if np.linalg.norm(S[:3]) > np.linalg.norm(S[3:]) else S[3:]
    z = axis / np.linalg.norm(axis)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    return placement(np.column_stack([x, np.cross(z, x), z]), np.zeros(3))
