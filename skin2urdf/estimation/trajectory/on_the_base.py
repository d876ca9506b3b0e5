"""How limbs and SUs on a base that gives way are turned about gravity.

Of a base that stands still nothing shows it, and a fit begins with what is as good as any.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from skin2urdf.arrays import F64, Complex
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.kinematics import frame_motions
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.geometry.so3 import frame_with_z, rotation_exp
from skin2urdf.signals.filters import filtered

_TURNS = 120
"""Turns that are compared: by 3 deg, from which a fit finds its way."""
_APART = np.deg2rad(5.0)
"""Angle between the directions of gravity of two logs from which they tell the turn of limbs about
it [rad]: half a degree of cross-axis error is then six degrees of turn."""


def limbs_turned_alike(problem: MotionProblem, fitted: Fitted, seconds: float) -> MotionState:
    """A state with limbs turned about gravity as they feel the base tilt together.

    A fit to a base that stands still leaves the tilt in the readings: over spans of time that are
    longer than any swing, all limbs are tilted alike, each seen by its own turn. Which turns make
    that most alike, the leading eigenvector of what any two have in common tells (synchronisation
    of angles: Singer 2011), of which a single pair with little in common knows nothing.

    Args:
        problem: with a base that stands still; nothing is done where it moves, of a robot with one
            limb, and where several directions of gravity tell how limbs are turned.
        fitted: its fit.
        seconds: length of the spans [s].
    """
    tree, state = problem.tree, fitted.state
    places = state.placements
    roots = np.flatnonzero(tree.parent < 0)
    tilted = np.linalg.norm(np.cross(places.up, places.up[0]), axis=1).max() > np.sin(_APART)
    if len(roots) < 2 or tilted or problem.skeleton.tree is not tree:
        return state
    felt = np.concatenate(
        [_tilts(problem, fitted, g, seconds) for g in range(len(problem.logs))], axis=1
    )
    size = np.linalg.norm(felt, axis=1, keepdims=True)
    alike = np.divide(felt, size, out=np.zeros_like(felt), where=size > 0)
    _, V = np.linalg.eigh(alike @ alike.conj().T)
    angle = np.angle(V[1, -1] * V[1:, -1].conj())
    T = np.array(places.T_parent_joint)
    for root, by in zip(roots, angle, strict=True):
        turn = rotation_exp(by * places.up[0])
        T[root, :3] = turn @ T[root, :3]
    return replace(state, placements=replace(places, T_parent_joint=T))


def _tilts(problem: MotionProblem, fitted: Fitted, g: int, seconds: float) -> Complex:
    """(1 + L, S) what is left along two horizontal axes over spans of a log, as x + iy [m/s^2].

    Args:
        problem: what was fitted.
        fitted: its fit.
        g: number of the log.
        seconds: length of the spans [s].

    Returns:
        Of what stands on the base, and of each limb; without their means.
    """
    tree, log, p = problem.tree, problem.logs[g], fitted.predicted[g]
    places, weights = fitted.state.placements, fitted.weights[g][..., 0]
    q = np.ascontiguousarray(log.q[log.kept, : tree.n_joints].T)
    still = np.zeros_like(q)
    _, carried = frame_motions(tree, places.T_parent_joint, places.up[g], q, still, still)
    across = frame_with_z(places.up[0])[:, :2] @ np.array([1.0, 1.0j])
    limb = np.array([tree.chain(j)[0] if j >= 0 else -1 for j in tree.su_joint])
    n = max(1, int((log.time[-1] - log.time[0]) / seconds))
    first = np.linspace(0, len(log.kept), n + 1).astype(int)[:-1]
    out = []
    for root in (-1, *np.flatnonzero(tree.parent < 0)):
        pulls, total = np.zeros(len(log.kept), dtype=np.complex128), np.zeros(len(log.kept))
        for u in np.flatnonzero(limb == root):
            w = np.where(p.measured[:, u], weights[:, u], 0.0)
            axes = np.einsum("jik,i->kj", carried[tree.su_joint[u]].R_frame_base, across)
            axes = axes @ places.T_joint_su[u, :3, :3]
            left = np.where(w[:, None] > 0, p.residual[:, u, :3], 0.0)
            pulls += w * (left * axes).sum(axis=1)
            total += w
        span, of_span = np.add.reduceat(pulls, first), np.add.reduceat(total, first)
        felt = np.divide(span, of_span, out=np.zeros_like(span), where=of_span > 0)
        out.append(felt - felt.mean())
    return np.array(out)


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
    if not problem.base_swings:
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
