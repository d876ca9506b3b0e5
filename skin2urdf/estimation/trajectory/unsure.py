"""By how much what is taken off for the noise of encoders may be off.

What noise does to lengths and low-passes goes with the squares of what it makes of accelerations.
These are taken to be those of white noise. Rounding is that in the mean of many motions; in
patterns of a few frequencies, and where joints are slow, it is not. So positions are rounded once
more (see :mod:`rounded`): how large the squares then are, at the samples that count and with the
weights they count with, tells how far from the truth they were taken to be. Of noise that is not
from rounding nobody knows how white it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.doubtful_fronts import UNSURE
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.kinematics import felt_of_joints
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.rounded import DRAWS
from skin2urdf.estimation.trajectory.shaken import EVERY
from skin2urdf.estimation.trajectory.unseen import Unseen


def unsure(
    problem: MotionProblem, fitted: Fitted, again: Unseen | None, groups: Sequence[Int]
) -> F64:
    """(G,) deviation of what the noise of some encoders does, over what is taken off for it.

    Args:
        problem: what was fitted.
        fitted: the fit.
        again: what encoders round off, drawn anew; None where they round nothing off.
        groups: encoders, G groups of them.
    """
    D = problem.tree.n_joints
    drawn, rounding, noise = np.zeros((DRAWS, D)), np.zeros(D), np.zeros(D)
    accelerations = None if again is None else [each[2] for each in again.at_kept(problem.logs)]
    for g, (log, w) in enumerate(zip(problem.logs, fitted.weights, strict=True)):
        if log.noise is None:
            continue
        counts = _counts(problem, fitted, g, w[..., 0])
        counted = (log.shaken * counts).sum(axis=0)
        noise += counted * log.noise
        rounding += counted * np.minimum(log.rounding, log.noise)
        if accelerations is not None:
            of_draws = accelerations[g].reshape(DRAWS, D, -1)
            drawn += np.einsum("kd,rdk->rd", counts, of_draws**2, optimize=True)
    out = np.zeros(len(groups))
    for i, joints in enumerate(groups):
        all_of_it = max(float(noise[joints].sum()), 1e-300)
        off = (drawn - rounding)[:, joints].sum(axis=1) / all_of_it
        other = 1 - rounding[joints].sum() / all_of_it
        out[i] = np.hypot(np.sqrt((off**2).mean()), UNSURE * other)
    return out


def _counts(problem: MotionProblem, fitted: Fitted, g: int, weights: F64) -> F64:
    """(K, D) with what weight squares of each joint's acceleration count in chi-squared.

    Args:
        problem: what was fitted.
        fitted: the fit.
        g: number of the log.
        weights: (K, U) information of its samples [s^4/m^2].
    """
    log, tree = problem.logs[g], problem.tree
    q = log.q[log.kept[::EVERY], : tree.n_joints]
    felt = felt_of_joints(tree, fitted.state.placements, q)
    K, U = weights.shape
    blocks = np.zeros((len(q) * EVERY, U))
    blocks[:K] = weights
    out = blocks.reshape(len(q), EVERY, U) @ felt.transpose(2, 0, 1)
    return np.asarray(out.reshape(-1, tree.n_joints)[:K])
