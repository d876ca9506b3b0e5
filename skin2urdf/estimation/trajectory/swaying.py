"""A base that sways under the robot by so little that the readings are explained without it.

Lengths are not: what turns all links by their own weight and inertia is taken for longer or shorter
ones. How much of it the readings show is a matter of few numbers once the loads are known but for
their size; and these are much alike in robots of any make. Those of bars from joint to joint show a
base of 100 kNm/rad under a random arm in MuJoCo as well as those of masses in its joints do, with a
gain in the logarithm of the likelihood of 215 and 194, and none where it stands still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.kinematics import FrameMotion, cross, frame_motions
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, shift, turn
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import filtered
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_TOGETHER = 4096
"""Samples of which moments are worked out at once: as many as caches hold of a robot."""


def swaying(problem: MotionProblem, state: MotionState) -> Unseen | None:
    """Turns and shifts of the base by moments about its three axes; None where it moves already.

    Args:
        problem: what was fitted.
        state: where.
    """
    tree, logs = problem.tree, problem.logs
    if problem.unseen is not None and problem.unseen.moves_base(tree.n_joints):
        return None
    places = state.placements
    bars = _bars(tree, places)
    moments = [
        filtered(_moments(tree, places, places.up[g] * state.gravity, log, bars).T, log.taps)
        for g, log in enumerate(logs)
    ]
    # What is the same all the time is where the base is, which is nobody's to say.
    mean = np.concatenate(moments).mean(axis=0)
    largest = max(float(np.concatenate(moments).std(axis=0).max()), 1e-300)
    turns = [turn(tree, axis) for axis in range(3)]
    moved = [*(shift(tree, axis) for axis in range(3)), *turns]
    motions = tuple((mean - each) / largest for each in moments)
    return Unseen(np.repeat(moved, 3), motions, column=np.tile(np.arange(3), N_HINGES))


@dataclass(frozen=True, eq=False)
class _Body:
    """What a joint carries, in its frame.

    Attributes:
        mass: [kg].
        first: (3,) first moments [kg m].
        second: (3, 3) second moments [kg m^2].
    """

    mass: float
    first: F64
    second: F64


def _bars(tree: KinematicTree, state: State) -> list[_Body]:
    """(D,) bars of 1 kg/m from each joint to those that it carries, or else to the SUs on it."""
    out = []
    for j in range(tree.n_joints):
        ends = state.T_parent_joint[tree.parent == j, :3, 3]
        ends = ends if len(ends) else state.T_joint_su[tree.su_joint == j, :3, 3]
        mass = np.linalg.norm(ends, axis=1)
        second = np.einsum("n,ni,nj->ij", mass, ends, ends) / 3
        out.append(_Body(float(mass.sum()), 0.5 * mass @ ends, second))
    return out


def _moments(
    tree: KinematicTree, state: State, up: F64, log: Trajectory, bodies: list[_Body]
) -> F64:
    """(3, N) moments about the base's axes that it takes to carry and move bodies [N m].

    Args:
        tree: D joints.
        state: placements.
        up: (3,) specific force of a resting body in the base frame [m/s^2].
        log: the motion of the links.
        bodies: (D,) what each joint carries.
    """
    out = np.empty((3, len(log.q)))
    for begin in range(0, len(log.q), _TOGETHER):
        some = slice(begin, begin + _TOGETHER)
        q, qd, qdd = (np.ascontiguousarray(x[some].T) for x in (log.q, log.qd, log.qdd))
        _, carried = frame_motions(tree, state.T_parent_joint, up, q, qd, qdd)
        total = np.zeros((3, q.shape[1]))
        origin = {-1: total.copy()}
        for j, body in enumerate(bodies):
            parent, R = int(tree.parent[j]), carried[j].R_frame_base
            arm = state.T_parent_joint[j, :3, 3]
            origin[j] = origin[parent] + _along(carried[parent].R_frame_base, arm[:, None])
            if tree.prismatic[j]:
                origin[j] += R[2] * q[j]
            force, moment = _load(carried[j], body)
            total += cross(origin[j], _along(R, force)) + _along(R, moment)
        out[:, some] = total
    return out


def _along(R_frame_base: F64, x: F64) -> F64:
    """(3, K) vectors of a frame, along the axes of the base."""
    return np.asarray((R_frame_base * x[:, None]).sum(axis=0))


def _load(frame: FrameMotion, body: _Body) -> tuple[F64, F64]:
    """(3, K) force on a body, and moment about the origin of its frame, in that frame."""
    A, f = frame.A, frame.f
    force = body.mass * f + np.einsum("ijk,j->ik", A, body.first)
    # Of a place c, c x (f + A c).
    pulled = np.tensordot(body.second, A, axes=(1, 1))
    turning = np.stack([pulled[b, c] - pulled[c, b] for b, c in ((1, 2), (2, 0), (0, 1))])
    return force, cross(body.first[:, None], f) + turning
