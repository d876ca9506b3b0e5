"""Every pose as an estimate that does not know it predicts it, without estimating again.

Without pose p the information is ``H - A_p`` and, to first order, the estimate moves by dx. The
error of the prediction, ``r_p + J_p dx``, has the covariance ``I + J_p (H - A_p)^-1 J_p^T``, which
Woodbury's identity inverts in the arrow form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.cost import NormalEquations
from skin2urdf.estimation.problem.state import Step
from skin2urdf.estimation.solve.arrow import ArrowFactor, factor
from skin2urdf.estimation.solve.estimate import Estimate

_FORGOTTEN = 1e-6
"""Share of a direction's information left without a pose from which only that pose showed it."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Derivatives of one pose's whitened residuals, n of each SU.

    Attributes:
        joint: (U, n, C) in the joint coordinates ``columns`` of :class:`NormalEquations`.
        su: (U, n, 15) in those of the SU.
        columns: (U, C).
        zero: a step of zeros.
    """

    joint: F64
    su: F64
    columns: Int
    zero: Step

    def scaled(self, factors: F64) -> _Rows:
        """The rows of each SU multiplied by factors (U,)."""
        by_su = factors[:, None, None]
        return _Rows(self.joint * by_su, self.su * by_su, self.columns, self.zero)

    def change(self, step: Step) -> F64:
        """(U, n) change of the residuals along a step."""
        joints = np.concatenate([step.joints.ravel(), step.logs.ravel()])[self.columns]
        return np.asarray((self.joint @ joints[..., None] + self.su @ step.sus[..., None])[..., 0])

    def gradient(self, residual: F64) -> Step:
        """Gradient of half the squared residuals (U, n)."""
        J = self.zero.joints.size + self.zero.logs.size
        joints = np.zeros(J)
        np.add.at(joints, self.columns, np.einsum("unc,un->uc", self.joint, residual))
        sus = np.einsum("unc,un->uc", self.su, residual)
        return self.zero.like(np.concatenate([joints, sus.ravel()]))

    def added_to(self, equations: NormalEquations, sign: float) -> NormalEquations:
        """Normal equations with the information of these rows added, or taken off."""
        joint = equations.joint.copy()
        transposed = np.swapaxes(self.joint, 1, 2)
        at = (self.columns[:, :, None], self.columns[:, None, :])
        np.add.at(joint, at, sign * (transposed @ self.joint))
        turned = np.swapaxes(self.su, 1, 2)
        return NormalEquations(
            joint=joint,
            su=equations.su + sign * (turned @ self.su),
            mixed=equations.mixed + sign * (turned @ self.joint),
            columns=equations.columns,
        )


def held_out(
    estimate: Estimate, residual: F64, jacobian: tuple[F64, F64], equations: NormalEquations
) -> tuple[F64, F64]:
    """Chi-squared of each pose's prediction from the other poses.

    Args:
        estimate: the estimate; the other poses keep their robust weights, the predicted one counts
            in full.
        residual: (P, U, m, 3) weighted residuals at the estimate,
        jacobian: their derivatives, and
        equations: the normal equations, as
            :class:`skin2urdf.estimation.problem.cost.Evaluation` has them.

    Returns:
        (P,) chi-squared under the covariance of the prediction, and (P,) number of measurements
        that can be predicted: directions that only this pose shows take one away each.
    """
    P, U, m = residual.shape[:3]
    by_pose = [np.swapaxes(J[:, : P * m * 3].reshape(U, P, m * 3, -1), 0, 1) for J in jacobian]
    free, root = estimate.free, np.sqrt(estimate.weight)
    whole = factor(equations, free)
    chi2, dof = np.zeros(P), np.zeros(P)
    for p in range(P):
        rows = _Rows(by_pose[0][p], by_pose[1][p], equations.columns, estimate.cost.zero_step())
        r = residual[p].reshape(U, m * 3)
        rest = rows.added_to(equations, -1.0)
        without = factor(rest, free)
        # At the estimate, the gradient of the other poses is minus that of this one.
        moved = without.newton_step(rows.gradient(-r))
        plain = rows.scaled(1 / root[p])
        error = r / root[p][:, None] + plain.change(moved)
        full = whole if (root[p] == 1.0).all() else factor(plain.added_to(rest, 1.0), free)
        explained = full.whiten_gradient(plain.gradient(error)).flat()
        chi2[p] = max(0.0, float(np.vdot(error, error) - explained @ explained))
        dof[p] = max(0, int(estimate.count[p].sum()) - _forgotten(without, whole))
    return chi2, dof


def _forgotten(rest: ArrowFactor, whole: ArrowFactor) -> int:
    """Number of directions of which hardly any information is left."""
    lost = 0
    for part, all_ in ((rest.su_root, whole.su_root), (rest.joint_root, whole.joint_root)):
        if part.size:
            left = np.linalg.svd(np.linalg.solve(all_, part), compute_uv=False) ** 2
            lost += int((left < _FORGOTTEN).sum())
    return lost
