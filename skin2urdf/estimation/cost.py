"""Chi-squared of a state against the features, with exact gradient and normal equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.blocks import FeatureBlocks
from skin2urdf.estimation.state import (
    N_JOINT,
    N_PLACEMENT,
    N_SU,
    State,
    Step,
    joint_motion,
    local_motion,
    turn_basis,
    turned_up,
)
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.model.prediction import (
    GRAVITY,
    SuKinematics,
    joint_twists,
    su_kinematics,
    twist_maps,
    zero_frames,
)
from skin2urdf.structure.records import KinematicTree


@dataclass(frozen=True, eq=False)
class Priors:
    """What is known of sensors before the log is read.

    Attributes:
        bias: standard deviation of each axis' bias [m/s^2]; 0 fixes it at zero.
        scale: standard deviation of each axis' scale error [1]; 0 fixes it.
        cross: standard deviation of the symmetric cross-axis terms [1]; 0 fixes them.
        position: expected size of the offsets between joints, and between joints and SUs [m].
            It keeps offsets that the log does not determine near zero, and is far too weak to
            matter for the others.
        gravity: magnitude of gravity [m/s^2].
    """

    bias: float = 0.5
    scale: float = 0.03
    cross: float = 0.01
    position: float = 1.0
    gravity: float = GRAVITY

    @property
    def deviations(self) -> F64:
        """(9,) standard deviations of bias and shape."""
        return np.array([self.bias] * 3 + [self.scale] * 3 + [self.cross] * 3)


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Gauss-Newton system in arrow form: one joint part, one independent part per SU.

    Attributes:
        joint: (J, J) information of the joint and log coordinates.
        joint_gradient: (J,).
        su: (U, 15, 15) information of each SU's coordinates.
        su_gradient: (U, 15).
        mixed: (U, 15, C) coupling of an SU with the joint coordinates ``columns``.
        columns: (U, C) indices into the joint part; padded entries couple with zero.
    """

    joint: F64
    joint_gradient: F64
    su: F64
    su_gradient: F64
    mixed: F64
    columns: Int


class Cost:
    """Chi-squared of states against whitened features.

    Holds no state of its own; a Pinocchio model is re-used between evaluations and its
    placements are written in place.
    """

    def __init__(self, tree: KinematicTree, blocks: FeatureBlocks, priors: Priors) -> None:
        self.tree, self.blocks, self.priors = tree, blocks, priors
        self._pinocchio = PinocchioTree(tree)
        self._weight = np.divide(1.0, blocks.noise)
        self.n_logs = int(blocks.log.max(initial=0)) + 1
        self.n_data = int(blocks.count.sum())
        deviations = priors.deviations
        self._prior = np.divide(1.0, deviations, out=np.zeros(9), where=deviations > 0)
        L = blocks.chains.joint.shape[1]
        joint_columns = blocks.chains.joint[..., None] * N_JOINT + np.arange(N_JOINT)
        log_columns = tree.n_joints * N_JOINT + np.arange(2 * (self.n_logs - 1))
        U = len(blocks.su_joint)
        self._columns = np.concatenate(
            [joint_columns.reshape(U, L * N_JOINT), np.tile(log_columns, (U, 1))], axis=1
        )
        index = blocks.chains.present.cumsum(axis=1) - 1
        self._before = (index[:, :, None] < index[:, None, :])[None]

    def at(self, state: State, step: Step | None = None) -> Evaluation:
        """Evaluate the cost at ``state`` moved by ``step``, with derivatives in the step."""
        blocks = self.blocks
        if step is None:
            step = self.zero_step()
        T_joint, joint_basis = joint_motion(step.joints)
        T_su, su_basis = local_motion(step.sus[:, :N_PLACEMENT])
        T_parent_joint = state.T_parent_joint @ T_joint
        T_joint_su = state.T_joint_su @ T_su
        up = turned_up(state.up, step.logs) * self.priors.gravity
        bias, shape = state.bias + step.sus[:, 6:9], state.shape + step.sus[:, 9:15]
        M = State(T_parent_joint, T_joint_su, up, bias, shape).sensor_matrix()
        self._pinocchio.write_joints(T_parent_joint)
        R, p = self._pinocchio.joint_frames(blocks.q)
        kin = su_kinematics(blocks.chains, blocks.su_joint, R, p, T_joint_su, up[blocks.log])
        Y = kin.features()
        GT = np.swapaxes(M, -1, -2) * self._weight[:, :, None, :]
        residual = blocks.W @ (Y @ GT) - blocks.target * self._weight[:, :, None]
        residual += blocks.W[..., :1] * (bias * self._weight)[:, :, None]
        prior = np.concatenate([bias, shape], axis=1) * self._prior
        offsets = (
            T_parent_joint[:, :3, 3] / self.priors.position,
            T_joint_su[:, :3, 3] / self.priors.position,
        )
        frames = (state.T_parent_joint[:, :3, :3], state.T_joint_su[:, :3, :3])
        zero = zero_frames(R, p, blocks.q, self.tree.prismatic)
        basis, turns = (joint_basis, su_basis), turn_basis(step.logs)
        return Evaluation(self, kin, zero, basis, turns, frames, Y, GT, residual, prior, offsets)

    def zero_step(self) -> Step:
        """A step of zeros, of this problem's shapes."""
        D, U = self.tree.n_joints, self.tree.n_sus
        return Step(np.zeros((D, N_JOINT)), np.zeros((self.n_logs - 1, 2)), np.zeros((U, N_SU)))


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The cost at one point. Arrays as in :class:`Cost`; derivatives are computed on request.

    Attributes:
        cost: the cost it belongs to.
        kin: kinematics of all SUs.
        residual: (P, U, m, 3) whitened residuals [standard deviations].
        prior: (U, 9) residuals of bias and shape against their priors.
        offsets: (D, 3) and (U, 3) residuals of the offsets against theirs.
    """

    cost: Cost
    kin: SuKinematics
    _zero: tuple[F64, F64]
    _basis: tuple[F64, F64]
    _turns: F64
    _frames: tuple[F64, F64]
    _Y: F64
    _GT: F64
    residual: F64
    prior: F64
    offsets: tuple[F64, F64]

    @property
    def chi2(self) -> float:
        """Sum of squared residuals and priors."""
        parts = (self.residual, self.prior, *self.offsets)
        return float(sum(np.vdot(part, part) for part in parts))

    def chi2_by_block(self) -> F64:
        """(P, U) chi-squared of each pose and SU."""
        return np.asarray(np.einsum("puij,puij->pu", self.residual, self.residual))

    def gradient(self) -> Step:
        """Gradient of chi2 / 2 in the step's coordinates, in time linear in chain lengths."""
        cost = self.cost
        moved, turned = twist_maps(self.kin)
        # Adjoint of the whitening: what each feature row contributes per unit change.
        raw = np.swapaxes(cost.blocks.W, -1, -2) @ self.residual
        e = raw @ np.swapaxes(self._GT, -1, -2)
        rows_moved = np.einsum("pumij,pumi->pumj", moved, e)
        rows_turned = np.einsum("pumij,pumi->pumj", turned, e)
        P, U, L = self.kin.w.shape[:3]
        by_moved = rows_moved[:, :, 1:].reshape(P, U, 2, L, 6).sum(axis=2)
        by_turned = rows_turned[:, :, 1:].reshape(P, U, 2, L, 6).sum(axis=2)
        before = np.cumsum(by_moved, axis=2) - by_moved
        beyond = np.cumsum(by_turned[:, :, ::-1], axis=2)[:, :, ::-1]
        wrench = rows_moved[:, :, :1] + before + beyond
        twists = joint_twists(cost.blocks.chains, self.kin, *self._zero, self._basis[0])
        per_joint = np.einsum("pulib,puli->ulb", twists, wrench).reshape(U, -1)
        joint = np.zeros((cost.tree.n_joints, N_JOINT))
        columns = cost._columns[:, : L * N_JOINT]
        np.add.at(joint.reshape(-1), columns, per_joint)
        logs = self._log_gradient(rows_turned.sum(axis=2))
        su_twist = rows_moved.sum(axis=(0, 2))
        placement = np.einsum("uij,ui->uj", self._basis[1], su_twist)
        by_offset = self._offset_rows()
        joint[:, :2] += np.einsum("dij,di->dj", by_offset[0], self.offsets[0])
        placement[:, :3] += np.einsum("uij,ui->uj", by_offset[1], self.offsets[1])
        weighted = raw * cost._weight[:, :, None]
        return Step(joint, logs, np.concatenate([placement, self._intrinsic(weighted)], axis=1))

    def _offset_rows(self) -> tuple[F64, F64]:
        """Derivatives of the offset residuals in tx, ty (D, 3, 2) and tx, ty, tz (U, 3, 3)."""
        scale = 1 / self.cost.priors.position
        return self._frames[0][..., :2] * scale, self._frames[1] * scale

    def _intrinsic(self, raw: F64) -> F64:
        """(U, 9) gradient in bias and shape from unwhitened, noise-weighted residuals."""
        bias = raw[:, :, 0].sum(axis=0)
        outer = np.einsum("pumi,pumj->uij", raw, self._Y)
        shape = np.stack(
            [outer[:, 0, 0], outer[:, 1, 1], outer[:, 2, 2],
             outer[:, 1, 2] + outer[:, 2, 1], outer[:, 0, 2] + outer[:, 2, 0],
             outer[:, 0, 1] + outer[:, 1, 0]], axis=1,
        )  # fmt: skip
        return np.concatenate([bias, shape], axis=1) + self.prior * self.cost._prior

    def _log_gradient(self, wrench: F64) -> F64:
        """(G - 1, 2) gradient in the turns of gravity, from gravity's rows (P, U, 6)."""
        world = -(self.kin.R @ wrench[..., :3, None])[..., 0].sum(axis=1)
        out = np.zeros((self.cost.n_logs, 3))
        np.add.at(out, self.cost.blocks.log, world)
        return (out[1:, None] @ self._turns)[:, 0]

    def jacobian(self) -> tuple[F64, F64]:
        """Derivatives of the whitened residuals.

        Returns:
            joint part (U, P m 3, C), whose columns are those of :class:`NormalEquations`, and SU
            part (U, P m 3 + 12, 15), whose last rows are the priors of bias, shape and offset. The
            priors of the joints' offsets have no rows here.
        """
        cost = self.cost
        moved, turned = twist_maps(self.kin)
        P, U, m = moved.shape[:3]
        L = self.kin.w.shape[2]
        G = np.swapaxes(self._GT, -1, -2)[:, :, None]
        moved, turned = G @ moved, G @ turned
        twists = joint_twists(cost.blocks.chains, self.kin, *self._zero, self._basis[0])
        X = np.swapaxes(twists, 2, 3).reshape(P, U, 6, L * N_JOINT)
        flat = (P, U, m * 3, 6)
        by_turned = (turned.reshape(flat) @ X).reshape(P, U, m, 3, L, N_JOINT)
        by_moved = (moved.reshape(flat) @ X).reshape(P, U, m, 3, L, N_JOINT)
        mask = np.broadcast_to(self._row_before(m), (1, U, m, 1, L, 1))
        raw = np.where(mask, by_moved, by_turned).reshape(P, U, m, 3, L * N_JOINT)
        if cost.n_logs > 1:
            raw = np.concatenate([raw, self._log_columns(turned)], axis=-1)
        C = raw.shape[-1]
        su_raw = np.zeros((P, U, m, 3, N_SU))
        su_raw[..., :N_PLACEMENT] = moved @ self._basis[1][None, :, None]
        su_raw[:, :, 0, :, 6:9] = np.eye(3) * cost._weight[:, :, :, None]
        y = self._Y * 1.0
        for i, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))):
            su_raw[..., a, 9 + i] = y[..., b] * cost._weight[:, :, None, a]
            su_raw[..., b, 9 + i] = y[..., a] * cost._weight[:, :, None, b]
        both = np.concatenate([raw, su_raw], axis=-1).reshape(P, U, m, 3 * (C + N_SU))
        J = (cost.blocks.W @ both).reshape(P, U, m * 3, C + N_SU)
        J = np.swapaxes(J, 0, 1).reshape(U, P * m * 3, C + N_SU)
        prior_rows = np.zeros((U, 12, N_SU))
        prior_rows[:, :9, N_PLACEMENT:] = np.diag(cost._prior)
        prior_rows[:, 9:, :3] = self._offset_rows()[1]
        return J[..., :C], np.concatenate([J[..., C:], prior_rows], axis=1)

    def encoder_jacobian(self) -> F64:
        """Derivatives of the whitened residuals in what the encoders say.

        Returns:
            (P, U, 3 m, 2 L): first in the position of each joint of the SU's chain, then in the
            logarithm of its coefficients ``s_d`` and ``tau_d``.
        """
        cost = self.cost
        moved, turned = twist_maps(self.kin)
        P, U, m = moved.shape[:3]
        L = self.kin.w.shape[2]
        about_z = np.zeros((cost.tree.n_joints, 6, 1))
        about_z[np.arange(cost.tree.n_joints), np.where(cost.tree.prismatic, 5, 2)] = 1.0
        twists = joint_twists(cost.blocks.chains, self.kin, *self._zero, about_z)
        X = np.swapaxes(twists[..., 0], 2, 3)[:, :, None]
        before = self._row_before(m)[..., 0]
        rows = np.where(before, moved @ X, turned @ X)
        own = np.zeros((P, U, m, 3, L))
        for i in range(L):
            for row in (1 + i, 1 + L + i):
                own[:, :, row, :, i] = self._Y[:, :, row]
        G = np.swapaxes(self._GT, -1, -2)[:, :, None]
        both = (G @ np.concatenate([rows, own], axis=-1)).reshape(P, U, m, 3 * 2 * L)
        return np.asarray((cost.blocks.W @ both).reshape(P, U, 3 * m, 2 * L))

    def _row_before(self, m: int) -> F64:
        """(1, U, m, 1, L, 1) True where a row's joint lies before the column's placement."""
        before = self.cost._before
        first = np.ones_like(before[:, :, :1])
        return np.concatenate([first, before, before], axis=2)[:, :, :m, None, :, None]

    def _log_columns(self, turned: F64) -> F64:
        """(P, U, m, 3, 2 (G - 1)) derivatives in the turns of gravity."""
        Rt = np.swapaxes(self.kin.R, -1, -2)[:, :, None]
        poses = np.arange(turned.shape[0])
        B = np.concatenate([np.zeros((1, 3, 2)), self._turns])[self.cost.blocks.log]
        columns = -(turned[..., :3] @ (Rt @ B[:, None, None]))
        out = np.zeros((*columns.shape[:-1], self.cost.n_logs, 2))
        out[poses, :, :, :, self.cost.blocks.log] = columns
        return out[..., 1:, :].reshape(*columns.shape[:-1], -1)

    def normal_equations(self) -> NormalEquations:
        """Gauss-Newton information and gradient of chi2 / 2."""
        cost = self.cost
        Jj, Js = self.jacobian()
        U, N, _ = Jj.shape
        r = np.swapaxes(self.residual, 0, 1).reshape(U, N)
        r_full = np.concatenate([r, self.prior, self.offsets[1]], axis=1)
        Jt = np.swapaxes(Jj, 1, 2)
        Jst = np.swapaxes(Js, 1, 2)
        n = cost.tree.n_joints * N_JOINT + 2 * (cost.n_logs - 1)
        H, g = np.zeros((n, n)), np.zeros(n)
        columns = cost._columns
        np.add.at(H, (columns[:, :, None], columns[:, None, :]), Jt @ Jj)
        np.add.at(g, columns, (Jt @ r[..., None])[..., 0])
        rows = self._offset_rows()[0]
        own = np.arange(cost.tree.n_joints)[:, None] * N_JOINT + np.arange(2)
        H[own[:, :, None], own[:, None, :]] += np.swapaxes(rows, 1, 2) @ rows
        g[own] += np.einsum("dij,di->dj", rows, self.offsets[0])
        return NormalEquations(
            H, g, Jst @ Js, (Jst @ r_full[..., None])[..., 0], Jst[:, :, :N] @ Jj, columns
        )
