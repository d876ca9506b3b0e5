"""Arrow-shaped normal equations: every SU is eliminated on its own (Schur complement)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.problem.cost import NormalEquations
from skin2urdf.estimation.problem.state import Free, Step

_DAMPING = 1e-9
"""Relative weight that holds directions without any information where they are."""


@dataclass(frozen=True, eq=False)
class ArrowFactor:
    """Factors of damped normal equations over the free coordinates.

    With x = (x_joint, x_su) and z the whitened coordinates, ``x = T z`` where the quadratic
    model of the cost is ``|z|**2 / 2`` plus a linear term.

    Attributes:
        su_root: (U, 15, 15) lower Cholesky factors of the SUs' information.
        coupling: (U, 15, C) ``su^-1 mixed``.
        joint_root: (J, J) lower Cholesky factor of the Schur complement.
        columns: (U, C) indices into the joint part.
        free_joint: (J,) and
        free_su: (U, 15), the coordinates that may move.
    """

    su_root: F64
    coupling: F64
    joint_root: F64
    columns: Int
    free_joint: Bool
    free_su: Bool

    def unwhiten(self, z: Step) -> Step:
        """X = T z."""
        n_joint = self.joint_root.shape[0]
        zj = np.concatenate([z.joints.ravel(), z.logs.ravel()])
        xj = np.linalg.solve(self.joint_root.T, zj) if n_joint else zj
        xj = np.where(self.free_joint, xj, 0.0)
        xs = np.linalg.solve(np.swapaxes(self.su_root, 1, 2), z.sus[..., None])[..., 0]
        xs = xs - (self.coupling @ xj[self.columns][..., None])[..., 0]
        return z.like(np.concatenate([xj, np.where(self.free_su, xs, 0.0).ravel()]))

    def su_variance(self) -> F64:
        """(U, 15) variances of the SUs' coordinates, what the joints leave uncertain included.

        Of the placement [m^2, rad^2], bias [m^2/s^4] and shape [1], in the chart of ``Step``.
        """
        alone, joint = np.linalg.inv(self.su_root), np.linalg.inv(self.joint_root)
        follow = np.swapaxes(joint[:, self.columns], 0, 1) @ np.swapaxes(self.coupling, 1, 2)
        return np.asarray((alone**2).sum(axis=1) + (follow**2).sum(axis=1))

    def whiten_gradient(self, g: Step) -> Step:
        """Gradient in z of a function with gradient g in x: T^T g."""
        gs = np.where(self.free_su, g.sus, 0.0)
        gj = np.concatenate([g.joints.ravel(), g.logs.ravel()])
        back = (np.swapaxes(self.coupling, 1, 2) @ gs[..., None])[..., 0]
        np.subtract.at(gj, self.columns, back)
        gj = np.where(self.free_joint, gj, 0.0)
        zj = np.linalg.solve(self.joint_root, gj) if gj.size else gj
        zs = np.linalg.solve(self.su_root, gs[..., None])[..., 0]
        return g.like(np.concatenate([zj, zs.ravel()]))

    def newton_step(self, gradient: Step) -> Step:
        """-H^-1 g: the step to the minimum of the quadratic model."""
        z = self.whiten_gradient(gradient)
        return self.unwhiten(Step(-z.joints, -z.logs, -z.sus))


def factor(
    equations: NormalEquations, free: Free, damping: float = 0.0, stiffness: float = 1.0
) -> ArrowFactor:
    """Factor normal equations over the free coordinates.

    Args:
        equations: the arrow system.
        free: which coordinates may move.
        damping: Levenberg-Marquardt damping relative to each coordinate's own information.
        stiffness: how many times as much the coordinates of joints and logs are damped as SUs'.
    """
    free_joint = np.concatenate([free.joints.ravel(), free.logs.ravel()])
    su, su_root = _restricted(equations.su, free.sus, damping)
    coupled = equations.mixed * free.sus[..., None] * free_joint[equations.columns][:, None]
    coupling = np.linalg.solve(su, coupled) if coupled.size else coupled
    H = equations.joint.copy()
    columns = equations.columns
    schur = np.swapaxes(coupled, 1, 2) @ coupling
    np.subtract.at(H, (columns[:, :, None], columns[:, None, :]), schur)
    reference = np.einsum("ii->i", equations.joint)
    _, joint_root = _restricted(H, free_joint, damping * stiffness, reference)
    return ArrowFactor(su_root, coupling, joint_root, columns, free_joint, free.sus)


def _restricted(
    H: F64, free: Bool, damping: float, reference: F64 | None = None
) -> tuple[F64, F64]:
    """Damped information over the free coordinates (identity elsewhere), and its Cholesky root."""
    n = H.shape[-1]
    if not n:
        return H, H
    H = H * free[..., :, None] * free[..., None, :]
    diagonal = np.einsum("...ii->...i", H if reference is None else H * 0.0)
    diagonal = diagonal if reference is None else reference
    largest = diagonal.max(axis=-1, keepdims=True)
    extra = (damping + _DAMPING) * np.maximum(diagonal, 1e-12 * largest) + 1e-300
    extra = np.where(free & (extra > 0), extra, 1.0)
    damped = H + extra[..., None] * np.eye(n)
    for attempt in range(8):
        try:
            return damped, np.asarray(np.linalg.cholesky(damped))
        except np.linalg.LinAlgError:
            damped = damped + 10.0**attempt * extra[..., None] * np.eye(n)
    lam, V = np.linalg.eigh(damped)
    floor = 1e-12 * np.abs(lam).max(axis=-1, keepdims=True)
    damped = (V * np.maximum(lam, floor)[..., None, :]) @ np.swapaxes(V, -1, -2)
    return np.asarray(damped), np.asarray(np.linalg.cholesky(damped))
