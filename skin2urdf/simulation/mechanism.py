"""The robot's original URDF as a Pinocchio model in which only the chosen joints move."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.simulation.robots import RobotSpec, Vector3


@dataclass(frozen=True, eq=False)
class Mechanism(Record):
    """D single-DoF joints in Pinocchio's order; index -1 is the reference segment.

    Attributes:
        model: ``pinocchio.Model`` with all other joints locked and gravity as seen from the
            tilted base; its joint ``d + 1`` is DoF ``d``.
        joint_names: D joint names of the URDF.
        parent: (D,) joint before each joint, -1 for the base.
        prismatic: (D,) True where a joint slides.
        lower: (D,) lower limits, -inf where there is none [rad or m].
        upper: (D,) upper limits, inf where there is none [rad or m].
        speed_limit: (D,) speed limits, inf where there is none [rad/s or m/s].
        link_names: the D links that the joints carry.
        root_link: the URDF's root link, whose frame is the base frame.
        locked: name -> position of the joints that are locked [rad or m].
    """

    model: Any
    joint_names: tuple[str, ...]
    parent: Int
    prismatic: Bool
    lower: F64
    upper: F64
    speed_limit: F64
    link_names: tuple[str, ...]
    root_link: str
    locked: Mapping[str, float]

    @property
    def n_joints(self) -> int:
        """Number of DoFs D."""
        return len(self.joint_names)

    @property
    def gravity_base(self) -> F64:
        """(3,) gravity in the base frame [m/s^2]."""
        return np.array(self.model.gravity.linear)

    def configuration(self, position: F64) -> F64:
        """Pinocchio's configuration vectors.

        Args:
            position: (N, D) joint positions, unwrapped [rad or m].

        Returns:
            (N, nq) configurations; a continuous joint takes two entries, cosine and sine.
        """
        q = np.empty((len(position), self.model.nq))
        for d, joint in enumerate(list(self.model.joints)[1:]):
            if joint.nq == 2:
                q[:, joint.idx_q] = np.cos(position[:, d])
                q[:, joint.idx_q + 1] = np.sin(position[:, d])
            else:
                q[:, joint.idx_q] = position[:, d]
        return q

    def torques(self, position: F64, velocity: F64, acceleration: F64) -> F64:
        """Joint torques of a motion (Newton and Euler, recursively), gravity's among them.

        Args:
            position: (N, D) joint positions, unwrapped [rad or m].
            velocity: (N, D) [rad/s or m/s].
            acceleration: (N, D) [rad/s^2 or m/s^2].

        Returns:
            (N, D) torques [N m or N].
        """
        import pinocchio as pin

        # All samples in one call: one by one, most of the time is spent between the calls.
        pool = pin.ModelPool(self.model, 1)
        motion = self.configuration(position).T, velocity.T, acceleration.T
        # Of a single joint they are a vector.
        return np.asarray(pin.rneaInParallel(1, pool, *motion).T.reshape(velocity.shape))


def load_mechanism(spec: RobotSpec, base_rpy: Vector3, gravity: float = GRAVITY) -> Mechanism:
    """Load a robot's URDF and lock what does not move.

    Locked are: mimic joints, joints with more than one DoF, joints without room between their
    limits, and those the robot's file names.

    Args:
        spec: the robot.
        base_rpy: roll, pitch, yaw of the base in the world [rad].
        gravity: its size [m/s^2].

    Raises:
        UnreadableInputError: the file is not a URDF that Pinocchio can load.
        UsageError: no joint is left to move, or a pattern in ``spec.locked`` fits no joint.
    """
    import pinocchio as pin

    xml = read_urdf(spec)
    try:
        full = pin.buildModelFromXML(ET.tostring(xml, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise UnreadableInputError(
            str(spec.urdf), f"not a URDF that Pinocchio can load: {error}", "check the file"
        ) from error
    locked = _locked_positions(spec, full, xml)
    ids = [full.getJointId(name) for name in locked]
    model = _reduced(full, ids, _reference(full, locked)) if ids else full
    if model.njoints == 1:
        raise UsageError(
            f"{spec.name}: no joint is left to move: {_kinds(xml)}",
            "lock fewer joints, or check their types and limits in the URDF",
        )
    R_world_base = pin.rpy.rpyToMatrix(*base_rpy)
    model.gravity.linear = R_world_base.T @ np.array([0.0, 0.0, -gravity])
    joints = list(model.joints)[1:]
    names = tuple(model.names)[1:]
    lower, upper = zip(*(_limits(model, joint) for joint in joints), strict=True)
    speed = np.array([model.velocityLimit[joint.idx_v] for joint in joints])
    child_link = {j.get("name"): _attribute(j, "child", "link") for j in xml.findall("joint")}
    children = set(child_link.values())
    roots = [name for link in xml.findall("link") if (name := link.get("name")) not in children]
    return Mechanism(
        model=model,
        joint_names=names,
        parent=np.array(list(model.parents)[1:]) - 1,
        prismatic=np.array([_is_prismatic(joint) for joint in joints]),
        lower=np.array(lower),
        upper=np.array(upper),
        speed_limit=np.where((speed > 0) & (speed < 1e3), speed, np.inf),
        link_names=tuple(child_link[name] for name in names),
        root_link=str(roots[0]),
        locked=locked,
    )


def read_urdf(spec: RobotSpec) -> ET.Element:
    """Parse a robot's URDF as XML.

    A revolute joint whose limits are all 0, speed and effort too, never got any from the program
    that wrote the file: it is read as one without end.

    Raises:
        UnreadableInputError: the file can not be read or is not a URDF.
    """
    try:
        xml = ET.parse(spec.urdf).getroot()  # noqa: S314 - a robot description of the user's own
    except (OSError, ET.ParseError) as error:
        raise UnreadableInputError(
            str(spec.urdf), f"not readable as XML: {error}", "give the path of a URDF"
        ) from error
    if xml.tag != "robot" or not xml.findall("joint"):
        raise UnreadableInputError(
            str(spec.urdf), "not a URDF with joints", "give the path of a URDF"
        )
    for joint in xml.findall("joint"):
        limit = joint.find("limit")
        if joint.get("type") == "revolute" and limit is not None and _is_blank(limit):
            joint.set("type", "continuous")
    return xml


def _is_blank(limit: ET.Element) -> bool:
    keys = ("lower", "upper", "velocity", "effort")
    return all(float(limit.get(key, "0")) == 0.0 for key in keys)


def _kinds(xml: ET.Element) -> str:
    """How many joints of a URDF are of which type, in words."""
    kinds = Counter(joint.get("type", "unknown") for joint in xml.findall("joint"))
    return ", ".join(f"{n} {kind}" for kind, n in kinds.most_common())


def _locked_positions(spec: RobotSpec, full: Any, xml: ET.Element) -> dict[str, float]:
    """Name -> position of every joint of the full model that must not move."""
    mimics = {j.get("name") for j in xml.findall("joint") if j.find("mimic") is not None}
    names = tuple(full.names)[1:]
    for pattern in spec.locked:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise UsageError(
                f'{spec.name}: "{pattern}" is to be locked but fits no movable joint',
                f"the joints are {', '.join(names)}",
            )
    locked: dict[str, float] = {}
    for name, joint in zip(names, list(full.joints)[1:], strict=True):
        given = [value for pattern, value in spec.locked.items() if fnmatchcase(name, pattern)]
        lower, upper = _limits(full, joint) if joint.nv == 1 else (-np.inf, np.inf)
        moves = any(fnmatchcase(name, pattern) for pattern in spec.moving)
        movable = joint.nv == 1 and upper - lower > 1e-6 and name not in mimics
        if given or not moves or not movable:
            value = given[0] if given and given[0] is not None else 0.0
            locked[name] = float(np.clip(value, lower, upper))
    return locked


def _reduced(full: Any, ids: Sequence[int], reference: F64) -> Any:
    """The model without some joints, held as in a configuration.

    Pinocchio looks for the frame of a joint that it locks by name among all frames, links' too,
    and refuses where a link has the same name: meanwhile, links are called otherwise.
    """
    import pinocchio as pin

    def links(model: Any) -> list[Any]:
        return [frame for frame in model.frames if frame.type == pin.FrameType.BODY]

    for frame in links(full):
        frame.name = _LINK + frame.name
    model = pin.buildReducedModel(full, list(ids), reference)
    for frame in links(model):
        frame.name = frame.name.removeprefix(_LINK)
    return model


_LINK = "the link "


def _reference(full: Any, locked: Mapping[str, float]) -> F64:
    """(nq,) configuration of the full model that holds the locked positions."""
    import pinocchio as pin

    q = np.array(pin.neutral(full))
    for name, value in locked.items():
        joint = full.joints[full.getJointId(name)]
        if joint.nv == 1 and joint.nq == 2:
            q[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
        elif joint.nv == 1:
            q[joint.idx_q] = value
    return q


def _limits(model: Any, joint: Any) -> tuple[float, float]:
    """Limits of a single-DoF joint, infinite where it turns without end."""
    if joint.nq == 2:
        return -np.inf, np.inf
    lower = float(model.lowerPositionLimit[joint.idx_q])
    upper = float(model.upperPositionLimit[joint.idx_q])
    return (lower if lower > -1e3 else -np.inf), (upper if upper < 1e3 else np.inf)


def _is_prismatic(joint: Any) -> bool:
    return "Prismatic" in joint.shortname() or joint.shortname().startswith("JointModelP")


def _attribute(element: ET.Element, child: str, name: str) -> str:
    found = element.find(child)
    return found.get(name, "") if found is not None else ""
