"""Poses, axes and placements of a loaded URDF at many configurations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.urdf.loading import Robot, configurations


def kinematics(
    robot: Robot, sus: Sequence[str], joints: Sequence[str], positions: F64
) -> tuple[F64, F64]:
    """Poses and axes of a robot at n configurations.

    Args:
        robot: the robot.
        sus: names of U links.
        joints: names of D joints.
        positions: (n, D) their positions [rad or m]; the others are neutral.

    Returns:
        (n, U, 4, 4) SU poses in the base frame, and (n, D, 6) columns of the joints' Jacobian
        there: for a revolute joint the axis w and ``v = -w x (any point of the axis)``, for a
        prismatic one v alone; linear part first.
    """
    import pinocchio as pin

    data = robot.model.createData()
    frames = [robot.frame(name) for name in sus]
    columns = [robot.model.joints[robot.model.getJointId(name)].idx_v for name in joints]
    T_base_su = np.empty((len(positions), len(sus), 4, 4))
    axes = np.empty((len(positions), len(joints), 6))
    for n, q in enumerate(configurations(robot, joints, positions)):
        # Pinocchio hands a matrix of one column over as a vector.
        jacobian = pin.computeJointJacobians(robot.model, data, q).reshape(6, robot.model.nv)
        axes[n] = jacobian[:, columns].T
        for u, frame in enumerate(frames):
            T_base_su[n, u] = pin.updateFramePlacement(robot.model, data, frame).homogeneous
    return T_base_su, axes


def placements(robot: Robot, moved: Sequence[str], joints: Sequence[str], positions: F64) -> F64:
    """(n, k, 4, 4) where k joints are placed in the base frame, before their own motion.

    Args:
        robot: the robot.
        moved: names of the k joints.
        joints: names of D joints.
        positions: (n, D) their positions [rad or m]; the others are neutral.
    """
    model = robot.model
    ids = [model.getJointId(name) for name in moved]
    T = np.empty((len(positions), len(moved), 4, 4))
    for n, oMi in enumerate(_frames(robot, joints, positions)):
        for i, joint in enumerate(ids):
            T[n, i] = (oMi[model.parents[joint]] * model.jointPlacements[joint]).homogeneous
    return T


def joint_poses(robot: Robot, wanted: Sequence[str], joints: Sequence[str], positions: F64) -> F64:
    """(n, k, 4, 4) frames that k joints carry, in the base frame.

    Args:
        robot: the robot.
        wanted: names of the k joints.
        joints: names of D joints.
        positions: (n, D) their positions [rad or m]; the others are neutral.
    """
    ids = [robot.model.getJointId(name) for name in wanted]
    T = np.empty((len(positions), len(wanted), 4, 4))
    for n, oMi in enumerate(_frames(robot, joints, positions)):
        for i, joint in enumerate(ids):
            T[n, i] = oMi[joint].homogeneous
    return T


def _frames(robot: Robot, joints: Sequence[str], positions: F64) -> Iterator[Any]:
    """Pinocchio's frames of all joints in the base frame, configuration by configuration."""
    import pinocchio as pin

    data = robot.model.createData()
    for q in configurations(robot, joints, positions):
        pin.forwardKinematics(robot.model, data, q)
        yield data.oMi
