"""How well an estimate explains the features: as a whole, part by part, and pose by held-out pose.

Chi-squared of a part of the data is held against its degrees of freedom: the measurements in it
less its leverage, which is what the fit bent itself to them. With the weighted Jacobian J and the
information H of the estimate the residuals have the covariance ``I - J H^-1 J^T``, so the leverage
of a part is the trace of its block of ``J H^-1 J^T``. A ratio near 1 is noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.estimation.problem.state import N_SU
from skin2urdf.estimation.solve.arrow import ArrowFactor, factor
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.uncertainty.held_out import held_out


@dataclass(frozen=True, eq=False)
class Share(Record):
    """Chi-squared of n parts of the data.

    Attributes:
        chi2: (n,) sum of squared whitened residuals, before robust weighting.
        dof: (n,) degrees of freedom; 0 where there is no data.
    """

    chi2: F64
    dof: F64

    @property
    def per_dof(self) -> F64:
        """(n,) chi-squared per degree of freedom; NaN where less than one is left."""
        none = np.full(self.chi2.shape, np.nan)
        return np.asarray(np.divide(self.chi2, self.dof, out=none, where=self.dof >= 1.0))

    @property
    def z(self) -> F64:
        """(n,) chi-squared as a standard normal variable (Wilson and Hilferty 1931).

        What it would be, in standard deviations, if all noise were as stated: above 3.7 by chance
        once in 10,000 times. NaN where less than one degree of freedom is left.
        """
        ninth = 2 / (9 * np.maximum(self.dof, 1.0))
        return np.asarray((np.cbrt(self.per_dof) - (1 - ninth)) / np.sqrt(ninth))


@dataclass(frozen=True, eq=False)
class Goodness(Record):
    """Goodness of fit of D joints, U SUs and P poses.

    Attributes:
        by_block: (P, U) every pose and SU; of the means of all samples around the pose where these
            are explained, else of features.
        by_su: (U,) every SU, all poses.
        by_pose: (P,) every pose, all SUs.
        by_joint: (D,) what the readings show of a joint's motion, all poses and SUs: the whitened
            residuals nearest to its ``s_d`` and ``tau_d``. Gravity at rest belongs to no joint.
        held_out: (P,) every pose as predicted from the others: chi-squared of the residuals it
            would have in an estimate that does not know it, under the covariance of that
            prediction.
        patterned: (P,) True where more than gravity was measured: around poses with a pattern.
        scale: factor on all stated covariances (cost per degree of freedom, at least 1);
            ``held_out.per_dof`` over it is near 1 where the stated uncertainty is true.
        of_features: whether the model that counts is the features' own. Where it has more, as
            joints that yield, features do not tell how well it predicts.
    """

    by_block: Share
    by_su: Share
    by_pose: Share
    by_joint: Share
    held_out: Share
    patterned: Bool
    scale: float
    of_features: bool = True

    @property
    def prediction(self) -> float:
        """Squared errors of held-out poses over stated variances; 1 is expected.

        Half of the measurements lie in poses that are predicted at least as well. NaN where no
        pose can be predicted from the others, by the model that counts.
        """
        if not self.of_features:
            return float("nan")
        ratio, dof = self.held_out.per_dof, self.held_out.dof
        order = np.argsort(ratio)[: int(np.isfinite(ratio).sum())]
        if not len(order):
            return float("nan")
        half = np.searchsorted(np.cumsum(dof[order]), dof[order].sum() / 2)
        return float(ratio[order[half]]) / self.scale


def by_block(estimate: Estimate) -> Share:
    """Chi-squared of every pose and SU (P, U) at an estimate."""
    here = estimate.cost.at(estimate.state)
    whole = factor(here.normal_equations(), estimate.free)
    return _summed(_rows(estimate, here.residual, here.jacobian(), whole), 2)


def goodness(estimate: Estimate) -> Goodness:
    """Chi-squared of all parts of the data at an estimate.

    Costs about as much as one linearisation, and one more factorisation for each pose.
    """
    here = estimate.cost.at(estimate.state)
    equations = here.normal_equations()
    whole = factor(equations, estimate.free)
    jacobian = here.jacobian()
    rows = _rows(estimate, here.residual, jacobian, whole)
    return Goodness(
        by_block=_summed(rows, 2),
        by_su=_summed(rows, (0, 2)),
        by_pose=_summed(rows, (1, 2)),
        by_joint=_by_joint(estimate, rows),
        held_out=Share(*held_out(estimate, here.residual, jacobian, equations)),
        patterned=np.asarray((estimate.count > 3).any(axis=1)),
        scale=max(1.0, estimate.cost_per_dof),
    )


def _summed(rows: Share, axis: int | tuple[int, ...]) -> Share:
    return Share(rows.chi2.sum(axis=axis), rows.dof.sum(axis=axis))


def _rows(
    estimate: Estimate, residual: F64, jacobian: tuple[F64, F64], whole: ArrowFactor
) -> Share:
    """Chi-squared by pose, SU and row of the feature block: (P, U, m), in their order.

    Whitening mixes the rows of a block. Its residuals are turned so that each is as near as can be
    to one row of coefficients (Kessy, Lewin, Strimmer 2018: ZCA-cor whitening), which changes no
    sum over a block.
    """
    W = estimate.cost.blocks.W
    size = np.sqrt(np.einsum("puij,puij->puj", W, W))
    scaled = np.divide(W, size[:, :, None], out=np.zeros_like(W), where=size[:, :, None] > 0)
    root = np.sqrt(np.einsum("puij,puij->pui", scaled, scaled))[..., None]
    excited = root > 0
    turn = np.swapaxes(np.divide(scaled, root, out=np.zeros_like(W), where=excited), -1, -2)
    chi2 = ((turn @ residual) ** 2).sum(axis=-1) / estimate.weight[:, :, None]
    heard = (estimate.count > 0)[:, :, None]
    count = 3.0 * heard * (turn**2 @ (1.0 * excited))[..., 0]

    P, U, m = chi2.shape
    joint, su = jacobian
    inverse = np.linalg.inv(whole.joint_root @ whole.joint_root.T)
    inverse = inverse * whole.free_joint * whole.free_joint[:, None]
    leverage = np.zeros((P, U, m))
    for u in range(U):
        both = np.concatenate([joint[u], su[u, : P * m * 3] * whole.free_su[u]], axis=1)
        turned = turn[:, u] @ both.reshape(P, m, -1)
        both = turned.reshape(P * m * 3, -1)
        own = both[:, -N_SU:]
        beyond = both[:, :-N_SU] - own @ whole.coupling[u]
        columns = whole.columns[u]
        spread = np.einsum("ni,ni->n", beyond @ inverse[np.ix_(columns, columns)], beyond)
        spread += (np.linalg.solve(whole.su_root[u], own.T) ** 2).sum(axis=0)
        leverage[:, u] = spread.reshape(P, m, 3).sum(axis=2)
    return Share(chi2, np.maximum(count - leverage, 0.0))


def _by_joint(estimate: Estimate, rows: Share) -> Share:
    """Sums over the rows of s_d and tau_d of each joint."""
    chains = estimate.cost.blocks.chains
    L = chains.joint.shape[1]
    out = []
    for values in (rows.chi2, rows.dof):
        moving = values[:, :, 1 : 1 + L] + values[:, :, 1 + L :]
        total = np.zeros(estimate.tree.n_joints)
        np.add.at(total, chains.joint, moving.sum(axis=0) * chains.present)
        out.append(total)
    return Share(*out)
