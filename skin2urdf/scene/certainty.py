"""How well a calibration knows where things are: ellipsoids, and lines that stay open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.scene.solids import Mesh, ellipsoid

_LARGEST = 0.06
"""Largest semi-axis that is drawn, over the robot's extent: seen, and hiding nothing."""
_STEPS = (1.0, 2.0, 5.0)
_NOT_SEEN = 1e-9
"""Standard deviation below which nothing is known of it, as along a joint's own axis [m]."""
_ANY = 6
"""Open directions of an SU of which nothing is known."""


@dataclass(frozen=True, eq=False)
class Cloud(Record):
    """Where something is, as one standard deviation of its position.

    Attributes:
        name: of the joint or SU.
        center: (3,) in the base frame [m].
        axes: (3, 3) columns are semi-axes in the base frame [m].
    """

    name: str
    center: F64
    axes: F64

    @property
    def size(self) -> float:
        """Its longest semi-axis [m]."""
        return float(np.linalg.norm(self.axes, axis=0).max())

    def mesh(self, times: float) -> Mesh:
        """Its surface, drawn so many times as large."""
        return ellipsoid(self.center, times * self.axes)


@dataclass(frozen=True, eq=False)
class OpenLine(Record):
    """A direction that the log leaves open.

    Attributes:
        name: of the joint or SU.
        through: (3,) where it is, in the base frame [m].
        direction: (3,) unit vector: along it, or the axis of the turn that is open.
        turn: True where a turn is open and not a place.
    """

    name: str
    through: F64
    direction: F64
    turn: bool


def clouds(frames: Mapping[str, F64], parts: Mapping[str, Any]) -> list[Cloud]:
    """Ellipsoids of all parts whose place is known to some deviation.

    Args:
        frames: (4, 4) frames in the base frame, by name.
        parts: ``joints`` or ``sus`` of a calibration's JSON, with a 6 x 6 ``covariance`` each, in
            the part's own frame, linear part first.
    """
    found = []
    for name, part in parts.items():
        if name not in frames or part["covariance"] is None:
            continue
        covariance = np.array(part["covariance"], dtype=np.float64)[:3, :3]
        if not np.isfinite(covariance).all():
            continue
        variance, vectors = np.linalg.eigh(covariance)
        axes = vectors * np.sqrt(variance.clip(min=0.0))
        if np.linalg.norm(axes, axis=0).max() > _NOT_SEEN:
            T = frames[name]
            found.append(Cloud(name, T[:3, 3], T[:3, :3] @ axes))
    return found


def magnification(clouds: list[Cloud], extent: float) -> float:
    """How many times as large ellipsoids are drawn: 1, 2 or 5 times a power of ten.

    Args:
        clouds: what is drawn.
        extent: size of the robot [m].
    """
    largest = max((cloud.size for cloud in clouds), default=0.0)
    if largest <= 0:
        return 1.0
    wanted = _LARGEST * extent / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * power for step in _STEPS if step * power <= wanted * (1 + 1e-9)))


def open_lines(frames: Mapping[str, F64], observability: Mapping[str, Any]) -> list[OpenLine]:
    """Lines along which the log leaves SUs and branches open.

    An SU of which nothing at all is known has none: it may be anywhere.

    Args:
        frames: (4, 4) frames of joints and SUs in the base frame, by name.
        observability: that of a calibration's JSON; twists in the part's own frame, linear part
            first.
    """
    found = []
    for name, su in observability["sus"].items():
        twists = np.array(su["unobservable"], dtype=np.float64).reshape(-1, 6)
        if name in frames and len(twists) < _ANY:
            found += [_line(name, frames[name], twist) for twist in twists]
    for direction in observability["between_branches"]:
        for name, twist in (*direction["joints"].items(), *direction["sus"].items()):
            if name in frames:
                found.append(_line(name, frames[name], np.array(twist, dtype=np.float64)))
    return found


def _line(name: str, T: F64, twist: F64) -> OpenLine:
    """What one twist (6,) of a part with frame T leaves open."""
    linear, angular = twist[:3], twist[3:]
    turn = bool(np.linalg.norm(angular) > np.linalg.norm(linear))
    along = angular if turn else linear
    return OpenLine(name, T[:3, 3], T[:3, :3] @ along / np.linalg.norm(along), turn)
