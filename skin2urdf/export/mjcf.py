"""An MJCF model for MuJoCo, with a site and an accelerometer per SU."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import UsageError
from skin2urdf.export.source import (
    MOVABLE,
    ExportedSu,
    Source,
    UrdfJoint,
    decimal,
    decimals,
    numbers,
    origin,
    quaternion,
    rotation_of_rpy,
)
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.urdf.emit import NOMINAL_INERTIA, NOMINAL_MASS, PLACEHOLDER
from skin2urdf.urdf.names import comment

_TINY_INERTIA = 1e-9
"""Moment of inertia [kg m^2] of what has a mass and none, such as 0.1 g in a ball of 5 mm."""
_WORLD = "world"
"""MuJoCo's name of its static body: a base of this name is that body."""
_KINDS = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}


def to_mjcf(source: Source) -> str:
    """A robot as MJCF.

    Links are bodies of the same names, the base fixed to the world; gravity is the first log's in
    its frame, since a robot may hang. SUs are sites with accelerometers, whose noise is the log's
    where it is known. Meshes are left out, since their paths mean something to ROS alone; boxes,
    cylinders and spheres are kept. Joints that follow others (mimic) do so by equality constraints.

    Args:
        source: what to export.

    Returns:
        The text of the file.

    Raises:
        UsageError: a joint is of a type that it can not hold.
    """
    for joint in source.joints:
        if joint.kind not in (*MOVABLE, "fixed"):
            raise UsageError(
                f"joint {joint.name!r} of {source.path} is {joint.kind}",
                "MJCF is written for fixed, revolute, continuous and prismatic joints",
            )
    model = ET.Element("mujoco", model=source.robot)
    for line in source.header:
        model.append(comment(line))
    ET.SubElement(
        model,
        "compiler",
        {"angle": "radian", "autolimits": "true", "inertiafromgeom": "false"}
        | {"balanceinertia": "true"},
    )
    if source.document is not None:
        up = np.reshape(source.document["gravity_up"], (-1, 3))[0]
        ET.SubElement(model, "option", gravity=decimals(-GRAVITY * up))
    world = ET.SubElement(model, "worldbody")
    _body(world, source, source.root, None)
    placed = [su for su in source.sus if not su.position_open]
    if placed:
        sensors = ET.SubElement(model, "sensor")
        for su in placed:
            _sensor(sensors, su)
    followers = [j for j in source.movable if j.element.find("mimic") is not None]
    if followers:
        _follow(ET.SubElement(model, "equality"), followers)
    ET.indent(model)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(model, "unicode") + "\n"


def _body(parent: ET.Element, source: Source, link: str, joint: UrdfJoint | None) -> None:
    """Add a link, its joint, and all that hangs on it."""
    if joint is None and link == _WORLD:
        _fill(parent, source, link)
        return
    body = ET.SubElement(parent, "body", name=f"{link}_link" if link == _WORLD else link)
    if joint is not None:
        _place(body, joint.xyz, rotation_of_rpy(joint.rpy))
        if joint.kind in MOVABLE:
            _joint(body, joint)
    _inertial(body, source.links[link], moves=joint is not None and joint.kind in MOVABLE)
    _fill(body, source, link)


def _fill(body: ET.Element, source: Source, link: str) -> None:
    """Add the shapes of a link and what hangs on it."""
    for tag in ("visual", "collision"):
        for shape in source.links[link].findall(tag):
            _geom(body, shape, tag)
    sites = {su.name: su for su in source.sus}
    for below in source.joints:
        if below.parent != link:
            continue
        if below.child in sites:
            _site(body, sites[below.child])
        else:
            _body(body, source, below.child, below)


def _joint(body: ET.Element, joint: UrdfJoint) -> None:
    """Add a joint with its range."""
    element = ET.SubElement(
        body, "joint", name=joint.name, type=_KINDS[joint.kind], axis=decimals(joint.axis)
    )
    limit = joint.element.find("limit")
    if joint.kind != "continuous" and limit is not None:
        ends = [float(limit.get(key, "0")) for key in ("lower", "upper")]
        if ends[0] < ends[1]:
            element.set("range", decimals(ends))
    dynamics = joint.element.find("dynamics")
    for ours, theirs in (("damping", "damping"), ("frictionloss", "friction")):
        value = None if dynamics is None else dynamics.get(theirs)
        if value is not None:
            element.set(ours, value)


def _inertial(body: ET.Element, link: ET.Element, *, moves: bool) -> None:
    """Add mass and inertia; MuJoCo refuses bodies that move without."""
    given = link.find("inertial")
    mass = inertia = None
    if given is not None:
        mass, inertia = given.find("mass"), given.find("inertia")
    empty = mass is None or float(mass.get("value", "0")) <= 0
    if given is None or mass is None or inertia is None or empty:
        if moves:
            body.append(comment(PLACEHOLDER))
            ET.SubElement(
                body,
                "inertial",
                pos="0 0 0",
                mass=decimal(NOMINAL_MASS),
                diaginertia=decimals([NOMINAL_INERTIA] * 3),
            )
        return
    xyz, rpy = origin(given)
    xx, yy, zz, xy, xz, yz = (
        float(inertia.get(key, "0")) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    R = rotation_of_rpy(rpy)
    tensor = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    if (float(mass.get("value", "0")), xx, yy, zz) == (NOMINAL_MASS, *[NOMINAL_INERTIA] * 3):
        body.append(comment(PLACEHOLDER))
    rest = {"pos": decimals(xyz), "mass": decimal(float(mass.get("value", "0")))}
    if np.linalg.eigvalsh(tensor)[0] > 0:
        ET.SubElement(body, "inertial", rest, fullinertia=decimals(tensor[rows, columns]))
        return
    body.append(comment("the URDF's inertia is not positive; this one is tiny instead"))
    ET.SubElement(body, "inertial", rest, diaginertia=decimals([_TINY_INERTIA] * 3))


def _geom(body: ET.Element, shape: ET.Element, tag: str) -> None:
    """Add a box, a cylinder or a sphere; what is seen only does not collide."""
    geometry = shape.find("geometry")
    kind = None if geometry is None or not len(geometry) else geometry[0]
    if kind is None or kind.tag not in ("box", "cylinder", "sphere"):
        return
    if kind.tag == "box":
        size = numbers(kind.get("size", ""), 3) / 2
    elif kind.tag == "cylinder":
        size = np.array([float(kind.get("radius", "0")), float(kind.get("length", "0")) / 2])
    else:
        size = np.array([float(kind.get("radius", "0"))])
    geom = ET.SubElement(body, "geom", type=kind.tag, size=decimals(size))
    xyz, rpy = origin(shape)
    _place(geom, xyz, rotation_of_rpy(rpy))
    if tag == "visual":
        geom.attrib |= {"contype": "0", "conaffinity": "0", "group": "2"}


def _site(body: ET.Element, su: ExportedSu) -> None:
    """Add an SU."""
    if su.position_open:
        return
    for words in su.open_words:
        body.append(comment(f"OPEN: {words}"))
    _place(ET.SubElement(body, "site", name=su.name), su.joint.xyz, rotation_of_rpy(su.joint.rpy))


def _sensor(sensors: ET.Element, su: ExportedSu) -> None:
    """Add an accelerometer; MuJoCo knows its noise, and adds none."""
    element = ET.SubElement(sensors, "accelerometer", name=su.name, site=su.name)
    facts = su.facts or {}
    noise, rate = facts.get("noise_density"), facts.get("rate")
    if noise is not None and rate is not None:
        element.set("noise", decimal(float(np.mean(noise)) * float(rate) ** 0.5))


def _follow(equality: ET.Element, joints: Sequence[UrdfJoint]) -> None:
    """Tie joints to those they follow."""
    for joint in joints:
        mimic = joint.element.find("mimic")
        if mimic is None:
            continue
        factors = [float(mimic.get("offset", "0")), float(mimic.get("multiplier", "1"))]
        ET.SubElement(
            equality,
            "joint",
            joint1=joint.name,
            joint2=mimic.get("joint", ""),
            polycoef=decimals([*factors, 0.0, 0.0, 0.0]),
        )


def _place(element: ET.Element, xyz: F64, R: F64) -> None:
    """Set position and orientation."""
    element.set("pos", decimals(xyz))
    element.set("quat", decimals(quaternion(R)))
