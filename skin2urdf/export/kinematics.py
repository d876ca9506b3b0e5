"""Kinematics YAML as the descriptions of UR, Franka and Flexiv robots read it.

All three have one placement (x, y, z, roll, pitch, yaw) per joint, in other tables and under other
names: ``kinematics: {shoulder: {..}}`` in ur_description, ``joint1: {kinematic: {..}}`` in
franka_description, ``kinematics: {joint1: {..}}`` in flexiv_description. Axes are none of these
numbers: the descriptions of UR and Franka turn every joint about z, Flexiv's the even ones about y.
A link whose joint turns about another axis in the URDF gets a frame that is turned with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any, Literal

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import UsageError
from skin2urdf.export.source import Source, UrdfJoint
from skin2urdf.export.yaml_text import yaml_text
from skin2urdf.geometry.se3 import inverse, placement
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.urdf.rpy import rpy_of_rotation

Style = Literal["ur", "franka", "flexiv"]
STYLES: tuple[Style, ...] = ("ur", "franka", "flexiv")

_Y, _Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_AXES: dict[Style, tuple[tuple[float, float, float], ...]] = {
    "ur": (_Z,), "franka": (_Z,), "flexiv": (_Z, _Y)
}  # fmt: skip
"""Axes of the descriptions' joints in their frames, in turns."""
_UR = {
    "shoulder_pan_joint": "shoulder",
    "shoulder_lift_joint": "upper_arm",
    "elbow_joint": "forearm",
    "wrist_1_joint": "wrist_1",
    "wrist_2_joint": "wrist_2",
    "wrist_3_joint": "wrist_3",
}
"""Entries of ur_description by the joints they place."""


def to_kinematics(source: Source, style: Style | None = None) -> str:
    """Placements of the joints as YAML.

    Args:
        source: what to export; one arm without branches.
        style: whose description reads it; by the joints' names where None, else Flexiv's.

    Returns:
        The text of the file.

    Raises:
        UsageError: the robot is no single chain of joints, or none that the style is for.
    """
    joints = _chain(source)
    style = style or _style_of(joints)
    turns = _turns(joints, style)
    turned = [
        j.name for j, R in zip(joints, turns, strict=True) if not np.array_equal(R, np.eye(3))
    ]
    fit = (
        f"frames behind {', '.join(turned)} are turned, since the description's joints have other "
        "axes than that URDF's: neither meshes, tools nor SUs of that URDF fit these links"
        if turned
        else "frames are those of that URDF; meshes and tools of a vendor's description fit these "
        "where it was calibrated on the vendor's model"
    )
    comments = [
        *source.made_from,
        f"joints of {source.path.name} in their order: {', '.join(j.name for j in joints)}",
        fit,
    ]
    placed = [_numbers(T) for T in _placements(source, joints, turns)]
    table: dict[str, Any]
    if style == "ur":
        table = {
            "kinematics": {**_as_ur(joints, placed), "hash": f"skin2urdf_{source.digest[:16]}"}
        }
        comments.append(
            "the driver reports that the hash differs from the controller's: this calibration is "
            "not the controller's own"
        )
    elif style == "franka":
        table = {f"joint{n}": {"kinematic": each} for n, each in enumerate(placed, start=1)}
        comments.append(
            f"joint{len(joints) + 1}, the flange, is no joint: keep the description's entry"
        )
    else:
        table = {"kinematics": {f"joint{n}": each for n, each in enumerate(placed, start=1)}}
    return yaml_text(table, comments)


def _chain(source: Source) -> tuple[UrdfJoint, ...]:
    """The movable joints of an arm."""
    joints = source.movable
    for before, joint in zip((None, *joints), joints, strict=False):
        path = [j for j in source.path_to(joint.parent) if j in joints]
        if (path[-1] if path else None) is not before:
            raise UsageError(
                f"{source.path} is no single chain of joints: {joint.name} does not come after "
                f"{before.name if before else 'the base'}",
                "kinematics files hold one arm; take the limb of interest from the URDF",
            )
    if not joints:
        raise UsageError(f"{source.path} has no joint that moves", "give the URDF of an arm")
    return joints


def _style_of(joints: tuple[UrdfJoint, ...]) -> Style:
    """Whose description has joints of these names."""
    if all(any(joint.name.endswith(name) for name in _UR) for joint in joints):
        return "ur"
    if any(word in joint.name for joint in joints for word in ("fr3", "fer", "panda", "franka")):
        return "franka"
    return "flexiv"


def _turns(joints: Sequence[UrdfJoint], style: Style) -> list[F64]:
    """(3, 3) of each joint, from the description's frame of its link to the URDF's."""
    return [
        frame_with_z(joint.axis) @ frame_with_z(np.array(axis)).T
        for joint, axis in zip(joints, cycle(_AXES[style]), strict=False)
    ]


def _placements(source: Source, joints: Sequence[UrdfJoint], turns: Sequence[F64]) -> list[F64]:
    """(4, 4) of each joint in the frame of the link before, as the description has these frames.

    What is fixed between two joints belongs to the second one.
    """
    out, before, R_before = [], joints[0].parent, np.eye(3)
    for joint, R in zip(joints, turns, strict=True):
        T = inverse(placement(R_before, np.zeros(3)))
        for each in source.path_to(joint.child)[len(source.path_to(before)) :]:
            T = T @ each.T_parent_child
        out.append(T @ placement(R, np.zeros(3)))
        before, R_before = joint.child, R
    return out


def _as_ur(
    joints: tuple[UrdfJoint, ...], placed: Sequence[dict[str, float]]
) -> dict[str, dict[str, float]]:
    """Entries as ur_description names them, by the joints' names, else by their order."""
    if len(joints) != len(_UR):
        raise UsageError(
            f"UR's kinematics have {len(_UR)} joints, and this robot has {len(joints)}",
            f"choose another --style: {', '.join(STYLES[1:])}",
        )
    named = {
        entry: joint for name, entry in _UR.items() for joint in joints if joint.name.endswith(name)
    }
    if list(named.values()) != list(joints):
        named = dict(zip(_UR.values(), joints, strict=True))
    by_name = {joint.name: each for joint, each in zip(joints, placed, strict=True)}
    return {entry: by_name[joint.name] for entry, joint in named.items()}


def _numbers(T: F64) -> dict[str, float]:
    """x, y, z, roll, pitch, yaw of a placement."""
    values = map(float, (*T[:3, 3] + 0.0, *rpy_of_rotation(T[:3, :3]) + 0.0))
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), values, strict=True))
