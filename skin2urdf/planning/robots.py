"""What a plan is made for: limits, placements and shapes out of models, files and calibrations."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.errors import UsageError
from skin2urdf.model.records import KinematicModel
from skin2urdf.planning.collisions import CollisionChecker
from skin2urdf.planning.earlier import Earlier, seen_ranges
from skin2urdf.planning.kinematics import kinematic_model, sus_on_links, usual_sus
from skin2urdf.planning.limits import (
    Given,
    acceleration_and_jerk,
    check_names,
    complete,
    merged,
)
from skin2urdf.planning.records import Limits
from skin2urdf.urdf.beside import document_beside
from skin2urdf.urdf.records import NO_LIMITS


class Joints(Protocol):
    """The joints of a URDF that move, as whoever reads it has them; D of one DoF each."""

    @property
    def model(self) -> Any:
        """``pinocchio.Model`` with all others locked."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in the URDF."""

    @property
    def parent(self) -> Int:
        """(D,) joint before each joint, -1 for the base."""

    @property
    def prismatic(self) -> Bool:
        """(D,) True where a joint slides."""

    @property
    def lower(self) -> F64:
        """(D,) lower limits [rad or m], -inf where there is none."""

    @property
    def upper(self) -> F64:
        """(D,) upper limits [rad or m], inf where there is none."""

    @property
    def speed_limit(self) -> F64:
        """(D,) limits of speed [rad/s or m/s], inf where there is none."""

    @property
    def locked(self) -> Mapping[str, float]:
        """Positions of all other joints [rad or m]."""


@dataclass(frozen=True, eq=False)
class PlannedRobot:
    """What is planned for.

    Attributes:
        limits: of its joints.
        model: its placements and SUs; None where only limits are known.
        checker: keeps its bodies apart; None where nothing is known of them.
        notes: what is to be said of that.
    """

    limits: Limits
    model: KinematicModel | None
    checker: CollisionChecker | None
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Told:
    """What is told of a robot beside its model.

    Attributes:
        limits: of its joints, by name; they count before those of the model.
        source: where these come from.
        base_rpy: roll, pitch, yaw of the base as it stands [rad].
        sus: shell pattern of the links of the model that are SUs; None for one on every segment.
        floor: height in the base frame that nothing goes below [m]; None without a floor.
        collisions: whether shapes of the model are looked at.
        may_touch: pairs of links that are not kept apart.
    """

    limits: Mapping[str, Given] = field(default_factory=dict)
    source: str = "the file of limits"
    base_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sus: str | None = None
    floor: float | None = None
    collisions: bool = True
    may_touch: frozenset[frozenset[str]] = frozenset()

    @property
    def R_world_base(self) -> F64:
        """(3, 3) how the base stands."""
        import pinocchio as pin

        return np.asarray(pin.rpy.rpyToMatrix(*self.base_rpy))


def robot_of_limits(told: Told) -> PlannedRobot:
    """A robot of which limits alone are known.

    Raises:
        UsageError: a floor is given.
        PlanError: they contradict each other or leave no room.
    """
    _check_no_floor(told)
    limits = complete(tuple(told.limits), told.limits)
    return PlannedRobot(limits, None, None, (_NO_MODEL,))


def robot_found_before(earlier: Earlier, told: Told) -> PlannedRobot:
    """A robot that was calibrated, without its model.

    Raises:
        UsageError: a limit is given of a joint that it does not have, or a floor is given.
        PlanError: limits contradict each other or leave no room.
    """
    _check_no_floor(told)
    names = earlier.model.tree.joint_names
    check_names(told.limits, names, told.source)
    known = {n: merged(told.limits.get(n, Given()), earlier.limits[n]) for n in names}
    return PlannedRobot(complete(names, known), _tilted(earlier.model, told), None, (_NO_SHAPES,))


def robot_of_model(
    urdf: Path, xml: ET.Element, joints: Joints, told: Told, earlier: Earlier | None = None
) -> PlannedRobot:
    """A robot by its URDF.

    Args:
        urdf: the file; meshes are looked for from there, and its JSON.
        xml: what it says.
        joints: what of it moves.
        told: what else is known.
        earlier: a calibration of the robot, whose placements and SUs count.

    Raises:
        UsageError: names fit nothing, ranges are not known, shapes can not be read, or nothing
            can be kept above the floor that is given.
        PlanError: limits contradict each other or leave no room.
    """
    check_names(told.limits, joints.joint_names, told.source)
    ranged = {name for name, limits in told.limits.items() if limits.lower is not None}
    lower = zip(joints.joint_names, joints.lower, strict=True)
    bounded = [name for name, low in lower if low > -np.inf]
    seen, ranges = _seen(urdf, ranged.issuperset(bounded))
    sources = (acceleration_and_jerk(xml), seen, told.limits)
    limits_of = {}
    for d, name in enumerate(joints.joint_names):
        known = Given(
            prismatic=bool(joints.prismatic[d]),
            lower=_finite(joints.lower[d]),
            upper=_finite(joints.upper[d]),
            velocity=_finite(joints.speed_limit[d]),
        )
        for more in sources:
            known = merged(more.get(name, Given()), known)
        limits_of[name] = known
    if earlier is None:
        names, model = joints.joint_names, _placements(joints, told)
    else:
        names = earlier.model.tree.joint_names
        check_names(dict.fromkeys(names, Given()), joints.joint_names, earlier.path)
        model = _tilted(earlier.model, told)
    limits = complete(names, limits_of)
    notes: tuple[str, ...] = ()
    checker = None
    if not told.collisions:
        _check_no_floor(told)
        notes = ("collisions are not looked at (--no-collisions)",)
    elif xml.find("link/collision") is None:
        _check_no_floor(told)
        notes = ("the URDF has no <collision> shapes: the robot may touch itself",)
    else:
        try:
            checker = CollisionChecker(
                xml, urdf, limits.joint_names, joints.locked,
                (limits.lower, limits.upper), told.floor, told.may_touch,
            )  # fmt: skip
        except (ValueError, RuntimeError) as error:
            raise UsageError(
                f"the shapes of {urdf} can not be read: {' '.join(str(error).split())}",
                "put its meshes where package:// leads from a folder above the URDF, or plan "
                "without them (--no-collisions)",
            ) from error
    return PlannedRobot(limits, model, checker, (*ranges, *notes))


_NO_MODEL = (
    "without a model, poses fill the joints' ranges, nothing is known of what the robot may touch, "
    "and no accuracy can be told"
)
_NO_SHAPES = "nothing is known of what the robot may touch: give --model as well"


def _check_no_floor(told: Told) -> None:
    """Refuse a floor where no shapes are looked at, which nobody could keep above it."""
    if told.floor is not None:
        raise UsageError(
            "--floor needs a model with <collision> shapes that are looked at",
            "give one with --model and without --no-collisions, or leave out --floor",
            argument="--floor",
        )


def _finite(value: float) -> float | None:
    return float(value) if abs(value) < float("inf") else None


def _seen(urdf: Path, ranged: bool) -> tuple[Mapping[str, Given], tuple[str, ...]]:
    """Ranges of a calibrated robot, whose URDF has limits that are nobody's, and what to say of it.

    Args:
        urdf: its file.
        ranged: whether a file of limits has the ranges of all joints.

    Raises:
        UsageError: neither its JSON nor a file of limits says how far its joints may go.
    """
    beside = document_beside(urdf)
    ranges = seen_ranges(beside) if beside else {}
    if ranges:
        return ranges, (
            f"joints keep to the ranges that the log of {urdf.name} saw: its own limits are "
            "placeholders, and --limits says otherwise",
        )
    if not ranged and NO_LIMITS in urdf.read_text(encoding="utf-8", errors="replace"):
        raise UsageError(
            f"the limits in {urdf} are placeholders, and its JSON is not beside it",
            "put the JSON there, or give the ranges of all joints: min_position and max_position "
            "in a file of limits (--limits)",
        )
    return {}, ()


def _placements(joints: Joints, told: Told) -> KinematicModel:
    """Placements of the model, with the SUs that it has or that are assumed."""
    import pinocchio as pin

    if told.sus:
        bodies = [f.name for f in joints.model.frames if f.type == pin.FrameType.BODY]
        links = [name for name in bodies if fnmatchcase(name, told.sus)]
        if not links:
            raise UsageError(
                f'no link of the model fits "{told.sus}"',
                f"its links are {', '.join(bodies[:8])}{' ..' if len(bodies) > 8 else ''}",
            )
        sus = sus_on_links(joints.model, links)
    else:
        sus = usual_sus(joints.model, [int(p) for p in joints.parent])
    return kinematic_model(joints.model, list(joints.prismatic), told.R_world_base, sus)


def _tilted(model: KinematicModel, told: Told) -> KinematicModel:
    """A calibrated robot with its base tilted as is told."""
    T = np.eye(4)
    T[:3, :3] = told.R_world_base
    on_base = model.tree.parent < 0
    sus_on_base = model.tree.su_joint < 0
    return replace(
        model,
        T_parent_joint=np.where(
            on_base[:, None, None], T @ model.T_parent_joint, model.T_parent_joint
        ),
        T_joint_su=np.where(sus_on_base[:, None, None], T @ model.T_joint_su, model.T_joint_su),
    )
