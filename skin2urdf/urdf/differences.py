"""Where two kinematic trees differ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.urdf.kinematics import kinematics
from skin2urdf.urdf.loading import Robot
from skin2urdf.urdf.records import Difference

_ALIKE = 1e-6
"""Bracket of two twists [m or 1] that rounding leaves where it vanishes."""


def tree_differences(est: Robot, true: Robot, sus: Sequence[str]) -> tuple[Difference, ...]:
    """Compare joint types, the joints that move SUs, the joints before each SU.

    Args:
        est: the estimated robot.
        true: the true robot.
        sus: the SUs to expect, links of the truth.

    Returns:
        One entry per difference; none where the trees are equal as far as SUs can tell.
    """
    shared = [name for name in est.joint_types if name in true.joint_types]
    differences = []
    for name in shared:
        kinds = est.joint_types[name], true.joint_types[name]
        if kinds[0] != kinds[1]:
            words = f"joint {name} is {kinds[0]}, but {kinds[1]} in the truth"
            differences.append(Difference("type", name, words, kinds[:1], kinds[1:]))
    differences += [
        Difference("extra joint", name, f"joint {name} is not in the truth")
        for name in est.joint_types
        if name not in shared
    ]
    for name in true.joint_types:
        moved = [] if name in shared else [su for su in sus if name in true.chain(su)]
        if moved:
            more = f" and {len(moved) - 1} more" if len(moved) > 1 else ""
            words = (
                f"joint {name} is not in the estimate; in the truth it moves SU {moved[0]}{more}"
            )
            differences.append(Difference("missing joint", name, words, right=tuple(moved)))
    for su in sus:
        if su not in est.links:
            differences.append(Difference("missing SU", su, f"SU {su} is not in the estimate"))
            continue
        found, right = (tuple(j for j in robot.chain(su) if j in shared) for robot in (est, true))
        if found != right and not _moves_alike(true, found, right):
            on = [", ".join(chain) or "no joint" for chain in (found, right)]
            words = f"SU {su} hangs on {on[0]}; in the truth on {on[1]}"
            differences.append(Difference("chain", su, words, found, right))
    if not sus:
        differences += _orders(est, true, shared)
    return tuple(differences)


def _moves_alike(robot: Robot, found: Sequence[str], right: Sequence[str]) -> bool:
    """Whether joints of a robot move what they carry alike in both orders.

    Two screw motions can be exchanged where the bracket of their twists vanishes: sliding joints,
    a joint that slides along the axis of one that turns, and axes on one line.
    """
    import pinocchio as pin

    if sorted(found) != sorted(right):
        return False
    _, axes = kinematics(robot, (), right, np.zeros((1, len(right))))
    twist = {name: pin.Motion(axis) for name, axis in zip(right, axes[0], strict=True)}
    left = list(found)
    for name in right:
        at = left.index(name)
        brackets = [twist[name].cross(twist[other]).vector for other in left[:at]]
        if any(np.abs(each).max() > _ALIKE for each in brackets):
            return False
        left.pop(at)
    return True


def _orders(est: Robot, true: Robot, shared: Sequence[str]) -> list[Difference]:
    """Joints that come after other joints than in the truth, where no SU shows it."""
    differences = []
    for name in shared:
        found, right = (
            tuple(j for j in robot.chain_of_joint(name)[:-1] if j in shared)
            for robot in (est, true)
        )
        if found != right:
            after = [", ".join(chain) or "the base" for chain in (found, right)]
            words = f"joint {name} comes after {after[0]}; in the truth after {after[1]}"
            differences.append(Difference("chain", name, words, found, right))
    return differences
