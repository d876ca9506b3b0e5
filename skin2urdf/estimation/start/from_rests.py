"""A start without patterns: orientations from gravity over rests and slow motion, offsets zero."""

from __future__ import annotations

import numpy as np

from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.start.orientation import Orientations
from skin2urdf.structure.from_motion import MotionTree


def state_of(found: MotionTree) -> State:
    """The state with a tree's directions and sensors, and every origin in the base's origin.

    Args:
        found: a tree from motion; the state is one of ``found.tree``.
    """
    U = found.tree.n_sus
    known = Orientations(
        found.axes, found.R_base_su, found.up, np.zeros((U, 3, 3)), *np.zeros((2, U))
    )
    plain = known.state(found.tree)
    return State(plain.T_parent_joint, plain.T_joint_su, plain.up, found.bias, found.shape)
