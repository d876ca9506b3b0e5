"""Where joints and SUs are, by plain products of transforms."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.geometry.se3 import screw
from skin2urdf.model.records import KinematicModel
from skin2urdf.structure.records import KinematicTree


def joint_transform(tree: KinematicTree, joint: int, q: F64) -> F64:
    """(..., 4, 4) what a joint does to all it carries at positions q (...) [rad or m]."""
    return screw("z", 0.0, q) if tree.prismatic[joint] else screw("z", q, 0.0)


def joint_poses(model: KinematicModel, q: F64) -> F64:
    """(D + 1, ..., 4, 4) joint frames in the base frame at q (..., D); the last is the base's."""
    tree = model.tree
    T_base_joint = np.tile(np.eye(4), (tree.n_joints + 1, *q.shape[:-1], 1, 1))
    for j, parent in enumerate(tree.parent):
        moved = joint_transform(tree, j, q[..., j])
        T_base_joint[j] = T_base_joint[parent] @ model.T_parent_joint[j] @ moved
    return T_base_joint


def su_poses(model: KinematicModel, q: F64) -> F64:
    """(..., U, 4, 4) SU poses in the base frame at joint positions q (..., D) [rad or m]."""
    T_base_joint = joint_poses(model, q)[model.tree.su_joint]
    return np.asarray(np.moveaxis(T_base_joint, 0, -3) @ model.T_joint_su)
