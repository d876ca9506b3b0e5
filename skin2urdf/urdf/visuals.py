"""Simple shapes that let a viewer show a robot of which only axes and SUs are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.geometry.se3 import screw
from skin2urdf.model.records import KinematicModel

COLOURS: dict[str, tuple[float, float, float, float]] = {
    "link_grey": (0.72, 0.74, 0.77, 1.0),
    "joint_slate": (0.33, 0.38, 0.45, 1.0),
    "su_teal": (0.10, 0.55, 0.52, 1.0),
}
"""Materials by name, as RGBA in [0, 1]."""

_SMALLEST = 1e-4  # [m]; shorter links are not drawn


@dataclass(frozen=True, eq=False)
class Shape(Record):
    """One coloured solid in the frame of its link.

    Attributes:
        kind: "cylinder" (along z) or "box".
        size: cylinder: (2,) radius, length; box: (3,) edges [m].
        T_link_shape: (4, 4) pose of the solid's centre in its link's frame.
        colour: a key of :data:`COLOURS`.
    """

    kind: Literal["cylinder", "box"]
    size: F64
    T_link_shape: F64
    colour: str


def thickness(model: KinematicModel) -> float:
    """Radius of the links [m]: a tenth of a typical distance between joints, 4 to 40 mm."""
    offsets = [*model.T_parent_joint[:, :3, 3], *model.T_joint_su[:, :3, 3]]
    lengths = [float(np.linalg.norm(p)) for p in offsets]
    visible = [length for length in lengths if length > _SMALLEST]
    return float(np.clip(0.1 * np.median(visible), 0.004, 0.04)) if visible else 0.02


def link_shapes(model: KinematicModel, joint: int, radius: float) -> tuple[Shape, ...]:
    """Shapes of one segment: a drum on its axis, rods to child joints, stalks to SUs.

    Args:
        model: the robot.
        joint: the joint that carries the segment, -1 for the base.
        radius: of the rods [m], see :func:`thickness`.

    Returns:
        Shapes in the frame of the segment's joint (of the base for -1).
    """
    drum = Shape("cylinder", np.array([1.4, 2.8]) * radius, np.eye(4), "joint_slate")
    shapes = [drum] if joint >= 0 else []
    children = model.T_parent_joint[model.tree.parent == joint, :3, 3]
    for child in children:
        shapes += _rod(np.zeros(3), child, radius)
    for su in model.T_joint_su[model.tree.su_joint == joint, :3, 3]:
        shapes += _rod(_nearest(su, children), su, 0.25 * radius)
    return tuple(shapes)


def su_shapes(radius: float) -> tuple[Shape, ...]:
    """A flat hexagon in the SU's xy plane.

    URDF has no prism, but three boxes as wide as the hexagon's side, as long as the distance of
    two opposite sides and turned by 60 deg cover it exactly.

    Args:
        radius: of the robot's rods [m]; the hexagon's sides are as long.
    """
    size = np.array([radius, np.sqrt(3.0) * radius, 0.3 * radius])
    turns = np.deg2rad([0.0, 60.0, 120.0])
    return tuple(Shape("box", size, screw("z", turn, 0.0), "su_teal") for turn in turns)


def _nearest(point: F64, ends: F64) -> F64:
    """(3,) the point nearest to ``point`` on the lines from the origin to ``ends`` (n, 3) [m]."""
    square = np.maximum(np.sum(ends**2, axis=-1), _SMALLEST**2)
    along = np.clip(ends @ point / square, 0.0, 1.0)
    candidates = np.vstack([np.zeros((1, 3)), along[:, None] * ends])
    return np.asarray(candidates[np.argmin(np.linalg.norm(candidates - point, axis=-1))])


def _rod(start: F64, end: F64, radius: float) -> list[Shape]:
    """A cylinder from ``start`` to ``end`` (3,) [m]; none where there is no way to go."""
    length = float(np.linalg.norm(end - start))
    if length < _SMALLEST:
        return []
    z = (end - start) / length
    # Any x will do that is not nearly along z.
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    T[:3, 3] = (start + end) / 2.0
    return [Shape("cylinder", np.array([radius, length]), T, "link_grey")]
