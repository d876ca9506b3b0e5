"""The height of a robot above its base's frame, which nothing shows, whatever the base does.

Where a first joint's frame lies along its axis is a choice. All that is known of a base that gives
way is how it turns about some point, and how far that is from the robot: the robot may stand
higher, and that point be lower by as much. A fit follows deflections by derivatives that leave out
what placements do to loads, of which such a shift needs all; so the height is held, and stated to
be open.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import N_JOINT, State
from skin2urdf.estimation.trajectory.skeleton import joints_on_hinges
from skin2urdf.structure.records import KinematicTree


def rise(tree: KinematicTree, state: State) -> tuple[F64, F64]:
    """The coordinates that move all that the joints carry along the first of the first axes.

    Args:
        tree: D joints and U SUs.
        state: their placements.

    Returns:
        (D, 4) tx, ty [m], rx, ry [rad] of the joints, of length 1 together, and (U, 3) of the SUs
        that no joint takes along, as those on a first link, in their own frames [m]; 0 where no
        joint can move that way.
    """
    joints, sus = np.zeros((tree.n_joints, N_JOINT)), np.zeros((tree.n_sus, 3))
    free = joints_on_hinges(tree)[:, :2]
    first = np.flatnonzero(tree.parent < 0)
    along = state.T_parent_joint[first[0], :3, 2] if len(first) else np.zeros(3)
    # What a joint can not do itself, since its axis is along it, those beyond have to.
    left = np.zeros((tree.n_joints, 3))
    for j, (parent, T) in enumerate(zip(tree.parent, state.T_parent_joint, strict=True)):
        left[j] = T[:3, :3].T @ (left[parent] if parent >= 0 else along)
        if parent < 0 and not tree.prismatic[j] and not free[j].any():
            left[j, :2] = 0.0
        joints[j, :2] = np.where(free[j], left[j, :2], 0.0)
        left[j] -= np.append(joints[j, :2], 0.0)
    size = float(np.linalg.norm(joints))
    if size == 0.0:
        return joints, sus
    for u, (j, T) in enumerate(zip(tree.su_joint, state.T_joint_su, strict=True)):
        if j >= 0:
            sus[u] = T[:3, :3].T @ left[j]
    return joints / size, sus / size
