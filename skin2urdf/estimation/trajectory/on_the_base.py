"""How SUs on a base that gives way are turned about gravity, of which nothing shows before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.geometry.so3 import rotation_exp


def turned_as_the_base(problem: MotionProblem, state: MotionState, seconds: float) -> MotionState:
    """A state with the SUs on the base turned about gravity as their readings say.

    The slow changes of what they read and of what they should, square to gravity, differ by an
    angle that may be any: too far for the steps of a fit.

    Args:
        problem: with a base that moves; nothing is done where it stands still.
        state: with its motion.
        seconds: length of spans over which changes are slow: accelerations, which depend on where
            the SUs are, average out.
    """
    resting = np.flatnonzero(problem.tree.su_joint < 0)
    if problem.skeleton.tree is problem.tree or not len(resting):
        return state
    cos, sin, up = np.zeros(len(resting)), np.zeros(len(resting)), np.zeros((len(resting), 3))
    matrix = state.placements.sensor_matrix()[resting]
    for g, log in enumerate(problem.logs):
        seen = problem.predict(state, g)
        there = seen.measured[:, resting, None]
        n = max(1, int((log.time[-1] - log.time[0]) / seconds))
        first = np.linspace(0, len(there), n + 1).astype(int)[:-1]
        count = np.maximum(np.add.reduceat(there * 1.0, first, axis=0), 1.0)
        ideal, off = (
            np.add.reduceat(np.where(there, x[:, resting], 0.0), first, axis=0) / count
            for x in (seen.ideal, seen.residual)
        )
        read = off + (ideal.swapaxes(0, 1) @ matrix).swapaxes(0, 1)
        up = ideal.mean(axis=0)
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        p, y = (x - x.mean(axis=0) for x in (ideal, read))
        p, y = (x - (x * up).sum(axis=2, keepdims=True) * up for x in (p, y))
        cos += (p * y).sum(axis=(0, 2))
        sin += (np.cross(p, y).sum(axis=0) * up).sum(axis=1)
    T = np.array(state.placements.T_joint_su)
    T[resting, :3, :3] @= rotation_exp(-np.arctan2(sin, cos)[:, None] * up)
    return replace(state, placements=replace(state.placements, T_joint_su=T))
