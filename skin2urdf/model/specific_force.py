"""Readings along whole trajectories, and what they hold beyond first order around a pose."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.geometry.so3 import skew
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.model.prediction import Chains, su_kinematics
from skin2urdf.model.records import KinematicModel


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
    q, qd, qdd = (np.ascontiguousarray(x.T) for x in (q, qd, qdd))
    return np.ascontiguousarray(np.moveaxis(forces_in_time(model, q, qd, qdd, gravity_up), 2, 0))


def forces_in_time(model: KinematicModel, q: F64, qd: F64, qdd: F64, gravity_up: F64) -> F64:
    """The same, samples last: (U, 3, N) of (D, N) positions, velocities and accelerations."""
    tree = model.tree
    base = np.zeros((3, 3, q.shape[1]))
    base[2] = gravity_up[:, None]
    motion: list[F64] = []
    out = np.empty((tree.n_sus, 3, q.shape[1]))
    for j in range(-1, tree.n_joints):
        if j >= 0:
            p = int(tree.parent[j])
            T, slides = model.T_parent_joint[j], bool(tree.prismatic[j])
            parent = motion[p] if p >= 0 else base
            motion.append(_beyond_joint(parent, T, slides, q[j], qd[j], qdd[j]))
        sus = np.flatnonzero(tree.su_joint == j)
        if len(sus):
            out[sus] = _felt_by(model.T_joint_su[sus], motion[j] if j >= 0 else base)
    return out


def _felt_by(T: F64, motion: F64) -> F64:
    """(S, 3, N) specific force at frames T (S, 4, 4) that are fixed in a moving one.

    It is affine in the place r: ``f + A r``, with ``A r = a x r + w x (w x r)``. One product with
    A and f gives that of all.

    Args:
        T: the frames.
        motion: of the one they are fixed in, as in :func:`_at`.
    """
    w, (x, y, z), force = motion
    felt = np.empty((4, 3, motion.shape[2]))
    A = felt[:3]
    np.multiply(w[:, None], w, out=A)
    A[range(3), range(3)] -= (w * w).sum(axis=0)
    A[0, 1] -= z
    A[0, 2] += y
    A[1, 0] += z
    A[1, 2] -= x
    A[2, 0] -= y
    A[2, 1] += x
    felt[3] = force
    weight = np.empty((len(T), 3, 4, 3))
    weight[:, :, 3] = np.swapaxes(T[:, :3, :3], 1, 2)
    np.multiply(weight[:, :, 3, :, None], T[:, None, None, :3, 3], out=weight[:, :, :3])
    read = weight.reshape(-1, 12) @ felt.reshape(12, -1)
    return np.asarray(read.reshape(len(T), 3, -1))


def angular_velocities(model: KinematicModel, q: F64, qd: F64) -> F64:
    """Angular velocity of every SU along a trajectory.

    Args:
        model: the robot.
        q: (N, D) joint positions and velocities in the tree's order.
        qd: (N, D).

    Returns:
        (N, U, 3) in the SUs' frames [rad/s].
    """
    tree = model.tree
    frames: list[F64] = [np.zeros((3, len(q)))]
    for j, p in enumerate(tree.parent):
        x, y, z = model.T_parent_joint[j][:3, :3].T @ frames[int(p) + 1]
        if not tree.prismatic[j]:
            c, s = np.cos(q[:, j]), np.sin(q[:, j])
            x, y, z = c * x + s * y, c * y - s * x, z + qd[:, j]
        frames.append(np.stack([x, y, z]))
    seen = [
        T[:3, :3].T @ frames[int(j) + 1]
        for j, T in zip(tree.su_joint, model.T_joint_su, strict=True)
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(seen), 2, 0))


def _at(motion: F64, arm: F64) -> F64:
    """(3, N) specific force at a point that is fixed in a moving frame.

    Args:
        motion: (3, 3, N) the frame's angular velocity and acceleration, and the specific force at
            its origin, all in that frame; samples last, where NumPy is fastest.
        arm: (3,) the point [m].
    """
    w, wd, force = motion
    # wd x r + w x (w x r), where w x (w x r) = w (w . r) - r |w|^2.
    centripetal = w * (arm @ w) - np.multiply.outer(arm, (w * w).sum(axis=0))
    return np.asarray(force - skew(arm) @ wd + centripetal)


def _beyond_joint(motion: F64, T: F64, slides: bool, q: F64, qd: F64, qdd: F64) -> F64:
    """Motion (3, 3, N) of a joint's frame from that of its parent, each in its own frame.

    Args:
        motion: as in :func:`_at`.
        T: (4, 4) the joint's placement.
        slides: True for a prismatic joint.
        q: (N,) position, and
        qd: (N,) velocity, and
        qdd: (N,) acceleration along or about the joint's z axis.
    """
    (wx, wy, wz), (ax, ay, az), (fx, fy, fz) = (
        T[:3, :3].T @ part for part in (motion[0], motion[1], _at(motion, T[:3, 3]))
    )
    out = np.empty_like(motion)
    if slides:
        out[0], out[1] = (wx, wy, wz), (ax, ay, az)
        out[2, 0] = fx + (ay + wx * wz) * q + 2 * wy * qd
        out[2, 1] = fy + (wy * wz - ax) * q - 2 * wx * qd
        out[2, 2] = fz - (wx * wx + wy * wy) * q + qdd
        return out
    c, s = np.cos(q), np.sin(q)
    for turned, (x, y, z) in zip(out, ((wx, wy, wz), (ax, ay, az), (fx, fy, fz)), strict=True):
        turned[0], turned[1], turned[2] = c * x + s * y, c * y - s * x, z
    out[1, 0] += out[0, 1] * qd
    out[1, 1] -= out[0, 0] * qd
    out[1, 2] += qdd
    out[0, 2] += qd
    return out


def first_order(model: KinematicModel, q: F64, gravity_up: F64) -> F64:
    """What SUs read around a pose q (D,), per unit of [1, dq, qdd]: f0, s_d and tau_d.

    Args:
        model: the robot.
        q: (D,) the pose.
        gravity_up: (3,) as in :func:`specific_forces`.

    Returns:
        (1 + 2 D, U, 3) [m/s^2, m/s^2/rad, m/rad]; zero for DoFs that do not move an SU.
    """
    tree = model.tree
    chains = Chains.of(tree)
    pinocchio = PinocchioTree(tree)
    pinocchio.write_joints(model.T_parent_joint)
    R, p = pinocchio.joint_frames(q[None])
    kin = su_kinematics(chains, tree.su_joint, R, p, model.T_joint_su, gravity_up[None])
    rows = kin.features()[0]
    D, L = tree.n_joints, chains.joint.shape[1]
    out = np.zeros((1 + 2 * D, tree.n_sus, 3))
    u, k = np.nonzero(chains.present)
    out[0] = rows[:, 0]
    out[1 + chains.joint[u, k], u] = rows[u, 1 + k]
    out[1 + D + chains.joint[u, k], u] = rows[u, 1 + L + k]
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
    motion = np.concatenate([np.ones((len(dq), 1)), dq, qdd], axis=1)
    linear = np.tensordot(motion, first_order(model, q, gravity_up), 1)
    return np.asarray(specific_forces(model, q + dq, qd, qdd, gravity_up) - linear)
