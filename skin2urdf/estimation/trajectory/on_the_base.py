"""How SUs on a base that gives way are turned about gravity, of which nothing shows before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.state import MotionState


def turned_as_the_base(problem: MotionProblem, state: MotionState, seconds: float) -> MotionState:
    """A state with the SUs on the base turned so that they should read what they do (Wahba 1965).

    Mean readings show how an SU is tilted, and their slow changes, square to gravity, how it is
    turned about it. It may be so by any angle, too far for the steps of a fit.

    Args:
        problem: with a base that moves; nothing is done where it stands still.
        state: with its motion.
        seconds: length of spans over which changes are slow: accelerations, which depend on where
            the SUs are, average out [s].
    """
    if problem.skeleton.tree is problem.tree:
        return state
    seen = [problem.predict(state, g) for g in range(len(problem.logs))]
    matrix, T = state.placements.sensor_matrix(), np.array(state.placements.T_joint_su)
    felt = [dict(problem.ideal(state, g, p)) for g, p in enumerate(seen)]
    for u in np.flatnonzero(problem.tree.su_joint < 0).tolist():
        ideal, read = [], []
        for log, p, f in zip(problem.logs, seen, felt, strict=True):
            n = max(1, int((log.time[-1] - log.time[0]) / seconds))
            for span in np.array_split(np.flatnonzero(p.measured[:, u]), n):
                if len(span):
                    ideal.append(f[u][:, span].mean(axis=1))
                    read.append(ideal[-1] @ matrix[u] + p.residual[span, u].mean(axis=0))
        if len(ideal) > 1:
            turn, _ = Rotation.align_vectors(read, ideal)
            T[u, :3, :3] = T[u, :3, :3] @ turn.as_matrix().T
    return replace(state, placements=replace(state.placements, T_joint_su=T))
