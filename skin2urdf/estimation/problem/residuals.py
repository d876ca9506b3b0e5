"""Whitened residuals of some SUs and their derivatives, in arrays as long as their chains need.

SUs are independent of each other given the joints, so a cost is evaluated group by group: SUs with
chains of like length share arrays that hold little padding and fit the processor's caches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.problem.blocks import FeatureBlocks
from skin2urdf.estimation.problem.state import N_JOINT, N_PLACEMENT, N_SU
from skin2urdf.geometry.so3 import cross
from skin2urdf.model.prediction import (
    Chains,
    SuKinematics,
    joint_twists,
    su_kinematics,
    twist_maps,
    wrenches,
)

BLOCKS_AT_ONCE = 200
"""Blocks, of one SU in one pose each, that are evaluated at once."""


@dataclass(frozen=True, eq=False)
class Point:
    """Where a cost is evaluated: what all SUs share, and the SUs' own placements and sensors.

    Attributes:
        R: (P, D, 3, 3) joint frames.
        p: (P, D, 3) joint origins [m].
        R_zero: (P, D, 3, 3) and
        p_zero: (P, D, 3), the same with each joint's own motion undone.
        joint_basis: (D, 6, 4) twists of the joints' coordinates.
        up: (P, 3) specific force of a resting body in the base frame [m/s^2].
        log: (P,) log of each pose, and
        turns: (G - 1, 3, 2) turns of gravity per coordinate of each log but the first.
        prismatic: (D,) True for prismatic joints.
        T_joint_su: (U, 4, 4) SU placements, and
        su_basis: (U, 6, 6) twists of their coordinates.
        bias: (U, 3) [m/s^2].
        sensor: (U, 3, 3) sensor matrices.
    """

    R: F64
    p: F64
    R_zero: F64
    p_zero: F64
    joint_basis: F64
    up: F64
    log: Int
    turns: F64
    prismatic: Bool
    T_joint_su: F64
    su_basis: F64
    bias: F64
    sensor: F64


class SuGroup:
    """Features of u SUs with chains of L joints at most.

    Attributes:
        sus: (u,) which SUs of the problem they are.
        chains: their chains, m = 1 + 2 L rows.
        columns: (u, 4 L + 2 (G - 1)) indices of their columns in the joint part of the problem.
    """

    def __init__(self, blocks: FeatureBlocks, sus: Int, n_joints: int, n_logs: int) -> None:
        length = blocks.chains.length[sus]
        L, longest = max(1, int(length.max(initial=0))), blocks.chains.joint.shape[1]
        of = blocks.chains
        self.sus = sus
        self.chains = Chains(
            of.joint[sus, :L], of.present[sus, :L], length, of.prismatic[sus, :L]
        )  # fmt: skip
        rows = np.r_[0, 1 : 1 + L, 1 + longest : 1 + longest + L]
        self.su_joint = blocks.su_joint[sus]
        self.W = blocks.W[:, sus[:, None, None], rows[:, None], rows]
        self.weight = 1 / blocks.noise[:, sus]
        self.target = blocks.target[:, sus[:, None], rows] * self.weight[:, :, None]
        self.columns = columns_of(self.chains, n_joints, n_logs)
        index = self.chains.present.cumsum(axis=1) - 1
        before = index[:, :, None] < index[:, None, :]
        first = np.ones_like(before[:, :1])
        #: (1, u, m, 1, L, 1) True where a row's joint lies before the column's placement.
        self.before = np.concatenate([first, before, before], axis=1)[None, :, :, None, :, None]
        #: (D, u L) 1 where an SU's chain has a joint.
        incidence = np.zeros((n_joints, len(sus), L))
        u, k = np.nonzero(self.chains.present)
        incidence[self.chains.joint[u, k], u, k] = 1.0
        self.incidence = incidence.reshape(n_joints, -1)

    def at(self, point: Point) -> Residuals:
        """Residuals at a point."""
        T = point.T_joint_su[self.sus]
        kin = su_kinematics(self.chains, self.su_joint, point.R, point.p, T, point.up)
        return self.read(point, kin, kin.features())

    def read(self, point: Point, kin: SuKinematics, Y: F64) -> Residuals:
        """Residuals of features Y (P, u, m, 3), which its kinematics make, in the sensors."""
        GT = np.swapaxes(point.sensor[self.sus], -1, -2) * self.weight[:, :, None, :]
        shift = (point.bias[self.sus] * self.weight)[:, :, None]
        residual = self.W @ (Y @ GT) - self.target + self.W[..., :1] * shift
        return Residuals(self, point, kin, Y, GT, residual)


def columns_of(chains: Chains, n_joints: int, n_logs: int) -> Int:
    """(U, 4 L + 2 (G - 1)) columns of chains' joints, and of the logs, in the joint part."""
    U, L = chains.joint.shape
    own = chains.joint[..., None] * N_JOINT + np.arange(N_JOINT)
    logs = n_joints * N_JOINT + np.arange(2 * (n_logs - 1))
    return np.concatenate([own.reshape(U, L * N_JOINT), np.tile(logs, (U, 1))], axis=1)


def groups_of(blocks: FeatureBlocks, n_joints: int, n_logs: int) -> tuple[SuGroup, ...]:
    """Groups of SUs with chains of like length."""
    P, U = blocks.count.shape
    order = np.argsort(blocks.chains.length, kind="stable")
    n_groups = -(-P * U // BLOCKS_AT_ONCE)
    return tuple(
        SuGroup(blocks, np.sort(sus), n_joints, n_logs)
        for sus in np.array_split(order, max(1, n_groups))
    )


@dataclass(frozen=True, eq=False)
class Adjoint:
    """Gradient of half the sum of squared residuals, before it is put into coordinates.

    Attributes:
        joints: (P, D, 6) force and moment about the base's origin on each joint's placement, in
            the base frame.
        gravity: (P, 3) moment on the direction of gravity, in the base frame.
        placement: (u, 6) gradient in the SUs' placements.
        bias: (u, 3) and
        sensor: (u, 3, 3), gradients in bias and sensor matrix.
    """

    joints: F64
    gravity: F64
    placement: F64
    bias: F64
    sensor: F64


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of a group at one point; derivatives are computed on request.

    Attributes:
        group: the SUs.
        point: where.
        kin: their kinematics.
        Y: (P, u, m, 3) predicted features.
        GT: (P, u, 3, 3) transposed sensor matrices over the noise.
        residual: (P, u, m, 3) whitened residuals [standard deviations].
    """

    group: SuGroup
    point: Point
    kin: SuKinematics
    Y: F64
    GT: F64
    residual: F64

    def adjoint(self) -> Adjoint:
        """The gradient, in time linear in the chains' lengths."""
        kin, point, group = self.kin, self.point, self.group
        # Adjoint of the whitening: what each feature row contributes per unit change.
        raw = np.swapaxes(group.W, -1, -2) @ self.residual
        at_su, at_joints, at_gravity = wrenches(kin, self.Y, raw @ np.swapaxes(self.GT, -1, -2))
        P, u, L = kin.w.shape[:3]
        Rt = np.swapaxes(kin.R, -1, -2)
        base = (at_joints.reshape(P, u, 2 * L, 3) @ Rt).reshape(P, u, L, 6)
        base[..., 3:] += cross(kin.p[:, :, None], base[..., :3])
        weighted = raw * group.weight[:, :, None]
        return Adjoint(
            joints=group.incidence @ base.reshape(P, u * L, 6),
            gravity=-(at_gravity[:, :, None] @ Rt)[:, :, 0].sum(axis=1),
            placement=np.einsum("uij,ui->uj", point.su_basis[group.sus], at_su.sum(axis=0)),
            bias=weighted[:, :, 0].sum(axis=0),
            sensor=(np.swapaxes(weighted, -1, -2) @ self.Y).sum(axis=0),
        )

    def jacobian(self) -> F64:
        """(u, P m 3, C + 15) derivatives of the residuals, the joint part's columns first."""
        raw = self.feature_jacobian()
        P, u, m, _, n = raw.shape
        J = (self.group.W @ raw.reshape(P, u, m, 3 * n)).reshape(P, u, m * 3, n)
        return np.swapaxes(J, 0, 1).reshape(u, P * m * 3, n)

    def feature_jacobian(self) -> F64:
        """(P, u, m, 3, C + 15) derivatives of the features over the noise, before whitening."""
        group, point = self.group, self.point
        moved, turned = twist_maps(self.kin)
        P, u, m = moved.shape[:3]
        L = self.kin.w.shape[2]
        n_joint, C = L * N_JOINT, group.columns.shape[1]
        G = np.swapaxes(self.GT, -1, -2)[:, :, None]
        moved, turned = G @ moved, G @ turned
        twists = joint_twists(
            group.chains, self.kin, point.R_zero, point.p_zero, point.joint_basis
        )  # fmt: skip
        X = np.swapaxes(twists, 2, 3).reshape(P, u, 6, n_joint)
        flat, apart = (P, u, m * 3, 6), (P, u, m, 3, L, N_JOINT)
        raw = np.zeros((P, u, m, 3, C + N_SU))
        raw[..., :n_joint] = np.where(
            group.before,
            (moved.reshape(flat) @ X).reshape(apart),
            (turned.reshape(flat) @ X).reshape(apart),
        ).reshape(P, u, m, 3, n_joint)
        if n_joint < C:
            raw[..., n_joint:C] = self._log_columns(turned)
        su = raw[..., C:]
        su[..., :N_PLACEMENT] = moved @ point.su_basis[group.sus][None, :, None]
        su[:, :, 0, :, 6:9] = np.eye(3) * group.weight[:, :, :, None]
        for i, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))):
            su[..., a, 9 + i] = self.Y[..., b] * group.weight[:, :, None, a]
            su[..., b, 9 + i] = self.Y[..., a] * group.weight[:, :, None, b]
        return raw

    def encoder_jacobian(self) -> F64:
        """(P, u, 3 m, 2 L) derivatives of the residuals in what the encoders say.

        First in the position of each joint of the SU's chain, then in the logarithm of its
        coefficients ``s_d`` and ``tau_d``.
        """
        point = self.point
        moved, turned = twist_maps(self.kin)
        P, u, m = moved.shape[:3]
        L, D = self.kin.w.shape[2], len(point.prismatic)
        about_z = np.zeros((D, 6, 1))
        about_z[np.arange(D), np.where(point.prismatic, 2, 5)] = 1.0
        twists = joint_twists(self.group.chains, self.kin, point.R_zero, point.p_zero, about_z)
        X = np.swapaxes(twists[..., 0], 2, 3)[:, :, None]
        rows = np.where(self.group.before[..., 0], moved @ X, turned @ X)
        own = np.zeros((P, u, m, 3, L))
        for i in range(L):
            for row in (1 + i, 1 + L + i):
                own[:, :, row, :, i] = self.Y[:, :, row]
        G = np.swapaxes(self.GT, -1, -2)[:, :, None]
        both = (G @ np.concatenate([rows, own], axis=-1)).reshape(P, u, m, 3 * 2 * L)
        return np.asarray((self.group.W @ both).reshape(P, u, 3 * m, 2 * L))

    def _log_columns(self, turned: F64) -> F64:
        """(P, u, m, 3, 2 (G - 1)) derivatives in the turns of gravity."""
        log, turns = self.point.log, self.point.turns
        Rt = np.swapaxes(self.kin.R, -1, -2)[:, :, None]
        B = np.concatenate([np.zeros((1, 3, 2)), turns])[log]
        columns = -(turned[..., 3:] @ (Rt @ B[:, None, None]))
        out = np.zeros((*columns.shape[:-1], len(turns) + 1, 2))
        out[np.arange(len(log)), :, :, :, log] = columns
        return out[..., 1:, :].reshape(*columns.shape[:-1], -1)
