"""Score test of the encoders: how much better the fit would be with one of them corrected.

An encoder that is wrong by ``h x`` (a direction h over positions and scales, a size x) changes the
whitened residuals by ``K h x``, K exact from the model. With everything else re-estimated, which
to first order projects the columns J of the estimate's own coordinates out, chi-squared falls by

    gain(h) = (h . b)^2 / (h . A h)        at        x = -(h . b) / (h . A h)

with ``A = K'K - K'J (J'J)^-1 J'K`` and ``b = K'r - K'J (J'J)^-1 J'r``. So A and b decide all
hypotheses (Rao 1948). Where the encoders are right, a gain is chi-squared with one degree of
freedom, and x is normal with variance ``1 / (h . A h)``. Each hypothesis is about one joint, so of
A only the blocks of single joints are needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.problem.state import N_SU
from skin2urdf.estimation.solve.arrow import ArrowFactor, factor
from skin2urdf.estimation.solve.estimate import Estimate

_BLIND = 1e-6
"""Share of an error's effect that nothing else can imitate, above which the error can be tested;
far above the damping of the arrow system."""


@dataclass(frozen=True, eq=False)
class EncoderScores:
    """The quadratic model of chi-squared in errors of single encoders.

    Coordinates of each of the D joints, P + 1: what the model is told of its position in each pose,
    then the logarithm of its coefficients ``s_d`` and ``tau_d``.

    Attributes:
        information: (D, P + 1, P + 1) the blocks of the matrix A.
        score: (D, P + 1) the vector b.
        alone: (D, P + 1, P + 1) ``K'K``, the information if all else were known.
    """

    information: F64
    score: F64
    alone: F64

    def test(self, joint: int, directions: F64) -> tuple[F64, F64, F64]:
        """Test H hypotheses about one joint.

        Args:
            joint: which.
            directions: (H, P + 1).

        Returns:
            gain (H,) in chi-squared, the size (H,) that is best for the fit, and its standard
            deviation (H,), infinite where the other coordinates can imitate the direction.
        """
        slope = directions @ self.score[joint]
        known = np.einsum("hi,hi->h", directions @ self.information[joint], directions)
        alone = np.einsum("hi,hi->h", directions @ self.alone[joint], directions)
        seen = known > _BLIND * alone
        safe = np.where(seen, known, 1.0)
        gain = np.where(seen, slope**2 / safe, 0.0)
        return gain, np.where(seen, -slope / safe, 0.0), np.where(seen, safe**-0.5, np.inf)


def unweighted(found: Estimate) -> Estimate:
    """The estimate with nothing weighed down in its cost."""
    blocks = found.cost.blocks.reweighted(1 / np.maximum(found.weight, 1e-12))
    cost = Cost(found.tree, blocks, found.cost.priors)
    hidden = float(((1 - found.weight) * found.chi2_by_block).sum())
    return replace(found, cost=cost, chi2=found.chi2 + hidden, weight=np.ones(found.count.shape))


def encoder_scores(found: Estimate) -> EncoderScores:
    """The score test at an estimate, with its robust weights."""
    here = found.cost.at(found.state)
    chains, free = found.cost.blocks.chains, found.free
    P, D = found.cost.blocks.q.shape
    arrow = factor(here.normal_equations(), free)
    gradient = arrow.whiten_gradient(here.gradient())
    alone, eliminated = np.zeros((2, D, P + 1, P + 1))
    score = np.zeros((D, P + 1))
    mixed = np.zeros((D, arrow.joint_root.shape[0], P + 1))
    for each in here.groups:
        J, K = each.jacobian(), each.encoder_jacobian()
        for i, u in enumerate(each.group.sus):
            own = chains.joint[u, : chains.length[u]]
            position, scale = (half[..., : len(own)] for half in np.split(K[:, i], 2, axis=-1))
            of_joints, of_su = np.split(J[i].reshape(P, K.shape[2], -1), [-N_SU], axis=-1)
            by_su = _products(position, scale, of_su) * free.sus[u]
            white = np.linalg.solve(arrow.su_root[u], np.swapaxes(by_su, 1, 2))
            eliminated[own] += np.swapaxes(white, 1, 2) @ white
            alone[own] += _squares(position, scale)
            residual = each.residual[:, i].reshape(P, -1, 1)
            score[own] += _products(position, scale, residual)[..., 0]
            score[own] -= gradient.sus[u] @ white
            left = _products(position, scale, of_joints)
            np.add.at(mixed, (own[:, None], each.group.columns[i]), np.swapaxes(left, 1, 2))
            back = np.swapaxes(by_su @ arrow.coupling[u], 1, 2)
            np.subtract.at(mixed, (own[:, None], arrow.columns[u]), back)
    white = _whitened(arrow, mixed)
    by_joints = np.concatenate([gradient.joints.ravel(), gradient.logs.ravel()])
    information = alone - eliminated - np.swapaxes(white, 1, 2) @ white
    return EncoderScores(information, score - by_joints @ white, alone)


def _products(position: F64, scale: F64, columns: F64) -> F64:
    """K' times columns (P, r, c), by joint (n, P + 1, c).

    Args:
        position: (P, r, n) derivatives of each pose's rows in the joints' positions there.
        scale: (P, r, n) derivatives of the rows in the logarithms of the joints' coefficients.
        columns: (P, r, c) what to multiply with.
    """
    by_pose = np.swapaxes(np.swapaxes(position, 1, 2) @ columns, 0, 1)
    together = np.tensordot(scale, columns, axes=((0, 1), (0, 1)))
    return np.concatenate([by_pose, together[:, None]], axis=1)


def _squares(position: F64, scale: F64) -> F64:
    """K'K by joint (n, P + 1, P + 1); rows of one pose feel no other pose's positions."""
    P, _, n = position.shape
    out = np.zeros((n, P + 1, P + 1))
    poses = np.arange(P)
    out[:, poses, poses] = (position**2).sum(axis=1).T
    out[:, :P, P] = out[:, P, :P] = (position * scale).sum(axis=1).T
    out[:, P, P] = (scale**2).sum(axis=(0, 1))
    return out


def _whitened(arrow: ArrowFactor, mixed: F64) -> F64:
    """Joint part of the projections (D, J, P + 1), in whitened coordinates."""
    if not mixed.shape[1]:
        return mixed
    return np.asarray(np.linalg.solve(arrow.joint_root, mixed * arrow.free_joint[:, None]))
