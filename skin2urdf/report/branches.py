"""What a log does not tell of branches relative to each other, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.model.records import KinematicModel, OpenDirection
from skin2urdf.report.words import (
    PARALLEL,
    TILT_REMEDY,
    VERTICAL,
    Cause,
    Unknown,
    frames_at_zero,
    largest_angle,
    listed,
    more,
)

_NAMED = 3


def between_branches(
    model: KinematicModel, directions: Sequence[OpenDirection], up: F64
) -> tuple[Unknown, ...]:
    """Put the open directions between branches into words, one for each.

    Args:
        model: the robot.
        directions: its open directions, in the same frames.
        up: (G, 3) unit vector opposite to gravity in the base frame, per log.
    """
    return tuple(
        _of_branch(model, *next(iter(each.joints.items())), up)
        if len(each.joints) == 1 and not each.sus
        else _of_several(model, each)
        for each in directions
    )


def _of_branch(model: KinematicModel, joint: str, xi: F64, up: F64) -> Unknown:
    """A joint and all that lies beyond it move by a twist (6,) in the joint's frame."""
    tree = model.tree
    j = tree.joint_names.index(joint)
    chain = tree.chain(int(tree.parent[j]))
    names = [tree.joint_names[k] for k in chain]
    sus = [tree.su_names[u] for u, on in enumerate(tree.su_joint) if j in tree.chain(int(on))]
    branch = f"the branch beyond {joint} ({_some(sus)})"

    frames = frames_at_zero(model)
    turns = np.linalg.norm(xi[3:]) > 0.5
    axis = frames[j, :3, :3] @ (xi[3:] if turns else xi[:3])
    turning = [k for k in chain if not tree.prismatic[k]]
    along = [k for k in turning if _parallel(frames[k, :3, 2], axis)]
    if not along:
        why = f"the motion of {listed(names)} in this log is too small or too much alike"
        what = f"place of {branch} relative to its limb"
        return Unknown("pose", "little motion", what, why, more(names))
    about = tree.joint_names[along[0]]
    rest = f"relative to what else {about} moves"
    all_parallel = len(along) == len(turning)
    if turns:
        what = f"turn of {branch} about the axis of {about} {rest}"
        if all_parallel and largest_angle(up, axis / np.linalg.norm(axis)) < VERTICAL:
            why = "the axis is vertical"
            return Unknown("turn", "vertical axis", what, why, TILT_REMEDY, about)
        why = f"{listed(names)} moved too little in this log"
        return Unknown("turn", "little motion", what, why, more(names), about)
    what = f"place of {branch} along the axis of {about} {rest}"
    if not all_parallel:
        why = "the joints before it moved too little in this log"
        return Unknown("slide", "little motion", what, why, more(names), about)
    cause: Cause = "one joint"
    why = f"{about} is the only joint that turns both"
    if len(along) > 1:
        cause = "parallel axes"
        why = f"the axes of {listed([tree.joint_names[k] for k in along])} are parallel"
    return Unknown("slide", cause, what, f"{why}, so that no recording tells it", joint=about)


def _of_several(model: KinematicModel, direction: OpenDirection) -> Unknown:
    """Several placements move together."""
    tree = model.tree
    first, *rest = sorted(tree.joint_names.index(name) for name in direction.joints)
    name = tree.joint_names[first]
    if tree.parent[first] < 0 and not rest:
        why = "gravity alone tells it, and the bias of its SUs looks much the same"
        what = f"tilt of the axis of {name} against what it carries"
        return Unknown("tilt", "bias", what, why, TILT_REMEDY, name)
    if all(tree.parent[j] == first for j in rest):
        what = f"one direction of the axis of {name} relative to what it carries"
        why = f"{name} moved too little in this log"
        return Unknown("direction", "little motion", what, why, more([name]), name)
    before = sorted({k for j in (first, *rest) for k in tree.chain(j)})
    return Unknown(
        "direction",
        "little motion",
        f"one direction in which {_some([*direction.joints, *direction.sus])} move together",
        "the motion in this log is too small or too much alike",
        more([tree.joint_names[k] for k in before]),
    )


def _parallel(a: F64, b: F64) -> bool:
    """Whether two directions, the first of them a unit vector, are nearly parallel."""
    return bool(np.linalg.norm(np.cross(a, b)) < PARALLEL * np.linalg.norm(b))


def _some(names: Sequence[str]) -> str:
    """The first few names."""
    more_names = len(names) - _NAMED
    if more_names <= 1:
        return listed(names)
    return f"{', '.join(names[:_NAMED])} and {more_names} more"
