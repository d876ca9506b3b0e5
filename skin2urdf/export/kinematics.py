"""Kinematics YAML as the descriptions of UR, Franka and Flexiv robots read it.

All three have one placement (x, y, z, roll, pitch, yaw) per joint, in other tables and under other
names: ``kinematics: {shoulder: {..}}`` in ur_description, ``joint1: {kinematic: {..}}`` in
franka_description, ``kinematics: {joint1: {..}}`` in flexiv_description.
"""

from __future__ import annotations

from typing import Any, Literal

from skin2urdf.errors import UsageError
from skin2urdf.export.source import Source, UrdfJoint
from skin2urdf.export.yaml_text import yaml_text

Style = Literal["ur", "franka", "flexiv"]
STYLES: tuple[Style, ...] = ("ur", "franka", "flexiv")

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
    comments = [
        *source.made_from,
        f"joints of {source.path.name} in their order: {', '.join(j.name for j in joints)}",
        "frames are those of that URDF; meshes and tools of a vendor's description fit these where "
        "it was calibrated on the vendor's model",
    ]
    table: dict[str, Any]
    if style == "ur":
        table = {"kinematics": {**_as_ur(joints), "hash": f"skin2urdf_{source.digest[:16]}"}}
        comments.append(
            "the driver reports that the hash differs from the controller's: this calibration is "
            "not the controller's own"
        )
    elif style == "franka":
        table = {f"joint{n}": {"kinematic": _numbers(j)} for n, j in enumerate(joints, start=1)}
        comments.append(
            f"joint{len(joints) + 1}, the flange, is no joint: keep the description's entry"
        )
    else:
        table = {
            "kinematics": {f"joint{n}": _numbers(joint) for n, joint in enumerate(joints, start=1)}
        }
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


def _as_ur(joints: tuple[UrdfJoint, ...]) -> dict[str, dict[str, float]]:
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
    return {entry: _numbers(joint) for entry, joint in named.items()}


def _numbers(joint: UrdfJoint) -> dict[str, float]:
    """x, y, z, roll, pitch, yaw of a joint's origin."""
    values = map(float, (*joint.xyz + 0.0, *joint.rpy + 0.0))
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), values, strict=True))
