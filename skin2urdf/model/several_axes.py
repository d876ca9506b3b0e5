"""Which SUs a recording could place on their joints: those that turn about several axes."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.model.records import KinematicModel


def turned_about_several_axes(model: KinematicModel, least: float) -> Bool:
    """(U,) True for SUs that joints turn about axes which are not all parallel.

    Along parallel axes no motion tells where an SU sits, and sliding does not tell it of any.

    Args:
        model: the robot.
        least: sine of the angle from which axes are not parallel.
    """
    tree = model.tree
    R: list[F64] = []
    for parent, T in zip(tree.parent, model.T_parent_joint, strict=True):
        R.append((R[parent] if parent >= 0 else np.eye(3)) @ T[:3, :3])
    # Axes that are parallel at position zero are so everywhere.
    axes = np.array([each[:, 2] for each in R]).reshape(-1, 3)
    chains = [tree.chain(int(joint)) for joint in tree.su_joint]
    turning = [[k for k in chain if not tree.prismatic[k]] for chain in chains]
    return np.array([_apart(axes[about], least) for about in turning], dtype=bool)


def _apart(axes: F64, least: float) -> bool:
    """Whether some of the unit vectors (n, 3) are not parallel to the first."""
    return bool((np.linalg.norm(np.cross(axes[:1], axes[1:]), axis=1) > least).any())
