"""The kinematics that the text of a URDF holds."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.errors import UnreadableInputError
from skin2urdf.geometry.se3 import placement, screw
from skin2urdf.urdf.loading import check_tree, parsed_urdf
from skin2urdf.vendor.source import ModelText

MOVABLE = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: ``q = multiplier q_leader + offset``."""

    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class ModelJoint(Record):
    """A joint of a URDF.

    Attributes:
        name: its name.
        kind: its type, as URDF has it.
        parent: the link it hangs on.
        child: the link it carries.
        T_parent_origin: (4, 4) its origin in the frame of the parent link.
        axis: (3,) unit axis in the frame of its origin.
        limits: lower and upper position [rad or m]; infinite where there are none.
        mimic: what it follows, if anything.
    """

    name: str
    kind: str
    parent: str
    child: str
    T_parent_origin: F64
    axis: F64
    limits: tuple[float, float]
    mimic: Mimic | None

    @property
    def moves(self) -> bool:
        """Whether it is a joint of one DoF."""
        return self.kind in MOVABLE

    @property
    def joint_type(self) -> Literal["revolute", "prismatic"]:
        """Its type, of one DoF."""
        return "prismatic" if self.kind == "prismatic" else "revolute"


@dataclass(frozen=True, eq=False)
class Description:
    """The links and joints of a URDF.

    Attributes:
        text: where it stands.
        name: the robot's name.
        root: the link that no joint carries.
        links: names of all links.
        joints: the joints, parents before what they carry.
    """

    text: ModelText
    name: str
    root: str
    links: tuple[str, ...]
    joints: tuple[ModelJoint, ...]

    @property
    def movable(self) -> tuple[ModelJoint, ...]:
        """The joints of one DoF."""
        return tuple(joint for joint in self.joints if joint.moves)


def describe(text: ModelText) -> Description:
    """Parse the kinematics of a URDF.

    Raises:
        UnreadableInputError: it is no XML, no URDF of one tree of links, or a number is none.
    """
    root = parsed_urdf(text.text.encode(), text.source)
    check_tree(root, text.source)
    try:
        joints = {joint.child: joint for joint in map(_joint, root.findall("joint"))}
    except ValueError as error:
        raise UnreadableInputError(
            text.source, f"has a number that is none: {error}", "check it with check_urdf"
        ) from error
    links = tuple(str(link.get("name")) for link in root.findall("link"))
    (base,) = (link for link in links if link not in joints)
    return Description(text, root.get("name", ""), base, links, _outwards(base, joints))


def _outwards(base: str, joints: dict[str, ModelJoint]) -> tuple[ModelJoint, ...]:
    """Joints in an order in which parents come first."""
    carried: dict[str, list[ModelJoint]] = {}
    for joint in joints.values():
        carried.setdefault(joint.parent, []).append(joint)
    out: list[ModelJoint] = []
    waiting = [base]
    while waiting:
        here = carried.get(waiting.pop(0), [])
        out += here
        waiting += [joint.child for joint in here]
    return tuple(out)


def _joint(element: ET.Element) -> ModelJoint:
    name = element.get("name") or ""
    kind = element.get("type") or ""
    # People write any axis into joints that have none.
    axis = _triple(element.find("axis") if kind in MOVABLE else None, "xyz", "1 0 0")
    length = float(np.linalg.norm(axis))
    if not length > 0:
        raise ValueError(f"joint {name!r} has the axis 0 0 0")
    limit, mimic = element.find("limit"), element.find("mimic")
    limits = (-np.inf, np.inf)
    if kind != "continuous" and limit is not None:
        limits = (float(limit.get("lower", "0")), float(limit.get("upper", "0")))
    follows = None
    if mimic is not None:
        follows = Mimic(
            mimic.get("joint") or "",
            float(mimic.get("multiplier", "1")),
            float(mimic.get("offset", "0")),
        )
    return ModelJoint(
        name=name,
        kind=kind,
        parent=_link(element, "parent"),
        child=_link(element, "child"),
        T_parent_origin=origin_transform(element.find("origin")),
        axis=axis / length,
        limits=limits,
        mimic=follows,
    )


def origin_transform(element: ET.Element | None) -> F64:
    """(4, 4) transform of an ``origin`` element; identity where there is none."""
    roll, pitch, yaw = _triple(element, "rpy", "0 0 0")
    R = screw("z", yaw, 0.0) @ screw("y", pitch, 0.0) @ screw("x", roll, 0.0)
    return placement(R[:3, :3], _triple(element, "xyz", "0 0 0"))


def _triple(element: ET.Element | None, attribute: str, default: str) -> F64:
    text = default if element is None else element.get(attribute, default)
    numbers = np.array([float(word) for word in text.split()])
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise ValueError(f"{attribute}={text!r} is not three numbers")
    return numbers


def _link(element: ET.Element, tag: str) -> str:
    end = element.find(tag)
    return "" if end is None else end.get("link", "")
