"""How SUs on a base that gives way are turned about gravity, of which nothing shows before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.signals.filters import filtered

_TURNS = 120
"""Turns that are compared: by 3 deg, from which a fit finds its way."""


def turned_as_the_base(problem: MotionProblem, state: MotionState, seconds: float) -> MotionState:
    """A state with the SUs on the base turned, and placed, as their readings ask for.

    Mean readings show how an SU is tilted. About gravity it may be turned by any angle, too far for
    the steps of a fit, and where the base swings about a point below, half a turn with a place as
    far on the other side of that point reads nearly the same. So all turns are compared, each with
    the place that is best for it. What lasts longer than a span of time is left to the fit.

    Args:
        problem: with a base that moves; nothing is done where it stands still.
        state: with its motion.
        seconds: length of the spans [s].
    """
    if problem.skeleton.tree is problem.tree:
        return state
    matrix, T = state.placements.sensor_matrix(), np.array(state.placements.T_joint_su)
    of_logs = []
    for g, log in enumerate(problem.logs):
        moved, p = problem.moved(state, g), problem.predict(state, g)
        up = state.placements.up[g] * state.gravity
        tilted = moved.qdd[:, -6:-3] - np.cross(moved.q[:, -3:], up)
        both = filtered(np.hstack([tilted, moved.qdd[:, -3:]]), log.taps)[log.kept]
        felt: dict[int, F64] = {}
        problem.ideal(state, g, p, felt.__setitem__)
        of_logs.append((log, p, felt, both))
    for u in np.flatnonzero(problem.tree.su_joint < 0).tolist():
        read, ideal, frame, turning = [], [], [], []
        for log, p, felt, both in of_logs:
            n = max(1, int((log.time[-1] - log.time[0]) / seconds))
            back = np.linalg.inv(matrix[u])
            seen = felt[u].T + p.residual[:, u] @ back.T
            for span in np.array_split(np.flatnonzero(p.measured[:, u]), n):
                if len(span) > 1:
                    read.append(seen[span])
                    ideal.append(felt[u].T[span])
                    frame.append(both[span, :3] - both[span, :3].mean(axis=0))
                    turning.append(both[span, 3:] - both[span, 3:].mean(axis=0))
        if not read:
            continue
        tilt, _ = Rotation.align_vectors(
            np.concatenate(read).mean(axis=0), np.concatenate(ideal).mean(axis=0)
        )
        R = T[u, :3, :3] @ tilt.as_matrix().T
        changes = np.concatenate([x - x.mean(axis=0) for x in read]) @ R.T
        T[u, :3, :3], T[u, :3, 3] = _turned(
            R, changes, np.concatenate(frame), np.concatenate(turning), state.placements.up[0]
        )
    return replace(state, placements=replace(state.placements, T_joint_su=T))


def _turned(R: F64, read: F64, frame: F64, turning: F64, up: F64) -> tuple[F64, F64]:
    """Turn about gravity and place of an SU that explain its readings best.

    Args:
        R: (3, 3) how it is turned but for that.
        read: (N, 3) what it reads, by R in the base's frame.
        frame: (N, 3) what is felt at the base's frame.
        turning: (N, 3) angular acceleration.
        up: (3,) unit vector.
    """
    by_place = np.cross(turning[:, None], np.eye(3)).reshape(len(read), 3, 3)
    columns = by_place.swapaxes(1, 2).reshape(-1, 3)
    best = np.inf, R, np.zeros(3)
    solve = np.linalg.pinv(columns, rcond=1e-3)
    for angle in np.linspace(0, 2 * np.pi, _TURNS, endpoint=False):
        turn = rotation_exp(angle * up)
        rest = (read @ turn.T - frame).ravel()
        place = solve @ rest
        left = float(((rest - columns @ place) ** 2).sum())
        if left < best[0]:
            best = left, turn @ R, place
    return best[1], best[2]
