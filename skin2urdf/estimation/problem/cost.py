"""Chi-squared of a state against the features, with exact gradient and normal equations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.blocks import FeatureBlocks
from skin2urdf.estimation.problem.residuals import Point, Residuals, SuGroup, columns_of, groups_of
from skin2urdf.estimation.problem.state import (
    N_JOINT,
    N_PLACEMENT,
    N_SU,
    State,
    Step,
    joint_motion,
    local_motion,
    sensor_matrices,
    turn_basis,
    turned_up,
)
from skin2urdf.geometry.so3 import cross
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.model.prediction import SuKinematics, zero_frames
from skin2urdf.structure.records import KinematicTree
from skin2urdf.threads import each


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
        hidden: standard deviation of the antisymmetric cross-axis terms, which turn a sensor's
            frame and can not be seen [rad]; None where they are as large as the symmetric ones.
    """

    bias: float = 0.5
    scale: float = 0.03
    cross: float = 0.02
    position: float = 1.0
    gravity: float = GRAVITY
    hidden: float | None = None

    @property
    def hidden_rotation(self) -> float:
        """Standard deviation per axis of the rotation that cross-axis errors hide [rad]."""
        return self.cross if self.hidden is None else self.hidden

    @property
    def deviations(self) -> F64:
        """(9,) standard deviations of bias and shape."""
        return np.array([self.bias] * 3 + [self.scale] * 3 + [self.cross] * 3)


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Gauss-Newton system in arrow form: one joint part, one independent part per SU.

    Attributes:
        joint: (J, J) information of the joint and log coordinates.
        su: (U, 15, 15) information of each SU's coordinates.
        mixed: (U, 15, C) coupling of an SU with the joint coordinates ``columns``.
        columns: (U, C) indices into the joint part; padded entries couple with zero.
    """

    joint: F64
    su: F64
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
        self.n_logs = int(blocks.log.max(initial=0)) + 1
        self.n_data = int(blocks.count.sum())
        deviations = priors.deviations
        self._prior = np.divide(1.0, deviations, out=np.zeros(9), where=deviations > 0)
        self._groups = groups_of(blocks, tree.n_joints, self.n_logs)
        self.columns = columns_of(blocks.chains, tree.n_joints, self.n_logs)

    @cached_property
    def whole(self) -> SuGroup:
        """All SUs in arrays of one length."""
        if len(self._groups) == 1:
            return self._groups[0]
        everyone = np.arange(self.tree.n_sus)
        return SuGroup(self.blocks, everyone, self.tree.n_joints, self.n_logs)

    def at(self, state: State, step: Step | None = None) -> Evaluation:
        """Evaluate the cost at ``state`` moved by ``step``, with derivatives in the step."""
        blocks = self.blocks
        motions = self._still if step is None else _motions(step)
        (T_joint, joint_basis), (T_su, su_basis), turns = motions
        step = step or self.zero_step()
        T_parent_joint = state.T_parent_joint @ T_joint
        T_joint_su = state.T_joint_su @ T_su
        up = turned_up(state.up, step.logs) * self.priors.gravity
        bias, shape = state.bias + step.sus[:, 6:9], state.shape + step.sus[:, 9:15]
        self._pinocchio.write_joints(T_parent_joint)
        R, p = self._pinocchio.joint_frames(blocks.q)
        R_zero, p_zero = zero_frames(R, p, blocks.q, self.tree.prismatic)
        point = Point(
            R=R,
            p=p,
            R_zero=R_zero,
            p_zero=p_zero,
            joint_basis=joint_basis,
            up=up[blocks.log],
            log=blocks.log,
            turns=turns,
            prismatic=self.tree.prismatic,
            T_joint_su=T_joint_su,
            su_basis=su_basis,
            bias=bias,
            sensor=sensor_matrices(shape),
        )
        prior = self._prior_residual(bias, shape)
        offsets = (
            T_parent_joint[:, :3, 3] / self.priors.position,
            T_joint_su[:, :3, 3] / self.priors.position,
        )
        frames = (state.T_parent_joint[:, :3, :3], state.T_joint_su[:, :3, :3])
        groups = tuple(each(lambda group: group.at(point), self._groups, self.tree.n_sus))
        return Evaluation(self, groups, point, frames, prior, offsets)

    def with_sensors(self, here: Evaluation, bias: F64, shape: F64) -> Evaluation:
        """An evaluation with other biases (U, 3) [m/s^2] and shapes (U, 6) of the sensors."""
        point = replace(here.point, bias=bias, sensor=sensor_matrices(shape))
        groups = tuple(some.group.read(point, some.kin, some.Y) for some in here.groups)
        prior = self._prior_residual(bias, shape)
        return Evaluation(self, groups, point, here.frames, prior, here.offsets)

    def _prior_residual(self, bias: F64, shape: F64) -> F64:
        return np.asarray(np.concatenate([bias, shape], axis=1) * self._prior)

    @cached_property
    def _still(self) -> _Motions:
        return _motions(self.zero_step())

    def zero_step(self) -> Step:
        """A step of zeros, of this problem's shapes."""
        D, U = self.tree.n_joints, self.tree.n_sus
        return Step(np.zeros((D, N_JOINT)), np.zeros((self.n_logs - 1, 2)), np.zeros((U, N_SU)))


_Motions = tuple[tuple[F64, F64], tuple[F64, F64], F64]
"""Transforms and twists of joints and of SUs, and turns of gravity."""


def _motions(step: Step) -> _Motions:
    su = local_motion(step.sus[:, :N_PLACEMENT])
    return joint_motion(step.joints), su, turn_basis(step.logs)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The cost at one point. Arrays as in :class:`Cost`; derivatives are computed on request.

    Attributes:
        cost: the cost it belongs to.
        groups: residuals of the SUs, group by group.
        point: where it is.
        frames: (D, 3, 3) and (U, 3, 3) orientations that a step moves the offsets in.
        prior: (U, 9) residuals of bias and shape against their priors.
        offsets: (D, 3) and (U, 3) residuals of the offsets against theirs.
    """

    cost: Cost
    groups: tuple[Residuals, ...]
    point: Point
    frames: tuple[F64, F64]
    prior: F64
    offsets: tuple[F64, F64]

    @cached_property
    def whole(self) -> Residuals:
        """Residuals of all SUs in arrays of one length."""
        return self.cost.whole.at(self.point)

    @property
    def residual(self) -> F64:
        """(P, U, m, 3) whitened residuals [standard deviations]."""
        return self.whole.residual

    @property
    def kin(self) -> SuKinematics:
        """Kinematics of all SUs."""
        return self.whole.kin

    @cached_property
    def chi2(self) -> float:
        """Sum of squared residuals and priors."""
        parts = (*(group.residual for group in self.groups), self.prior, *self.offsets)
        return float(sum(np.vdot(part, part) for part in parts))

    def chi2_by_block(self) -> F64:
        """(P, U) chi-squared of each pose and SU."""
        out = np.zeros(self.cost.blocks.count.shape)
        for some in self.groups:
            r = some.residual
            out[:, some.group.sus] = np.einsum("puij,puij->pu", r, r)
        return out

    def gradient(self) -> Step:
        """Gradient of chi2 / 2 in the step's coordinates, in time linear in chain lengths."""
        point, tree = self.point, self.cost.tree
        wrench = np.zeros((*point.p.shape[:2], 6))
        gravity = np.zeros_like(point.up)
        sus = np.zeros((tree.n_sus, N_SU))
        parts = each(Residuals.adjoint, self.groups, tree.n_sus)
        for some, part in zip(self.groups, parts, strict=True):
            own = some.group.sus
            wrench += part.joints
            gravity += part.gravity
            S = part.sensor
            sus[own, :N_PLACEMENT], sus[own, 6:9] = part.placement, part.bias
            sus[own, 9:12] = np.einsum("uii->ui", S)
            for i, (a, b) in enumerate(((1, 2), (0, 2), (0, 1))):
                sus[own, 12 + i] = S[:, a, b] + S[:, b, a]
        # From the base's origin to the joints' placements, and into their frames.
        wrench[..., 3:] -= cross(point.p_zero, wrench[..., :3])
        local = wrench.reshape(*wrench.shape[:2], 2, 3) @ point.R_zero
        twist = local.sum(axis=0).reshape(tree.n_joints, 6)
        joints = np.einsum("dib,di->db", point.joint_basis, twist)
        by_log = np.zeros((self.cost.n_logs, 3))
        np.add.at(by_log, point.log, gravity)
        logs = (by_log[1:, None] @ point.turns)[:, 0]
        by_offset = self._offset_rows()
        joints[:, :2] += np.einsum("dij,di->dj", by_offset[0], self.offsets[0])
        sus[:, :3] += np.einsum("uij,ui->uj", by_offset[1], self.offsets[1])
        sus[:, N_PLACEMENT:] += self.prior * self.cost._prior
        return Step(joints, logs, sus)

    def jacobian(self) -> tuple[F64, F64]:
        """Derivatives of the whitened residuals.

        Returns:
            joint part (U, P m 3, C), whose columns are those of :class:`NormalEquations`, and SU
            part (U, P m 3 + 12, 15), whose last rows are the priors of bias, shape and offset. The
            priors of the joints' offsets have no rows here.
        """
        chains, C = self.cost.blocks.chains, self.cost.columns.shape[1]
        (P, U), L = self.cost.blocks.count.shape, chains.joint.shape[1]
        n_logs = 2 * (self.cost.n_logs - 1)
        J = np.zeros((U, P, chains.n_rows, 3, C + N_SU))
        # Group by group, since on the way there are arrays several times as large as the result.
        parts = each(Residuals.jacobian, self.groups, U)
        for some, part in zip(self.groups, parts, strict=True):
            length, c = some.group.chains.joint.shape[1], some.group.columns.shape[1]
            rows = np.r_[0, 1 : 1 + length, 1 + L : 1 + L + length]
            to = np.r_[: c - n_logs, C - n_logs : C + N_SU]
            at = np.ix_(some.group.sus, np.arange(P), rows, np.arange(3), to)
            J[at] = part.reshape(*(len(index.ravel()) for index in at))
        J = J.reshape(U, -1, C + N_SU)
        return J[..., :C], np.concatenate([J[..., C:], self._prior_rows()], axis=1)

    def encoder_jacobian(self) -> F64:
        """(P, U, 3 m, 2 L) derivatives of the whitened residuals in what the encoders say.

        First in the position of each joint of the SU's chain, then in the logarithm of its
        coefficients ``s_d`` and ``tau_d``.
        """
        return self.whole.encoder_jacobian()

    def normal_equations(self) -> NormalEquations:
        """Gauss-Newton information of chi2 / 2."""
        cost = self.cost
        n = cost.tree.n_joints * N_JOINT + 2 * (cost.n_logs - 1)
        columns = cost.columns
        U, C = columns.shape
        H = np.zeros((n, n))
        prior_rows = self._prior_rows()
        su = np.swapaxes(prior_rows, 1, 2) @ prior_rows
        mixed = np.zeros((U, N_SU, C))
        for some, products in zip(self.groups, each(_products, self.groups, U), strict=True):
            own, at = some.group.sus, some.group.columns
            c = at.shape[1]
            np.add.at(H, (at[:, :, None], at[:, None, :]), products[:, :c, :c])
            su[own] += products[:, c:, c:]
            n_logs = 2 * (cost.n_logs - 1)
            to = np.r_[: c - n_logs, C - n_logs : C]
            mixed[own[:, None, None], np.arange(N_SU)[:, None], to] = products[:, c:, :c]
        rows = self._offset_rows()[0]
        own = np.arange(cost.tree.n_joints)[:, None] * N_JOINT + np.arange(2)
        H[own[:, :, None], own[:, None, :]] += np.swapaxes(rows, 1, 2) @ rows
        return NormalEquations(joint=H, su=su, mixed=mixed, columns=columns)

    def _prior_rows(self) -> F64:
        """(U, 12, 15) derivatives of the SUs' priors: bias and shape, then offsets."""
        rows = np.zeros((self.cost.tree.n_sus, 12, N_SU))
        rows[:, :9, N_PLACEMENT:] = np.diag(self.cost._prior)
        rows[:, 9:, :3] = self._offset_rows()[1]
        return rows

    def _offset_rows(self) -> tuple[F64, F64]:
        """Derivatives of the offset residuals in tx, ty (D, 3, 2) and tx, ty, tz (U, 3, 3)."""
        scale = 1 / self.cost.priors.position
        return self.frames[0][..., :2] * scale, self.frames[1] * scale


def _products(some: Residuals) -> F64:
    """(u, C + 15, C + 15) products of the derivatives of some SUs' residuals."""
    J = some.jacobian()
    return np.swapaxes(J, 1, 2) @ J
