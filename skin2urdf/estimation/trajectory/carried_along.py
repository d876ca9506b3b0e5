"""SUs that are carried along by joints that do not turn them: a parallelogram, or a wrong place.

Gravity shows what turns an SU, and passes for most of its readings. What carries it besides shows
in accelerations alone, and may stay below what :mod:`following` takes for an error. So what a fit
leaves is held against what a joint q on a segment with the orientation R would make of it,

    R_su^T d^2/dt^2 [ R (a sin q + b cos q) ]

with two vectors a, b that nobody knows. What the model has right explains nothing of what is left.
A forearm that a parallelogram keeps from turning with the upper arm is carried along by it: its
encoder reads the sum of two joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.following import SHARE, STRETCH
from skin2urdf.estimation.trajectory.kinematics import FrameMotion, frame_motions
from skin2urdf.signals.filters import filtered, second_derivative
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.chain_fit import sensor_matrix

_YIELD = 0.02
"""Turn against gravity [rad] that gears and links may make as the robot accelerates: of an SU that
accelerates by less, what is left is held against what that turn would change."""
_ALONE = 0.5
"""Part of what all joints explain together that one of them has to explain alone to be named."""


@dataclass(frozen=True, eq=False)
class CarriedAlong(Record):
    """What is left of U SUs' readings that follows accelerations.

    Attributes:
        unexplained: (U,) True where that is too much of what they feel beside gravity.
        joint: (U,) the joint that makes most of it; -1 where none does, or it is sound.
    """

    unexplained: Bool
    joint: Int


def carried_along(fitted: Fitted) -> CarriedAlong:
    """SUs of which a fit leaves what follows the accelerations of joints.

    Args:
        fitted: the fit.
    """
    tree = fitted.problem.tree
    felt = np.zeros(tree.n_sus)
    explained = np.zeros((tree.n_sus, tree.n_joints + 1))
    for g, log in enumerate(fitted.problem.logs):
        frames = _standing(fitted, g, log.kept)
        predicted, columns = fitted.predicted[g], list[F64]()
        for u in range(tree.n_sus):
            use = predicted.measured[:, u]
            if not use.any():
                continue
            residual = predicted.residual[use, u, :3]
            here = _beside_gravity(fitted, log, frames, u)[use]
            floor = 3 * len(here) * (_YIELD * fitted.state.gravity) ** 2
            energy = (here**2).sum() + floor
            felt[u] += energy
            # No more can follow than is left.
            if (residual**2).sum() <= SHARE**2 * energy:
                continue
            columns = columns or _columns(fitted, g)
            R = _in_su(fitted, frames, u)[use]
            own = [R @ each[use] for each in columns]
            time = log.time[use]
            explained[u, -1] += _foretold(np.concatenate(own, axis=2), residual, time)
            for j in range(tree.n_joints):
                explained[u, j] += _foretold(own[j], residual, time)
    unexplained = explained[:, -1] > SHARE**2 * felt
    most = explained[:, :-1].argmax(axis=1)
    alone = explained[:, :-1].max(axis=1) > _ALONE * explained[:, -1]
    return CarriedAlong(unexplained, np.where(unexplained & alone, most, -1))


def _standing(fitted: Fitted, g: int, at: Int | slice) -> list[FrameMotion]:
    """Frames that joints carry, the base's last, as they are at samples passed at no speed."""
    state, q = fitted.state, fitted.problem.logs[g].q[at].T
    up = state.placements.up[g] * state.gravity
    none = np.zeros_like(q)
    tree = fitted.problem.tree
    return frame_motions(tree, state.placements.T_parent_joint, up, q, none, none)[1]


def _beside_gravity(fitted: Fitted, log: Trajectory, frames: list[FrameMotion], u: int) -> F64:
    """(K, 3) what an SU reads less what it would at no speed, along its own axes [m/s^2]."""
    places = fitted.state.placements
    frame = frames[int(fitted.problem.tree.su_joint[u])]
    M = sensor_matrix(places.shape[u]) @ places.T_joint_su[u, :3, :3].T
    return np.asarray(log.readings[log.kept, u] - (M @ frame.f).T - places.bias[u])


def _in_su(fitted: Fitted, frames: list[FrameMotion], u: int) -> F64:
    """(K, 3, 3) the base's axes as an SU sees them."""
    R = fitted.state.placements.T_joint_su[u, :3, :3].T
    frame = frames[int(fitted.problem.tree.su_joint[u])]
    return np.asarray(R @ np.moveaxis(frame.R_frame_base, 2, 0))


def _columns(fitted: Fitted, g: int) -> list[F64]:
    """Per joint (K, 3, n) accelerations in the base frame of what it carries, for each number.

    The last ones are of joints that the tree lacks, as if they were on the base.
    """
    log, tree = fitted.problem.logs[g], fitted.problem.tree
    frames = _standing(fitted, g, slice(None))
    out: list[F64] = []
    for j, slides in enumerate(tree.prismatic):
        R = np.moveaxis(frames[int(tree.parent[j])].R_frame_base, 2, 0).swapaxes(1, 2)
        q = log.q[:, j]
        out.append(_accelerations(log, R, [q] if slides else [np.sin(q), np.cos(q)]))
    fixed = np.broadcast_to(np.eye(3), (len(log.q), 3, 3))
    return out + [_accelerations(log, fixed, [np.sin(q), np.cos(q)]) for q in log.left_out.T]


def _accelerations(log: Trajectory, R: F64, functions: Sequence[F64]) -> F64:
    """(K, 3, n) second derivatives of axes R (N, 3, 3) times functions (N,), low-passed."""
    parts = []
    for f in functions:
        path = (R * f[:, None, None]).reshape(len(f), 9)
        there = filtered(second_derivative(path, log.rate), log.taps)[log.kept]
        parts.append(there.reshape(-1, 3, 3))
    return np.concatenate(parts, axis=2)


def _foretold(columns: F64, residual: F64, time: F64) -> float:
    """Sum of squares of residuals (K, 3) that columns (K, 3, n) foretell, from other stretches."""
    even = (time // STRETCH) % 2 == 0
    out = 0.0
    for here in (even, ~even):
        A, y = columns[~here].reshape(-1, columns.shape[2]), residual[~here].ravel()
        x = np.linalg.lstsq(A, y, rcond=1e-6)[0]
        rest = residual[here].ravel() - columns[here].reshape(-1, columns.shape[2]) @ x
        out += float((residual[here] ** 2).sum() - (rest**2).sum())
    return max(0.0, out)
