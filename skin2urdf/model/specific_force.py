"""Readings along whole trajectories, and what they hold beyond first order around a pose."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.model.prediction import Chains, su_kinematics
from skin2urdf.model.records import KinematicModel
from skin2urdf.model.spatial import cross


def specific_forces(model: KinematicModel, q: F64, qd: F64, qdd: F64, gravity_up: F64) -> F64:
    """Specific force of every SU along a trajectory (paper eq. 1 to 3).

    Args:
        model: the robot.
        q: (N, D) joint positions, velocities and accelerations in the tree's order.
        qd: (N, D).
        qdd: (N, D).
        gravity_up: (3,) specific force of a resting body in the base frame [m/s^2].

    Returns:
        (N, U, 3) in the SUs' frames [m/s^2].
    """
    tree = model.tree
    N, D = q.shape
    w = np.zeros((N, D, 3))
    wd = np.zeros((N, D, 3))
    a = np.zeros((N, D, 3))
    R = np.zeros((N, D, 3, 3))
    for j in range(D):
        p = int(tree.parent[j])
        R_p = R[:, p] if p >= 0 else np.broadcast_to(np.eye(3), (N, 3, 3))
        w_p, wd_p, a_p = (x[:, p] if p >= 0 else np.zeros((N, 3)) for x in (w, wd, a))
        R_j = R_p @ model.T_parent_joint[j, :3, :3]
        z = R_j[..., 2]
        arm = R_p @ model.T_parent_joint[j, :3, 3]
        rate, acceleration = qd[:, j, None], qdd[:, j, None]
        if tree.joint_types[j] == "prismatic":
            arm = arm + q[:, j, None] * z
            R[:, j], w[:, j], wd[:, j] = R_j, w_p, wd_p
            coriolis = 2 * cross(w_p, z * rate)
            a[:, j] = a_p + cross(wd_p, arm) + cross(w_p, cross(w_p, arm)) + coriolis
            a[:, j] += z * acceleration
            continue
        c, s = np.cos(q[:, j])[:, None], np.sin(q[:, j])[:, None]
        R[:, j, :, 0] = c * R_j[..., 0] + s * R_j[..., 1]
        R[:, j, :, 1] = c * R_j[..., 1] - s * R_j[..., 0]
        R[:, j, :, 2] = z
        a[:, j] = a_p + cross(wd_p, arm) + cross(w_p, cross(w_p, arm))
        w[:, j] = w_p + z * rate
        wd[:, j] = wd_p + z * acceleration + cross(w_p, z * rate)
    out = np.empty((N, tree.n_sus, 3))
    for u, j in enumerate(tree.su_joint):
        T = model.T_joint_su[u]
        if j < 0:
            out[:, u] = gravity_up @ T[:3, :3]
            continue
        arm = R[:, j] @ T[:3, 3]
        total = a[:, j] + cross(wd[:, j], arm) + cross(w[:, j], cross(w[:, j], arm)) + gravity_up
        out[:, u] = (total[:, None] @ R[:, j] @ T[:3, :3])[:, 0]
    return out


def beyond_first_order(
    model: KinematicModel, q: F64, dq: F64, qd: F64, qdd: F64, gravity_up: F64
) -> F64:
    """Specific force minus its first-order part in (dq, qdd) around the pose q.

    Args:
        model: the robot.
        q: (D,) the pose.
        dq: (N, D) positions relative to it.
        qd: (N, D) velocities.
        qdd: (N, D) accelerations.
        gravity_up: (3,) as in :func:`specific_forces`.

    Returns:
        (N, U, 3) [m/s^2].
    """
    tree = model.tree
    chains = Chains.of(tree)
    pinocchio = PinocchioTree(tree)
    pinocchio.write_joints(model.T_parent_joint)
    R, p = pinocchio.joint_frames(q[None])
    kin = su_kinematics(chains, tree.su_joint, R, p, model.T_joint_su, gravity_up[None])
    rows = kin.features()[0]
    L = chains.joint.shape[1]
    linear = np.broadcast_to(rows[:, 0], (len(dq), tree.n_sus, 3)).copy()
    for u in range(tree.n_sus):
        n = int(chains.length[u])
        own = chains.joint[u, :n]
        linear[:, u] += dq[:, own] @ rows[u, 1 : 1 + n] + qdd[:, own] @ rows[u, 1 + L : 1 + L + n]
    return np.asarray(specific_forces(model, q + dq, qd, qdd, gravity_up) - linear)
