"""Readings along whole trajectories, and what they hold beyond first order around a pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.geometry.so3 import force_per_position, skew
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
    out = np.empty((q.shape[1], model.tree.n_sus, 3))
    for j, felt in felt_by_links(model, q, qd, qdd, gravity_up).items():
        sus = np.flatnonzero(model.tree.su_joint == j)
        out[:, sus] = (felt.T @ _weights(model.T_joint_su[sus]).T).reshape(len(out), -1, 3)
    return out


def forces_in_time(model: KinematicModel, q: F64, qd: F64, qdd: F64, gravity_up: F64) -> F64:
    """The same, samples last: (U, 3, N) of (D, N) positions, velocities and accelerations."""
    out = np.empty((model.tree.n_sus, 3, q.shape[1]))
    for j, felt in felt_by_links(model, q, qd, qdd, gravity_up).items():
        sus = np.flatnonzero(model.tree.su_joint == j)
        out[sus] = (_weights(model.T_joint_su[sus]) @ felt).reshape(len(sus), 3, -1)
    return out


def felt_by_links(
    model: KinematicModel, q: F64, qd: F64, qdd: F64, gravity_up: F64
) -> dict[int, F64]:
    """What links that carry SUs feel along a trajectory, by the joint that carries each.

    Specific force is affine in the place r: ``f + A r``, with ``A r = a x r + w x (w x r)``. So
    one product with A and f gives that of all SUs on a link.

    Args:
        model: the robot.
        q: (D, N) joint positions, velocities and accelerations, samples last.
        qd: (D, N).
        qdd: (D, N).
        gravity_up: (3,) as in :func:`specific_forces`.

    Returns:
        (12, N) the nine entries of A, and f; joint -1 stands for the ground.
    """
    tree = model.tree
    base = np.zeros((3, 3, q.shape[1]))
    base[2] = gravity_up[:, None]
    motion = [base]
    for j, p in enumerate(tree.parent.tolist()):
        T, slides = model.T_parent_joint[j], bool(tree.prismatic[j])
        motion.append(_beyond_joint(motion[p + 1], T, slides, q[j], qd[j], qdd[j]))
    return {j: _affine(motion[j + 1]) for j in np.unique(tree.su_joint).tolist()}


def _affine(motion: F64) -> F64:
    """(12, N) specific force in a moving frame: per position of a point (9), and at the origin.

    Args:
        motion: as in :func:`_at`.
    """
    w, wd, force = motion
    felt = np.empty((4, 3, motion.shape[2]))
    felt[:3], felt[3] = force_per_position(w, wd), force
    return felt.reshape(12, -1)


def _weights(T: F64, sensors: F64 | None = None) -> F64:
    """(3 S, 12) what makes the readings of SUs at T (S, 4, 4) of what their link feels.

    Args:
        T: placements on the link.
        sensors: (S, 3, 3) by which each reads what it feels in its frame; perfect by default.
    """
    read = np.swapaxes(T[:, :3, :3], 1, 2)
    if sensors is not None:
        read = sensors @ read
    weight = np.empty((len(T), 3, 4, 3))
    weight[:, :, 3] = read
    np.multiply(read[..., None], T[:, None, None, :3, 3], out=weight[:, :, :3])
    return weight.reshape(-1, 12)


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


@dataclass(frozen=True, eq=False)
class AroundPose:
    """What SUs read along a motion around a pose, to first order and beyond.

    Attributes:
        model: the robot.
        sensors: (U, 3, 3) by which each SU reads what it feels in its frame.
        felt: what links feel, see :func:`felt_by_links`.
        motion: (N, 1 + 2 D) a constant, positions relative to the pose, and accelerations.
        coefficients: (1 + 2 D, U, 3) what SUs read of these to first order.
    """

    model: KinematicModel
    sensors: F64
    felt: Mapping[int, F64]
    motion: F64
    coefficients: F64

    @staticmethod
    def of(
        model: KinematicModel,
        sensors: F64,
        q: F64,
        dq: F64,
        qd: F64,
        qdd: F64,
        gravity_up: F64,
    ) -> AroundPose:
        """Of a motion.

        Args:
            model: the robot.
            sensors: (U, 3, 3) as above.
            q: (D,) the pose.
            dq: (N, D) positions relative to it.
            qd: (N, D) velocities.
            qdd: (N, D) accelerations.
            gravity_up: (3,) as in :func:`specific_forces`.
        """
        motion = np.concatenate([np.ones((len(dq), 1)), dq, qdd], axis=1)
        linear = np.einsum("uij,nuj->nui", sensors, first_order(model, q, gravity_up))
        at, speed, push = (np.ascontiguousarray(x.T) for x in (q + dq, qd, qdd))
        felt = felt_by_links(model, at, speed, push, gravity_up)
        return AroundPose(model, sensors, felt, motion, linear)

    def beyond(self, sus: Int) -> F64:
        """(N, u, 3) what some SUs read beyond first order [m/s^2]."""
        out = np.empty((len(self.motion), len(sus), 3))
        joints = self.model.tree.su_joint[sus]
        for j in np.unique(joints).tolist():
            at = np.flatnonzero(joints == j)
            here = sus[at]
            read = self.felt[j].T @ _weights(self.model.T_joint_su[here], self.sensors[here]).T
            read -= self.motion @ self.coefficients[:, here].reshape(self.motion.shape[1], -1)
            out[:, at] = read.reshape(len(out), -1, 3)
        return out
