"""A URDF as segments that can be placed in space, joint by joint."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.geometry.se3 import placement
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.scene.solids import Mesh, prism
from skin2urdf.urdf.loading import Robot, configuration

BASE = ""
"""Stands for the segment that no joint moves, where segments are named by their joints."""
_SMALLEST = 1e-4
"""Shorter links are not drawn [m]."""


@dataclass(frozen=True, eq=False)
class Segment(Record):
    """What one joint carries.

    Attributes:
        joint: the joint; :data:`BASE` for the segment that none moves.
        parent: the joint before it.
        children: (k, 3) where the joints after it sit, in this segment's frame [m].
        sus: (4, 4) frames of its SUs in its own frame, by name.
    """

    joint: str
    parent: str
    children: F64
    sus: Mapping[str, F64]


def segments(robot: Robot, sus: Collection[str] | None = None) -> tuple[Segment, ...]:
    """The segments of a robot, the base first.

    Args:
        robot: the robot.
        sus: links that are SUs; by default all links on fixed joints that carry nothing.
    """
    model = robot.model
    wanted = [name for name in robot.fixed_leaves if sus is None or name in sus]
    frames = {name: model.frames[robot.frame(name)] for name in wanted}
    found = []
    for joint in range(model.njoints):
        after = [j for j in range(1, model.njoints) if model.parents[j] == joint]
        points = [np.array(model.jointPlacements[j].translation) for j in after]
        carried = {
            name: np.array(frame.placement.homogeneous)
            for name, frame in frames.items()
            if frame.parentJoint == joint
        }
        before = model.parents[joint] if joint else 0
        found.append(
            Segment(
                model.names[joint] if joint else BASE,
                model.names[before] if before else BASE,
                np.array(points).reshape(-1, 3),
                carried,
            )
        )
    return tuple(found)


def placed(robot: Robot, positions: Mapping[str, float]) -> dict[str, F64]:
    """(4, 4) frames of all segments in the base frame, by joint.

    Args:
        robot: the robot.
        positions: of joints [rad or m]; those not named are neutral, others' are ignored.
    """
    import pinocchio as pin

    known = {name: x for name, x in positions.items() if name in robot.joint_types}
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, configuration(robot, known))
    names = [BASE, *list(robot.model.names)[1:]]
    return {
        name: np.array(T.homogeneous)
        for name, T in zip(names, list(data.oMi)[: len(names)], strict=True)
    }


def along_axes(robot: Robot, frames: Mapping[str, F64]) -> dict[str, F64]:
    """Frames of joints, turned about their origins so that z is along the joint's axis.

    Args:
        robot: the robot.
        frames: (4, 4) of its joints, by name; what is no joint of it is left out.
    """
    import pinocchio as pin

    model = robot.model
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    found = {}
    for joint in range(1, model.njoints):
        name, first = model.names[joint], model.idx_vs[joint]
        if name not in frames or model.nvs[joint] != 1:
            continue
        # Of a single joint the Jacobian is a vector.
        jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL).reshape(6, model.nv)
        twist = jacobian[:, first]
        axis = twist[3:] if np.linalg.norm(twist[3:]) > 0 else twist[:3]
        found[name] = frames[name] @ placement(frame_with_z(axis), np.zeros(3))
    return found


def thickness(parts: Collection[Segment]) -> float:
    """Radius of rods [m]: a twelfth of a typical distance between joints, 3 to 40 mm."""
    lengths = [
        float(np.linalg.norm(point))
        for part in parts
        for point in (*part.children, *(T[:3, 3] for T in part.sus.values()))
    ]
    visible = [length for length in lengths if length > _SMALLEST]
    return float(np.clip(np.median(visible) / 12, 0.003, 0.04)) if visible else 0.02


def rods(part: Segment, radius: float) -> list[Mesh]:
    """Rods from a joint to the joints after it, and thin ones to the SUs, in its frame."""
    meshes = [_rod(np.zeros(3), point, radius) for point in part.children]
    ends = [T[:3, 3] for T in part.sus.values()]
    meshes += [_rod(_nearest(end, part.children), end, 0.25 * radius) for end in ends]
    return [mesh for mesh in meshes if mesh is not None]


def drum(radius: float) -> Mesh:
    """The drum of a joint about its z axis, in its frame."""
    half = np.array([0.0, 0.0, 1.5 * radius])
    return prism(-half, half, 1.5 * radius)


def plate(T: F64, radius: float) -> Mesh:
    """The flat hexagon of an SU with frame (4, 4) T."""
    half = 0.2 * radius * T[:3, 2]
    return prism(T[:3, 3] - half, T[:3, 3] + half, 1.3 * radius, sides=6)


def _rod(begin: F64, end: F64, radius: float) -> Mesh | None:
    """A rod; None where there is no way to go."""
    return prism(begin, end, radius) if np.linalg.norm(end - begin) > _SMALLEST else None


def _nearest(point: F64, ends: F64) -> F64:
    """(3,) the point nearest to ``point`` on the lines from the origin to ``ends`` (n, 3) [m]."""
    square = np.maximum(np.sum(ends**2, axis=-1), _SMALLEST**2)
    along = np.clip(ends @ point / square, 0.0, 1.0)
    candidates = np.vstack([np.zeros((1, 3)), along[:, None] * ends])
    return np.asarray(candidates[np.argmin(np.linalg.norm(candidates - point, axis=-1))])
