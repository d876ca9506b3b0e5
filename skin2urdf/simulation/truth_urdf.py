"""The truth as a URDF: the original kinematics with locked joints baked in and the SUs on it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from math import atan2, cos, hypot, sin

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.simulation.mechanism import Mechanism
from skin2urdf.simulation.skins import PlacedSu

_JOINT_PARTS = ("origin", "parent", "child")
_MOVING_PARTS = ("axis", "limit", "dynamics")


def truth_urdf(original: ET.Element, mechanism: Mechanism, sus: Sequence[PlacedSu]) -> str:
    """Write the URDF of a simulated robot with its SUs.

    Links keep their names and inertias and lose visuals and collisions, so that the text loads
    without any other file. Locked joints become fixed joints with their position in the origin.
    Every SU is a link of its name on a fixed joint. Numbers keep full precision.

    Args:
        original: the parsed original URDF.
        mechanism: what of it moves.
        sus: the SUs.

    Returns:
        The URDF.
    """
    robot = ET.Element("robot", name=original.get("name", "robot"))
    for link in original.findall("link"):
        copy = ET.SubElement(robot, "link", name=str(link.get("name")))
        copy.extend(link.findall("inertial"))
    for joint in original.findall("joint"):
        _copy_joint(robot, joint, mechanism)
    for su in sus:
        _add_su(robot, su)
    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def _copy_joint(robot: ET.Element, joint: ET.Element, mechanism: Mechanism) -> None:
    name = str(joint.get("name"))
    moving = name in mechanism.joint_names
    copy = ET.SubElement(robot, "joint", name=name, type=str(joint.get("type")))
    parts = (*_JOINT_PARTS, *(_MOVING_PARTS if moving else ()))
    copy.extend(part for part in joint if part.tag in parts)
    if moving:
        return
    copy.set("type", "fixed")
    position = mechanism.locked.get(name, 0.0)
    if position != 0.0:
        T = origin_placement(joint.find("origin")) @ _joint_transform(joint, position)
        if (old := copy.find("origin")) is not None:
            copy.remove(old)
        copy.insert(0, origin_element(T))


def _add_su(robot: ET.Element, su: PlacedSu) -> None:
    ET.SubElement(robot, "link", name=su.name)
    joint = ET.SubElement(robot, "joint", name=f"{su.name}_joint", type="fixed")
    joint.append(origin_element(su.T_link_su))
    ET.SubElement(joint, "parent", link=su.link)
    ET.SubElement(joint, "child", link=su.name)


def origin_placement(element: ET.Element | None) -> F64:
    """(4, 4) transform of an origin element; identity where there is none."""
    T = np.eye(4)
    if element is not None:
        T[:3, 3] = _numbers(element.get("xyz", "0 0 0"))
        roll, pitch, yaw = _numbers(element.get("rpy", "0 0 0"))
        T[:3, :3] = (
            _rotation((0, 0, 1), yaw) @ _rotation((0, 1, 0), pitch) @ _rotation((1, 0, 0), roll)
        )
    return T


def _joint_transform(joint: ET.Element, position: float) -> F64:
    """(4, 4) transform of a joint's child link at a position."""
    element = joint.find("axis")
    axis = _numbers(element.get("xyz", "1 0 0") if element is not None else "1 0 0")
    axis = axis / np.linalg.norm(axis)
    T = np.eye(4)
    if joint.get("type") == "prismatic":
        T[:3, 3] = position * axis
    else:
        T[:3, :3] = _rotation(axis, position)
    return T


def _rotation(axis: Iterable[float], angle: float) -> F64:
    """(3, 3) rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + sin(angle) * K + (1.0 - cos(angle)) * (K @ K))


def origin_element(T: F64) -> ET.Element:
    """Origin element of a (4, 4) transform."""
    return ET.Element("origin", xyz=_text(T[:3, 3]), rpy=_text(_rpy(T[:3, :3])))


def _rpy(R: F64) -> tuple[float, float, float]:
    """Roll, pitch, yaw of a rotation, exact also where the pitch is +-90 degrees."""
    yaw = atan2(R[1, 0], R[0, 0])
    pitch = atan2(-R[2, 0], hypot(R[0, 0], R[1, 0]))
    # Undoing the yaw first leaves a rotation whose roll is well defined whatever the pitch.
    c, s = cos(yaw), sin(yaw)
    roll = atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return roll, pitch, yaw


def _numbers(text: str) -> F64:
    return np.array([float(word) for word in text.split()])


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
