"""Score test of the encoders: how much better the fit would be with one of them corrected.

An encoder that is wrong by ``h x`` (a direction h over positions and scales, a size x) changes the
whitened residuals by ``K h x``, K exact from the model. With everything else re-estimated, which
to first order projects the columns J of the estimate's own coordinates out, chi-squared falls by

    gain(h) = (h . b)^2 / (h . A h)        at        x = -(h . b) / (h . A h)

with ``A = K'K - K'J (J'J)^-1 J'K`` and ``b = K'r - K'J (J'J)^-1 J'r``. So one matrix decides all
hypotheses (Rao 1948). Where the encoders are right, a gain is chi-squared with one degree of
freedom, and x is normal with variance ``1 / (h . A h)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.arrow import ArrowFactor, factor
from skin2urdf.estimation.estimate import Estimate

_BLIND = 1e-6
"""Share of an error's effect that nothing else can imitate, above which the error can be tested;
far above the damping of the arrow system."""


@dataclass(frozen=True, eq=False)
class EncoderScores:
    """The quadratic model of chi-squared in errors of the encoders.

    Coordinates, N = (P + 1) D: what the model is told of the position of joint d in pose p at
    ``p D + d``, then the logarithm of the coefficients ``s_d`` and ``tau_d`` at ``P D + d``.

    Attributes:
        information: (N, N) the matrix A.
        score: (N,) the vector b.
        alone: (N, N) ``K'K``, the information if all else were known.
    """

    information: F64
    score: F64
    alone: F64

    def test(self, directions: F64) -> tuple[F64, F64, F64]:
        """Test H hypotheses.

        Args:
            directions: (H, N).

        Returns:
            gain (H,) in chi-squared, the size (H,) that is best for the fit, and its standard
            deviation (H,), infinite where the other coordinates can imitate the direction.
        """
        slope = directions @ self.score
        known = np.einsum("hi,hi->h", directions @ self.information, directions)
        alone = np.einsum("hi,hi->h", directions @ self.alone, directions)
        seen = known > _BLIND * alone
        safe = np.where(seen, known, 1.0)
        gain = np.where(seen, slope**2 / safe, 0.0)
        return gain, np.where(seen, -slope / safe, 0.0), np.where(seen, safe**-0.5, np.inf)


def encoder_scores(found: Estimate) -> EncoderScores:
    """The score test at an estimate, with its robust weights."""
    here = found.cost.at(found.state)
    blocks, free = found.cost.blocks, found.free
    K = here.encoder_jacobian()
    J_joint, J_su = here.jacobian()
    P, U, n_rows = K.shape[:3]
    D = found.tree.n_joints
    N = (P + 1) * D
    arrow = factor(here.normal_equations(), free)
    gradient = arrow.whiten_gradient(here.gradient())
    residual = here.residual.reshape(P, U, n_rows)
    alone, eliminated = np.zeros((N, N)), np.zeros((N, N))
    score = np.zeros(N)
    mixed = np.zeros((arrow.joint_root.shape[0], N))
    for u in range(U):
        own = blocks.chains.joint[u, : blocks.chains.length[u]]
        columns = _columns(own, P, D)
        Ku = _stacked(K[:, u], len(own))
        Jj, Js = J_joint[u], J_su[u, : P * n_rows] * free.sus[u]
        by_su = Js.T @ Ku
        white = np.linalg.solve(arrow.su_root[u], by_su)
        square = np.ix_(columns, columns)
        alone[square] += Ku.T @ Ku
        eliminated[square] += white.T @ white
        score[columns] += Ku.T @ residual[:, u].ravel() - white.T @ gradient.sus[u]
        left = Jj.T @ Ku - arrow.coupling[u].T @ by_su
        np.add.at(mixed, (arrow.columns[u][:, None], columns[None]), left)
    white = _whitened(arrow, mixed)
    by_joints = np.concatenate([gradient.joints.ravel(), gradient.logs.ravel()])
    information = alone - eliminated - white.T @ white
    return EncoderScores(information, score - white.T @ by_joints, alone)


def _columns(own: Int, P: int, D: int) -> Int:
    """Coordinates that a chain of n joints meets: ((P + 1) n,)."""
    return np.asarray((np.arange(P + 1)[:, None] * D + own).ravel())


def _stacked(K: F64, n: int) -> F64:
    """Rows of one SU (P, r, 2 L) as one matrix (P r, (P + 1) n) over the chain's coordinates."""
    P, r, twice = K.shape
    out = np.zeros((P, r, P + 1, n))
    out[np.arange(P), :, np.arange(P)] = K[..., :n]
    out[:, :, P] = K[..., twice // 2 : twice // 2 + n]
    return out.reshape(P * r, (P + 1) * n)


def _whitened(arrow: ArrowFactor, mixed: F64) -> F64:
    """Joint part of the projections, in whitened coordinates."""
    if not mixed.shape[0]:
        return mixed
    return np.asarray(np.linalg.solve(arrow.joint_root, mixed * arrow.free_joint[:, None]))
