"""Models in canonical joint frames: the extended Denavit-Hartenberg form of a whole robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.geometry.dh import PARALLEL_SINE, joint_placement, prismatic_placement
from skin2urdf.model.records import KinematicModel


def canonical(model: KinematicModel, parallel_sine: float = PARALLEL_SINE) -> KinematicModel:
    """Rewrite a model into canonical joint frames; the robot stays the same.

    Every joint gets the frame of :func:`skin2urdf.geometry.dh.joint_placement` or
    ``prismatic_placement`` (the shortest representative of its axis), and what it carries is moved
    the other way. The base frame stays, so do joint zeros, senses and the pose of every SU at
    every configuration.

    Args:
        model: D joints, U SUs.
        parallel_sine: see :func:`skin2urdf.geometry.dh.dh_of_placement`.

    Returns:
        The same robot in canonical frames; applying this function again changes nothing.
    """
    tree = model.tree
    # Index -1 of both arrays is the reference segment, whose frame is fixed.
    T_canonical_given = np.tile(np.eye(4), (tree.n_joints + 1, 1, 1))
    T_parent_joint = np.empty_like(model.T_parent_joint)
    for j, parent in enumerate(tree.parent):
        given = T_canonical_given[parent] @ model.T_parent_joint[j]
        rule = prismatic_placement if tree.prismatic[j] else joint_placement
        dh, T_canonical_given[j] = rule(given, parallel_sine)
        T_parent_joint[j] = dh.placement()
    T_joint_su = T_canonical_given[tree.su_joint] @ model.T_joint_su
    return replace(model, T_parent_joint=T_parent_joint, T_joint_su=T_joint_su)
