"""From a kinematic model to the text of a URDF file.

Written with the standard library rather than with yourdfpy: near gimbal lock yourdfpy reads roll
and yaw off rounding noise, which turns a frame by up to 5e-4 rad at 1e-12 rad from it and by
0.06 rad at 1e-14, and it takes about a second to import.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.errors import BadFitError, UsageError
from skin2urdf.model.records import KinematicModel
from skin2urdf.urdf.limits import NOMINAL_VELOCITY, seen_limits
from skin2urdf.urdf.names import BASE_LINK, UrdfNames, comment, urdf_names
from skin2urdf.urdf.records import JointLimits, Remarks
from skin2urdf.urdf.rpy import rpy_of_rotation
from skin2urdf.urdf.visuals import COLOURS, Shape, link_shapes, su_shapes, thickness

NOMINAL_EFFORT = 1000.0
"""Effort limit [Nm or N]. URDF demands one, no log tells it: large enough not to bind."""

NOMINAL_MASS = 1.0
"""Mass of every moving link [kg]: MuJoCo refuses moving bodies without. Not an estimate."""

NOMINAL_INERTIA = 0.004
"""Moment of inertia of every moving link about any axis through its centre [kg m^2]: that of a
solid ball of 1 kg with 10 cm radius. Not an estimate."""

SU_MASS, SU_INERTIA = 1e-3, 4e-8
"""Mass [kg] and moment of inertia [kg m^2] of an SU: a ball of 1 g with 1 cm radius. Without any,
PyBullet takes 1 kg and 1 kg m^2. Not an estimate."""

_POSITION_GAIN, _VELOCITY_GAIN = 20.0, 10.0
"""How soft limits act in ros_control: speed is brought down within 1/20 s of them [1/s], and effort
limited by 10 per unit of speed [Nms/rad or Ns/m]."""

PLACEHOLDER = "placeholder, no estimate"


def emit(
    model: KinematicModel,
    *,
    name: str,
    limits: F64 | JointLimits,
    velocity: F64 | None = None,
    continuous: Bool | None = None,
    visuals: bool = True,
    collision: bool = False,
    remarks: Remarks | None = None,
) -> str:
    """Write a model as URDF.

    ``base_link`` is the model's base frame (z up). Each joint has the name it has in the log, the
    axis ``0 0 1`` and carries one link; each SU is a link of its own name on a fixed joint. All
    numbers are written so that they read back as the same float64. Masses and inertias are
    nominal (see :data:`NOMINAL_MASS`), so that physics engines load the file, and are marked as
    placeholders by comments; the base has none, since KDL, and with it ROS, warns of a base that
    has. The ``mujoco`` tag, which other readers skip, keeps MuJoCo from merging the SUs' frames
    into their links and from dropping the visuals.

    Args:
        model: D joints and U SUs.
        name: the robot's name.
        limits: limits of the joints, or (D, 2) lower and upper position limits alone [rad or m].
        velocity: (D,) velocity limits [rad/s or m/s] in the second case; nominal where None.
        continuous: (D,) True for revolute joints without end, whose limits are not written; none
            where None.
        visuals: whether to draw cylinders along the links and a hexagon per SU.
        collision: whether the same shapes collide; the log tells no shape.
        remarks: what to say in comments.

    Returns:
        The text of the file.

    Raises:
        BadFitError: a placement is not finite.
        UsageError: limits are not finite or not in order, or a name can not be written.
    """
    tree = model.tree
    limits = _checked_limits(model, limits, velocity)
    remarks = remarks or Remarks()
    names = urdf_names(tree)
    radius = thickness(model)

    robot = ET.Element("robot", name=name)
    _comment(robot, remarks.head)
    mujoco = ET.SubElement(robot, "mujoco")
    ET.SubElement(mujoco, "compiler", fusestatic="false", discardvisual="false")
    tags = [tag for tag, wanted in (("visual", visuals), ("collision", collision)) if wanted]
    if visuals:
        for material, rgba in COLOURS.items():
            element = ET.SubElement(robot, "material", name=material)
            ET.SubElement(element, "color", rgba=_numbers(rgba))

    for j, link in enumerate((BASE_LINK, *names.joint_links), start=-1):
        element = ET.SubElement(robot, "link", name=link)
        if j >= 0:
            _inertial(element, _centre(model, j), NOMINAL_MASS, NOMINAL_INERTIA)
        for tag in tags:
            _shapes(element, tag, link_shapes(model, j, radius))
    for link in names.su_links:
        element = ET.SubElement(robot, "link", name=link)
        _inertial(element, np.zeros(3), SU_MASS, SU_INERTIA)
        for tag in tags:
            _shapes(element, tag, su_shapes(radius))

    for j, joint in enumerate(tree.joint_names):
        endless = continuous is not None and bool(continuous[j])
        kind = "continuous" if endless else tree.joint_types[j]
        element = ET.SubElement(robot, "joint", name=joint, type=kind)
        _connect(element, names, int(tree.parent[j]), names.joint_links[j], model.T_parent_joint[j])
        ET.SubElement(element, "axis", xyz="0 0 1")
        _comment(element, remarks.joints.get(joint, ()))
        _limit(element, limits, j, endless)
    for u, joint in enumerate(names.su_joints):
        element = ET.SubElement(robot, "joint", name=joint, type="fixed")
        _connect(element, names, int(tree.su_joint[u]), names.su_links[u], model.T_joint_su[u])
        _comment(element, remarks.sus.get(tree.su_names[u], ()))

    ET.indent(robot)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(robot, "unicode") + "\n"


def _checked_limits(
    model: KinematicModel, limits: F64 | JointLimits, velocity: F64 | None
) -> JointLimits:
    """Limits, checked like the placements; see :func:`emit` for the errors."""
    tree = model.tree
    placed = zip(
        (*tree.joint_names, *tree.su_names), (*model.T_parent_joint, *model.T_joint_su), strict=True
    )
    for who, T in placed:
        if not np.isfinite(T).all():
            raise BadFitError(
                f"the placement of {who!r} is not a number",
                "record more poses, or leave this joint or SU out",
            )
    if not isinstance(limits, JointLimits):
        if velocity is None:
            velocity = np.full(tree.n_joints, NOMINAL_VELOCITY)
        limits = seen_limits(
            np.asarray(limits, float).reshape(tree.n_joints, 2),
            np.asarray(velocity, float).reshape(tree.n_joints),
        )
    rows = zip(tree.joint_names, limits.position, limits.velocity, strict=True)
    for joint, (lower, upper), speed in rows:
        if not (np.isfinite([lower, upper, speed]).all() and lower < upper and speed > 0):
            raise UsageError(
                f"joint {joint!r} can not be limited to [{lower:g}, {upper:g}] at {speed:g} per s",
                "a lower limit below the upper one and a velocity above 0 are needed",
            )
    return limits


def _limit(joint: ET.Element, limits: JointLimits, j: int, endless: bool) -> None:
    """Add the limits of joint ``j``, soft ones too where it has any."""
    span = dict(zip(("lower", "upper"), map(_number, limits.position[j]), strict=True))
    rates = {"effort": _number(NOMINAL_EFFORT), "velocity": _number(limits.velocity[j])}
    ET.SubElement(joint, "limit", rates if endless else span | rates)
    if not endless and np.isfinite(limits.soft[j]).all():
        lower, upper = map(_number, limits.soft[j])
        gains = {"k_position": _number(_POSITION_GAIN), "k_velocity": _number(_VELOCITY_GAIN)}
        soft = {"soft_lower_limit": lower, "soft_upper_limit": upper}
        ET.SubElement(joint, "safety_controller", soft | gains)


def _comment(element: ET.Element, words: Iterable[str]) -> None:
    """Add comments."""
    for line in words:
        element.append(comment(line))


def _connect(element: ET.Element, names: UrdfNames, parent: int, child: str, T: F64) -> None:
    """Add parent, child and placement (4, 4) to a joint; ``parent`` is -1 for the base."""
    parent_link = BASE_LINK if parent < 0 else names.joint_links[parent]
    ET.SubElement(element, "parent", link=parent_link)
    ET.SubElement(element, "child", link=child)
    _origin(element, T)


def _centre(model: KinematicModel, joint: int) -> F64:
    """(3,) where the nominal mass sits: half way to the middle of what the segment carries [m]."""
    tree = model.tree
    carried = np.concatenate(
        [model.T_parent_joint[tree.parent == joint], model.T_joint_su[tree.su_joint == joint]]
    )
    return carried[:, :3, 3].mean(axis=0) / 2.0 if len(carried) else np.zeros(3)


def _inertial(link: ET.Element, centre: F64, mass: float, moment: float) -> None:
    """Add a nominal mass [kg] at ``centre`` (3,) [m] and a moment of inertia [kg m^2]."""
    T = np.eye(4)
    T[:3, 3] = centre
    element = ET.SubElement(link, "inertial")
    _comment(element, [PLACEHOLDER])
    _origin(element, T)
    ET.SubElement(element, "mass", value=_number(mass))
    diagonal = dict.fromkeys(("ixx", "iyy", "izz"), _number(moment))
    ET.SubElement(element, "inertia", diagonal | dict.fromkeys(("ixy", "ixz", "iyz"), "0.0"))


def _shapes(link: ET.Element, tag: str, shapes: Iterable[Shape]) -> None:
    """Add shapes to a link, as what is seen ("visual") or as what collides ("collision")."""
    for shape in shapes:
        element = ET.SubElement(link, tag)
        _origin(element, shape.T_link_shape)
        geometry = ET.SubElement(element, "geometry")
        if shape.kind == "cylinder":
            radius, length = map(_number, shape.size)
            ET.SubElement(geometry, "cylinder", radius=radius, length=length)
        else:
            ET.SubElement(geometry, "box", size=_numbers(shape.size))
        if tag == "visual":
            ET.SubElement(element, "material", name=shape.colour)


def _origin(element: ET.Element, T: F64) -> None:
    """Add the placement (4, 4) as xyz and rpy."""
    xyz, rpy = _numbers(T[:3, 3]), _numbers(rpy_of_rotation(T[:3, :3]))
    ET.SubElement(element, "origin", xyz=xyz, rpy=rpy)


def _number(value: float) -> str:
    """Shortest decimal that reads back as the same float64; -0 as 0."""
    return repr(float(value) + 0.0)


def _numbers(values: Iterable[float]) -> str:
    """Numbers parted by spaces, see :func:`_number`."""
    return " ".join(map(_number, values))
