"""Predicted features of every SU in every pose, and their exact derivatives.

A feature block of SU u in pose p has rows ``f0``, ``s_d`` for the L joints of the SU's chain, and
``tau_d`` for the same joints, each a vector in the SU's frame (paper eq. 1, 3, 15)::

    f0 = R_su_base g_up          s_d = f0 x w_d          tau_d = v_d

with ``(w_d, v_d)`` column d of the SU's LOCAL frame Jacobian. Derivatives follow from one fact:
moving the placement of joint k by a twist X (seen in the SU's frame) moves everything beyond k
rigidly, so it turns the columns before k and leaves the others alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.geometry.so3 import cross, skew
from skin2urdf.structure.records import KinematicTree


@dataclass(frozen=True, eq=False)
class Chains:
    """Chains of all SUs, padded to one length.

    Attributes:
        joint: (U, L) joint indices from the RS outwards; padding repeats index 0.
        present: (U, L) False where padded.
        length: (U,) number of joints before each SU.
        prismatic: (U, L) True for prismatic joints.
    """

    joint: Int
    present: Bool
    length: Int
    prismatic: Bool

    @staticmethod
    def of(tree: KinematicTree) -> Chains:
        """Chains of the SUs of ``tree``."""
        chains = [tree.chain(int(j)) for j in tree.su_joint]
        length = np.array([len(c) for c in chains], dtype=np.int64)
        L = max(1, int(length.max(initial=0)))
        joint = np.zeros((len(chains), L), dtype=np.int64)
        for u, c in enumerate(chains):
            joint[u, : len(c)] = c
        present = np.arange(L) < length[:, None]
        prismatic = tree.prismatic[joint] if tree.n_joints else np.zeros_like(present)
        return Chains(joint, present, length, prismatic & present)

    @property
    def n_rows(self) -> int:
        """Rows m = 1 + 2 L of a feature block."""
        return 1 + 2 * int(self.joint.shape[1])


@dataclass(frozen=True, eq=False)
class SuKinematics:
    """LOCAL frame Jacobians and gravity of all SUs in all poses.

    Attributes:
        R: (P, U, 3, 3) R_base_su.
        p: (P, U, 3) SU positions in the base frame [m].
        w: (P, U, L, 3) angular part of the LOCAL frame Jacobian; zero where padded.
        v: (P, U, L, 3) its linear part [m/rad, or 1 for prismatic joints].
        f0: (P, U, 3) specific force at rest [m/s^2].
    """

    R: F64
    p: F64
    w: F64
    v: F64
    f0: F64

    def features(self) -> F64:
        """(P, U, 1 + 2 L, 3) predicted feature blocks."""
        s = cross(self.f0[:, :, None], self.w)
        return np.concatenate([self.f0[:, :, None], s, self.v], axis=2)


def su_kinematics(
    chains: Chains,
    su_joint: Int,
    R_base_joint: F64,
    p_base_joint: F64,
    T_joint_su: F64,
    gravity_up: F64,
) -> SuKinematics:
    """Kinematics of all SUs from the joint frames of every pose.

    Args:
        chains: the SUs' chains.
        su_joint: (U,) joint each SU sits on, -1 for the base.
        R_base_joint: (P, D, 3, 3) joint frames.
        p_base_joint: (P, D, 3) joint origins [m].
        T_joint_su: (U, 4, 4) SU placements.
        gravity_up: (P, 3) specific force of a resting body in the base frame [m/s^2].
    """
    P = R_base_joint.shape[0]
    U = len(su_joint)
    on_base = su_joint < 0
    R_bj = np.empty((P, U, 3, 3))
    p_bj = np.empty((P, U, 3))
    R_bj[:, ~on_base] = R_base_joint[:, su_joint[~on_base]]
    p_bj[:, ~on_base] = p_base_joint[:, su_joint[~on_base]]
    R_bj[:, on_base], p_bj[:, on_base] = np.eye(3), 0.0
    R = R_bj @ T_joint_su[:, :3, :3]
    p = p_bj + (R_bj @ T_joint_su[:, :3, 3, None])[..., 0]

    z = R_base_joint[..., 2][:, chains.joint] * chains.present[..., None]
    arm = p[:, :, None] - p_base_joint[:, chains.joint]
    v = cross(z, arm)
    w = z
    if chains.prismatic.any():
        slide = chains.prismatic[..., None]
        v, w = np.where(slide, z, v), np.where(slide, 0.0, z)
    f0 = (gravity_up[:, None, None] @ R)[:, :, 0]
    return SuKinematics(R, p, w @ R, v @ R, f0)


def twist_maps(kin: SuKinematics) -> tuple[F64, F64]:
    """Linear maps from a twist of the SU's frame to the change of its feature block.

    A twist (linear, angular) is seen at the SU's origin in the SU's frame.

    Returns:
        ``moved`` (P, U, m, 3, 6), the change of rows whose joint lies before the moved placement,
        and ``turned`` (P, U, m, 3, 6), the change where only gravity turns (the joint lies at or
        beyond the placement and moves along with it).
    """
    P, U, L = kin.w.shape[:3]
    moved = np.zeros((P, U, 1 + 2 * L, 3, 6))
    turned = np.zeros_like(moved)
    S_f0, S_w = skew(kin.f0), skew(kin.w)
    moved[:, :, 0, :, 3:] = S_f0
    turned[:, :, 0, :, 3:] = S_f0
    moved[:, :, 1 : 1 + L, :, 3:] = skew(cross(kin.f0[:, :, None], kin.w))
    turned[:, :, 1 : 1 + L, :, 3:] = -S_w @ S_f0[:, :, None]
    moved[:, :, 1 + L :, :, :3] = S_w
    moved[:, :, 1 + L :, :, 3:] = skew(kin.v)
    return moved, turned


def wrenches(kin: SuKinematics, features: F64, e: F64) -> tuple[F64, F64, F64]:
    """What a cost with gradient e in the features feels of twists: the adjoint of `twist_maps`.

    Args:
        kin: kinematics of the SUs.
        features: (P, U, m, 3) their predicted features.
        e: (P, U, m, 3) gradient of the cost in them.

    Returns:
        Force and moment at the SUs' origins in their frames, per unit shift and turn of the SU's
        own placement (P, U, 6) and of each joint's placement before it (P, U, L, 6), and the
        moment per unit turn of everything but gravity (P, U, 3).
    """
    L = kin.w.shape[2]
    slopes, e_slopes, e_levers = features[:, :, 1 : 1 + L], e[:, :, 1 : 1 + L], e[:, :, 1 + L :]
    first = cross(e[:, :, 0], kin.f0)
    moved = np.empty((*kin.w.shape[:3], 6))
    moved[..., :3] = cross(e_levers, kin.w)
    moved[..., 3:] = cross(e_slopes, slopes) + cross(e_levers, kin.v)
    turned = cross(kin.f0[:, :, None], cross(e_slopes, kin.w))
    before = np.cumsum(moved, axis=2)
    up_to = np.cumsum(turned, axis=2)
    gravity = first + up_to[:, :, -1]
    at_su = before[:, :, -1].copy()
    at_su[..., 3:] += first
    at_joints = before - moved
    # Joints at or beyond a placement move along with it; only gravity turns past them.
    at_joints[..., 3:] += gravity[:, :, None] - up_to + turned
    return at_su, at_joints, gravity


def zero_frames(R_base_joint: F64, p_base_joint: F64, q: F64, prismatic: Bool) -> tuple[F64, F64]:
    """Joint frames with each joint's own motion undone: where its placement puts it.

    Args:
        R_base_joint: (P, D, 3, 3) joint frames.
        p_base_joint: (P, D, 3) joint origins [m].
        q: (P, D) joint positions.
        prismatic: (D,) True for prismatic joints.

    Returns:
        R (P, D, 3, 3) and p (P, D, 3) [m].
    """
    angle = np.where(prismatic, 0.0, q)
    c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
    R = R_base_joint.copy()
    R[..., 0] = c * R_base_joint[..., 0] - s * R_base_joint[..., 1]
    R[..., 1] = s * R_base_joint[..., 0] + c * R_base_joint[..., 1]
    return R, p_base_joint - np.where(prismatic, q, 0.0)[..., None] * R[..., 2]


def joint_twists(chains: Chains, kin: SuKinematics, R_zero: F64, p_zero: F64, basis: F64) -> F64:
    """Twists of the joint placements' local coordinates, seen in each SU's frame.

    Args:
        chains: the SUs' chains.
        kin: the SUs' kinematics.
        R_zero: (P, D, 3, 3) joint frames with their own motion undone (:func:`zero_frames`).
        p_zero: (P, D, 3) their origins [m].
        basis: (D, 6, B) twist (linear, angular) of each of B coordinates in the joint's frame.

    Returns:
        (P, U, L, 6, B) twists at the SU's origin in the SU's frame; zero where padded.
    """
    R_base_su = kin.R[:, :, None]
    R_su_joint = np.swapaxes(R_base_su, -1, -2) @ R_zero[:, chains.joint]
    arm = ((kin.p[:, :, None] - p_zero[:, chains.joint])[..., None, :] @ R_base_su)[..., 0, :]
    local = basis[chains.joint] * chains.present[..., None, None]
    angular = R_su_joint @ local[..., 3:, :]
    linear = R_su_joint @ local[..., :3, :] - skew(arm) @ angular
    return np.concatenate([linear, angular], axis=-2)
