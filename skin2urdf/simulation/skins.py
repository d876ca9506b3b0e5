"""Where the SUs sit: anywhere on their segments, under names that give nothing away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.errors import UsageError
from skin2urdf.simulation.mechanism import Mechanism
from skin2urdf.simulation.robots import GivenSu, SkinLayout


@dataclass(frozen=True, eq=False)
class PlacedSu(Record):
    """An SU on the robot.

    Attributes:
        name: its name, which says nothing about its place.
        topic: the topic it reports on.
        joint: index of the last joint before it; -1 for the reference segment.
        link: the URDF link it is fixed to.
        T_link_su: (4, 4) its frame in the link's [m].
        T_joint_su: (4, 4) its frame in the joint's (base frame on the reference segment) [m].
    """

    name: str
    topic: str
    joint: int
    link: str
    T_link_su: F64
    T_joint_su: F64


def place_skin(
    mechanism: Mechanism, layout: SkinLayout, rng: np.random.Generator
) -> tuple[PlacedSu, ...]:
    """Put the SUs of a layout on a robot.

    A random SU lies at a random distance and direction from the middle of its segment (the middle
    between its joint and the joints it carries, the center of mass at the end of a chain), turned
    at random.

    Args:
        mechanism: the robot.
        layout: how many SUs sit where.
        rng: source of places and names.

    Returns:
        The SUs, sorted by name, which is a random order.

    Raises:
        UsageError: the layout has no SU, or names a link the robot does not have.
    """
    places: list[tuple[int, str, F64, F64]] = []
    for joint in range(-1, mechanism.n_joints):
        count = layout.sus_on_base if joint < 0 else layout.sus_per_segment
        link = mechanism.root_link if joint < 0 else mechanism.link_names[joint]
        for _ in range(count):
            T = _random_place(_middle(mechanism, joint), layout.distance, rng)
            # Pinocchio's joint frame is the frame of the link that the URDF hangs on the joint.
            places.append((joint, link, T, T))
    places += [_given_place(mechanism, su) for su in layout.given]
    if not places:
        raise UsageError("the robot carries no SU", "ask for at least one SU")
    names = _names(len(places), rng)
    sus = [
        PlacedSu(name, f"/skin/{name}/imu", joint, link, T_link_su, T_joint_su)
        for name, (joint, link, T_link_su, T_joint_su) in zip(names, places, strict=True)
    ]
    return tuple(sorted(sus, key=lambda su: su.name))


def _middle(mechanism: Mechanism, joint: int) -> F64:
    """(3,) a point inside a segment, in the frame of its joint [m]."""
    model = mechanism.model
    children = np.flatnonzero(mechanism.parent == joint)
    if children.size:
        origins = [np.array(model.jointPlacements[int(c) + 1].translation) for c in children]
        return np.asarray(0.5 * np.mean(origins, axis=0))
    return np.array(model.inertias[joint + 1].lever)


def _random_place(middle: F64, distance: tuple[float, float], rng: np.random.Generator) -> F64:
    """(4, 4) random frame near a point."""
    direction = rng.standard_normal(3)
    T = np.eye(4)
    T[:3, :3] = _random_rotation(rng)
    T[:3, 3] = middle + rng.uniform(*distance) * direction / np.linalg.norm(direction)
    return T


def _random_rotation(rng: np.random.Generator) -> F64:
    """(3, 3) uniformly distributed rotation, from a uniformly distributed unit quaternion."""
    q = rng.standard_normal(4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _given_place(mechanism: Mechanism, su: GivenSu) -> tuple[int, str, F64, F64]:
    import pinocchio as pin

    model = mechanism.model
    if not model.existBodyName(su.link):
        raise UsageError(f'an SU is to sit on "{su.link}", which is no link of the robot')
    frame = model.frames[model.getBodyId(su.link)]
    T_link_su = pin.SE3(pin.rpy.rpyToMatrix(*su.rpy), np.array(su.xyz))
    T_joint_su = frame.placement * T_link_su
    return int(frame.parentJoint) - 1, su.link, T_link_su.homogeneous, T_joint_su.homogeneous


def _names(count: int, rng: np.random.Generator) -> list[str]:
    """Different names of four random hexadecimal digits."""
    numbers = rng.choice(0x10000, size=count, replace=False)
    return [f"su_{number:04x}" for number in numbers]
