"""A model and logs brought together: joints by name, in the frames that the estimation works in.

The estimation turns every joint about the z axis of its frame, at the position that its encoder
says. A URDF's joint turns about any axis of its origin's frame; the two differ by a constant turn,
which is kept, so that what is found goes back into the vendor's own frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.errors import ModelMismatchError
from skin2urdf.geometry.se3 import inverse, placement, screw
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.signals.trajectory import Trajectory, in_order
from skin2urdf.structure.records import JointType, KinematicTree
from skin2urdf.vendor.description import Description, ModelJoint


@dataclass(frozen=True, eq=False)
class Chassis(Record):
    """The joints of a model that the logs may move, as the estimation sees them.

    Attributes:
        description: the model.
        joints: D joints of it, parents first.
        parent: (D,) index of the joint before each, -1 for the base.
        T_parent_joint: (D, 4, 4) placements, z along the axis [m].
        T_before: (D, 4, 4) from the frame of the joint before to the link that the joint hangs on.
        T_origin_joint: (D, 4, 4) the estimation's frame in that of the URDF's origin, at the
            position that counts as 0.
        R_link_joint: (D, 3, 3) the estimation's frame in that of the link that the joint carries.
        measured: (D,) index of the log's joint that each follows; -1 where no log has it.
        factor: (D,) its motion over that joint's.
        extra: joints of the logs that the model lacks.
        absent: movable joints of the model that no log has, and the position that they are taken
            to be at [rad or m].
        carried: by link, the joint that carries it (-1 for the base), and (4, 4) the link's frame
            in the estimation's frame of that joint [m].
    """

    description: Description
    joints: tuple[ModelJoint, ...]
    parent: Int
    T_parent_joint: F64
    T_before: F64
    T_origin_joint: F64
    R_link_joint: F64
    measured: Int
    factor: F64
    extra: tuple[str, ...]
    absent: dict[str, float]
    carried: Mapping[str, tuple[int, F64]]

    @property
    def n_joints(self) -> int:
        """Number of joints D."""
        return len(self.joints)

    @property
    def joint_types(self) -> tuple[JointType, ...]:
        """D joint types."""
        return tuple(joint.joint_type for joint in self.joints)

    def link(self, joint: int) -> str:
        """The link that a joint carries; the root for -1."""
        return self.joints[joint].child if joint >= 0 else self.description.root

    def tree(self, su_names: Sequence[str], su_joint: Sequence[int] | Int) -> KinematicTree:
        """The kinematic tree with SUs on it.

        Args:
            su_names: U SU names.
            su_joint: (U,) the joint before each, -1 for the base.
        """
        names = tuple(joint.name for joint in self.joints)
        on = np.asarray(su_joint, dtype=np.int64)
        return KinematicTree(names, self.parent, self.joint_types, tuple(su_names), on)

    def along(self, log: Trajectory, sus: Int) -> Trajectory:
        """A trajectory in the order of the model's joints.

        Args:
            log: with the logs' joints.
            sus: (U,) which of its SUs, in which order.
        """
        there = np.maximum(self.measured, 0)
        found = in_order(log, there, sus)
        factor = np.where(self.measured >= 0, self.factor, 0.0)
        found = found.with_joints_times(factor)
        return replace(found, moving=found.moving & (factor != 0))

    def T_link_su(self, joint: int, T_joint_su: F64) -> F64:
        """(4, 4) an SU's frame in that of the link it sits on, from that in the joint's."""
        out = np.array(T_joint_su)
        if joint >= 0:
            out[:3] = self.R_link_joint[joint] @ T_joint_su[:3]
        return out

    def origins(self, T_parent_joint: F64) -> F64:
        """(D, 4, 4) origins of the URDF's joints for placements (D, 4, 4) of the estimation."""
        return np.asarray(inverse(self.T_before) @ T_parent_joint @ inverse(self.T_origin_joint))


def match(description: Description, logged: Sequence[str]) -> Chassis:
    """Match a model's joints with those of logs, by name.

    Args:
        description: the model.
        logged: names of the joints in the logs.

    Raises:
        ModelMismatchError: not one name is the same.
    """
    by_name = {joint.name: joint for joint in description.movable}
    sources = {name: _source(by_name, name, logged) for name in by_name}
    if all(column < 0 for column, _, _ in sources.values()):
        raise ModelMismatchError(
            f"{description.text.source}: no joint has the name of one in the log: the model has "
            f"{_some(by_name)}, the log {_some(logged)}",
            "give the model of this robot, or rename its joints as the driver does",
            joints=tuple(by_name),
        )
    kept = _kept(description, {name for name, (column, _, _) in sources.items() if column >= 0})
    index = {joint.name: j for j, joint in enumerate(kept)}
    carried: dict[str, tuple[int, F64]] = {description.root: (-1, np.eye(4))}
    parent, before, origin, R = [], [], [], []
    for joint in description.joints:
        above, T_above = carried[joint.parent]
        if joint.name not in index:
            T = T_above @ joint.T_parent_origin @ _moved(joint, _rest(joint, sources))
            carried[joint.child] = above, T
            continue
        turn = frame_with_z(joint.axis)
        parent.append(above)
        before.append(T_above)
        offset = _moved(joint, sources[joint.name][2])
        origin.append(offset @ placement(turn, np.zeros(3)))
        R.append(turn)
        carried[joint.child] = index[joint.name], placement(turn.T, np.zeros(3))
    D = len(kept)
    T_before, T_origin = np.reshape(before, (D, 4, 4)), np.reshape(origin, (D, 4, 4))
    given = np.reshape([joint.T_parent_origin for joint in kept], (D, 4, 4))
    followed = [sources[joint.name] for joint in kept]
    mimicked = {joint.mimic.leader for joint in description.movable if joint.mimic}
    return Chassis(
        description=description,
        joints=kept,
        parent=np.array(parent, dtype=np.int64),
        T_parent_joint=T_before @ given @ T_origin,
        T_before=T_before,
        T_origin_joint=T_origin,
        R_link_joint=np.reshape(R, (D, 3, 3)),
        measured=np.array([column for column, _, _ in followed], dtype=np.int64),
        factor=np.array([factor for _, factor, _ in followed]),
        extra=tuple(name for name in logged if name not in by_name and name not in mimicked),
        absent={name: at for name, (column, _, at) in sources.items() if column < 0},
        carried=carried,
    )


def _source(
    by_name: dict[str, ModelJoint], name: str, logged: Sequence[str]
) -> tuple[int, float, float]:
    """Column of the joint in the log that a joint follows, its factor, and its position at zero.

    The column is -1, and the position where the joint is taken to rest, where no log has it.
    """
    if name in logged:
        return list(logged).index(name), 1.0, 0.0
    joint = by_name[name]
    seen, factor, offset = {name}, 1.0, 0.0
    while joint.mimic is not None and joint.mimic.leader not in seen:
        seen.add(joint.mimic.leader)
        offset += factor * joint.mimic.offset
        factor *= joint.mimic.multiplier
        if joint.mimic.leader in logged:
            return list(logged).index(joint.mimic.leader), factor, offset
        if joint.mimic.leader not in by_name:
            break
        joint = by_name[joint.mimic.leader]
    low, high = by_name[name].limits
    return -1, 0.0, float(min(max(0.0, low), max(low, high)))


def _rest(joint: ModelJoint, sources: dict[str, tuple[int, float, float]]) -> float:
    """Where a joint that is no part of the tree is taken to be [rad or m]."""
    return sources[joint.name][2] if joint.name in sources else 0.0


def _moved(joint: ModelJoint, position: float) -> F64:
    """(4, 4) motion of a joint to a position, in the frame of its origin."""
    if not joint.moves or position == 0.0:
        return np.eye(4)
    turn = placement(frame_with_z(joint.axis), np.zeros(3))
    slides = joint.joint_type == "prismatic"
    along = screw("z", 0.0 if slides else position, position if slides else 0.0)
    return np.asarray(turn @ along @ inverse(turn))


def _kept(description: Description, named: set[str]) -> tuple[ModelJoint, ...]:
    """The joints that a log has, and those before them: what may turn something that is felt."""
    by_child = {joint.child: joint for joint in description.joints}
    keep: set[str] = set()
    for joint in description.movable:
        if joint.name not in named:
            continue
        above: ModelJoint | None = joint
        while above is not None:
            keep.add(above.name)
            above = by_child.get(above.parent)
    return tuple(joint for joint in description.movable if joint.name in keep)


def _some(names: Sequence[str] | dict[str, ModelJoint], most: int = 6) -> str:
    """The first names."""
    listed = list(names)
    more = len(listed) - most
    return ", ".join(listed[:most]) + (f" and {more} more" if more > 0 else "")
