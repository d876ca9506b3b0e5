"""Whether joints yield as springs do, or lie on one side of a gap, as gears with play do.

A spring gives way by as much as its load is; a gear with play lies on one side of its gap or on the
other, whatever its load is, and falls across where that changes its sense. Fitted as a spring it
has deflections that go with the load; what a function of them that rises at first, and then stays,
would explain beside them is about as much as they are. Of springs it is a few hundredths.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import size_of
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import filtered
from skin2urdf.signals.trajectory import Trajectory

_SHARE = 0.5
"""Part of the deflections that such a function has to explain. Springs have 0.003 to 0.06 of them
where something else is lacking (ur5, z1, panda with links that bend), those of two arms on a base
that gives way 0.14 and 0.37, a gap of 3 mrad beside steps of 1.5 mrad 0.98."""


def deflections_saturate(problem: MotionProblem, fitted: Fitted, certain: float) -> bool:
    """Whether joints that were fitted as springs have play instead.

    Args:
        problem: of joints that yield.
        fitted: its fit.
        certain: logarithm of the likelihood that play has to gain.
    """
    if problem.unseen is None:
        return False
    x, n_joints = fitted.state.unseen, problem.tree.n_joints
    bent = [
        problem.unseen.moved(log, g, x).q[:, :n_joints] - log.q[:, :n_joints]
        for g, log in enumerate(problem.logs)
    ]
    gaps = gaps_like(problem.logs, bent)
    if not len(gaps.joint):
        return False
    found = size_of(problem, fitted, gaps)
    return found.gain > certain and _norm(found.numbers) > _SHARE * _norm(rms(bent))


def gaps_like(logs: Sequence[Trajectory], bent: Sequence[F64]) -> Unseen:
    """Motions of joints in gaps of half a radian or metre on either side, as loads bend springs.

    Args:
        logs: trajectories.
        bent: per log (N, D) deflections of springs under the same loads [rad or m].
    """
    # The spring that is nearest to a gap has the same mean square: half the gap's.
    size = rms(bent)
    yields = np.flatnonzero(size > 0)
    motions = tuple(
        filtered(np.tanh(each[:, yields] / size[yields]), log.taps)
        for each, log in zip(bent, logs, strict=True)
    )
    return Unseen(yields, motions)


def rms(bent: Sequence[F64]) -> F64:
    """(D,) root mean squares of deflections (N, D) of all logs."""
    return np.asarray(np.sqrt(np.mean(np.concatenate(bent) ** 2, axis=0)))


def _norm(x: F64) -> float:
    return float(np.linalg.norm(x))
