"""Robots as things that move: solids fixed to segments, and where the segments are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.geometry.se3 import inverse
from skin2urdf.output import document_beside
from skin2urdf.page.contents import laid_over, load_document
from skin2urdf.report.tables import number
from skin2urdf.scene.overlay import Overlay, alongside
from skin2urdf.scene.robot import BASE, Segment, drum, placed, plate, rods, segments, thickness
from skin2urdf.scene.solids import Mesh, merged
from skin2urdf.scene.stage import chains, side_by_side
from skin2urdf.urdf.loading import Robot, load_robot

_HALF_TURN = float(np.pi)
_ANYWHERE = 0.5
"""Range of a slide without limits, either way [m]."""


@dataclass(frozen=True, eq=False)
class Actor:
    """A robot that is shown.

    Attributes:
        robot: the robot.
        moved: (4, 4) where the base frame of each segment stands, by joint.
        links: solids of each segment in its own frame, by joint.
        joints: drums of its joints likewise.
        sus: of each SU its segment and its solid in the segment's frame.
    """

    robot: Robot
    moved: Mapping[str, F64]
    links: Mapping[str, Mesh]
    joints: Mapping[str, Mesh]
    sus: Mapping[str, tuple[str, Mesh]]

    def frames(self, positions: Mapping[str, float]) -> dict[str, F64]:
        """(4, 4) frames of all segments, by joint, with joints at given positions."""
        own = placed(self.robot, positions)
        return {name: self.moved[name] @ T for name, T in own.items() if name in self.moved}


@dataclass(frozen=True, eq=False)
class Play:
    """One or two robots, and what is known of them.

    Attributes:
        first: the first robot.
        second: another one laid over it; None for none.
        limits: range of the slider of each joint of either robot [rad or m].
        prismatic: the joints that slide.
        about: lines on each SU of the first robot.
        title: what is shown.
    """

    first: Actor
    second: Actor | None
    limits: Mapping[str, tuple[float, float]]
    prismatic: frozenset[str]
    about: Mapping[str, tuple[str, ...]]
    title: str

    @property
    def middle(self) -> dict[str, float]:
        """All joints in the middle of their ranges."""
        return {name: 0.5 * (low + high) for name, (low, high) in self.limits.items()}


def load_play(urdf: str | Path, other: str | Path | None = None) -> Play:
    """Load a robot, and another one to lay over it.

    Args:
        urdf: any URDF; what `skin2urdf calibrate` wrote comes with its JSON.
        other: another one.

    Raises:
        UnreadableInputError: one can not be read.
    """
    robot = load_robot(urdf)
    document = load_document(urdf) if document_beside(urdf) else None
    laid = laid_over(urdf, other)
    named = None if document is None else set(document["sus"])
    parts = segments(robot, named)
    limits = {name: _range(robot, name) for name in robot.joint_types}
    if document is not None:
        # The limits in the URDF of a calibration are placeholders; its JSON has what the log saw.
        limits |= {
            name: (float(joint["limits"][0]), float(joint["limits"][1]))
            for name, joint in document["joints"].items()
            if name in limits
        }
    middle = {name: 0.5 * (low + high) for name, (low, high) in limits.items()}
    own = placed(robot, middle)
    chain = chains(parts)
    if laid is None:
        beside = side_by_side(parts, own)
        moved = {name: beside.get((*path, BASE)[0], np.eye(4)) for name, path in chain.items()}
    else:
        moved = {name: laid.limb(path) for name, path in chain.items()}
    radius = thickness(parts)
    first = Actor(
        robot,
        moved,
        {part.joint: merged(rods(part, radius)) for part in parts},
        {part.joint: drum(radius) for part in parts if part.joint in robot.joint_types},
        {su: (p.joint, plate(T, radius)) for p in parts for su, T in p.sus.items()},
    )
    second = None if laid is None else _second(laid, first, parts, middle, radius)
    if laid is not None:
        more = {name: _range(laid.robot, name) for name in laid.robot.joint_types}
        limits = more | limits
    kinds = (laid.robot.joint_types if laid else {}) | robot.joint_types
    return Play(
        first,
        second,
        limits,
        frozenset(name for name, kind in kinds.items() if kind == "prismatic"),
        {name: _about(name, joint, document, laid) for name, (joint, _) in first.sus.items()},
        f"{Path(urdf).name}{f' and {Path(other).name}' if other else ''}",
    )


def _range(robot: Robot, joint: str) -> tuple[float, float]:
    """Limits of a joint, or half a turn either way."""
    low, high = robot.limits[joint]
    reach = _ANYWHERE if robot.joint_types[joint] == "prismatic" else _HALF_TURN
    low = low if np.isfinite(low) else min(-reach, high - reach) if np.isfinite(high) else -reach
    return low, high if np.isfinite(high) else max(reach, low + reach)


def _second(
    laid: Overlay,
    first: Actor,
    parts: tuple[Segment, ...],
    middle: Mapping[str, float],
    radius: float,
) -> Actor:
    """The other robot, with its joints where the first one has them on the same axes."""
    joints = first.frames(middle)
    sus = {name: joints[part.joint] @ T for part in parts for name, T in part.sus.items()}
    own = placed(laid.robot, middle)
    links: dict[str, Mesh] = {}
    plates: dict[str, tuple[str, Mesh]] = {}
    for part, T in alongside(laid.robot, middle, sus | joints):
        to_own = inverse(own[part.joint]) @ T
        links[part.joint] = merged(rods(part, 0.8 * radius)).moved(to_own)
        for name, T_su in part.sus.items():
            plates[name] = (part.joint, plate(T_su, 0.9 * radius).moved(to_own))
    return Actor(laid.robot, {name: np.eye(4) for name in own}, links, {}, plates)


def _about(
    name: str, joint: str, document: Mapping[str, Any] | None, laid: Overlay | None
) -> tuple[str, ...]:
    """Lines on an SU: where it sits, how well that is known, how far it is off."""
    lines = [f"on {joint or 'the base'}"]
    if document is not None:
        su = document["sus"][name]
        place = ", ".join(number(1e3 * row[3], 1) for row in su["T_joint_su"][:3])
        sd, turn = (_known(su[key]) for key in ("position_sd_mm", "orientation_sd_deg"))
        lines += [f"at {place} mm", f"sd {sd} mm, {turn} deg", su["verdict"]]
    if laid is not None and laid.comparison is not None:
        for error in laid.comparison.sus:
            if error.name == name:
                off = number(1e3 * error.position.rms, 3) if error.position else "-"
                turned = error.orientation.rms if error.orientation else float("nan")
                lines.append(f"off by {off} mm, {number(np.rad2deg(turned), 3)} deg rms")
    return tuple(lines)


def _known(value: float | None) -> str:
    """A deviation, a dash where there is none."""
    return number(float("nan") if value is None else value, 3)
