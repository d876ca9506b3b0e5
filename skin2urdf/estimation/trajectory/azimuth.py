"""How a robot and its base stand, turned as a whole: of turns about gravity, nothing shows.

Which way the x axis of the base points is a choice. A base that stands still has no other axes; one
that gives way yields more about some than about others, which are found along, and turn with it.
What is known of these before would tell the choice from others, as if the log did, so it is held.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import N_JOINT, State
from skin2urdf.estimation.trajectory.skeleton import joints_on_hinges
from skin2urdf.geometry.se3 import adjoint, inverse
from skin2urdf.structure.records import KinematicTree

_OF_JOINT = (0, 1, 3, 4)
"""Parts of a twist that are coordinates of a joint: all but those along and about its axis."""


def turned(tree: KinematicTree, state: State, axis: F64) -> tuple[F64, F64]:
    """The coordinates that turn all that stands on the base about an axis through its origin.

    Args:
        tree: D joints and U SUs.
        state: their placements.
        axis: (3,) unit vector in the base's frame.

    Returns:
        (D, 4) tx, ty [m], rx, ry [rad] of the joints, and (U, 6) twists of the SUs in their own
        frames [m, rad], per radian.
    """
    whole = np.concatenate([np.zeros(3), axis])
    joints, free = np.zeros((tree.n_joints, N_JOINT)), joints_on_hinges(tree)
    # What a joint can not do itself, since it is along or about its axis, those beyond have to.
    left = np.zeros((tree.n_joints, 6))
    for j, (parent, T) in enumerate(zip(tree.parent, state.T_parent_joint, strict=True)):
        left[j] = adjoint(inverse(T)) @ (left[parent] if parent >= 0 else whole)
        joints[j] = np.where(free[j], left[j, _OF_JOINT], 0.0)
        left[j, _OF_JOINT] -= joints[j]
        if parent < 0 and not tree.prismatic[j]:
            left[j, :2] = 0.0
    sus = [
        adjoint(inverse(T)) @ (left[j] if j >= 0 else whole)
        for j, T in zip(tree.su_joint, state.T_joint_su, strict=True)
    ]
    return joints, np.array(sus).reshape(-1, 6)
