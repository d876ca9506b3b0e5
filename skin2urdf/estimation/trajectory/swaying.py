"""A base that sways under the robot by so little that the readings are explained without it.

Lengths are not: what turns all links by their own weight and inertia is taken for longer or shorter
ones. How much of it the readings show is a matter of few numbers once the loads are known but for
their size; and these are much alike in robots of any make. Those of bars from joint to joint show a
base of 100 kNm/rad under a random arm in MuJoCo as well as those of masses in its joints do, with a
gain in the logarithm of the likelihood of 215 and 194, and none where it stands still.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, Skeleton, shift, turn
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.signals.filters import filtered
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree


def swaying(problem: MotionProblem, state: MotionState) -> Unseen | None:
    """Turns and shifts of the base by moments about its three axes; None where it moves already.

    Args:
        problem: what was fitted.
        state: where.
    """
    tree, logs = problem.tree, problem.logs
    if problem.unseen is not None and problem.unseen.moves_base(tree.n_joints):
        return None
    about = [turn(tree, axis) for axis in range(3)]
    moments = [
        _loads(tree, state.placements, g, state.gravity, log)[:, about]
        for g, log in enumerate(logs)
    ]
    # What is the same all the time is where the base is, which is nobody's to say.
    mean = np.concatenate(moments).mean(axis=0)
    largest = max(float(np.concatenate(moments).std(axis=0).max()), 1e-300)
    moved = [*(shift(tree, axis) for axis in range(3)), *about]
    motions = tuple(np.tile((mean - each) / largest, N_HINGES) for each in moments)
    return Unseen(np.repeat(moved, 3), motions)


def _loads(tree: KinematicTree, state: State, g: int, gravity: float, log: Trajectory) -> F64:
    """(N, D + 6) loads of joints and of the base's hinges by bars of 1 kg/m [Nm or N], low-passed.

    A bar leads from a joint to each that it carries, or else to the SUs on it.
    """
    import pinocchio as pin

    D = tree.n_joints
    skeleton = Skeleton(tree, D + np.arange(N_HINGES))
    built = PinocchioTree(skeleton.tree)
    built.write_joints(skeleton.placements(state.T_parent_joint))
    model = built.model
    for j in range(D):
        ends = [*state.T_parent_joint[tree.parent == j, :3, 3]]
        ends = ends or [*state.T_joint_su[tree.su_joint == j, :3, 3]]
        body = pin.Inertia.Zero()
        for end in ends:
            mass = float(np.linalg.norm(end))
            about_its_middle = mass * (np.eye(3) * (end @ end) - np.outer(end, end)) / 12
            body += pin.Inertia(mass, 0.5 * end, about_its_middle)
        model.inertias[N_HINGES + j + 1] = body
    model.gravity.linear = -gravity * state.up[g]
    data = model.createData()
    still = np.zeros((len(log.q), N_HINGES))
    q, qd, qdd = (
        np.ascontiguousarray(np.hstack([x, still])[:, skeleton.numbers])
        for x in (log.q, log.qd, log.qdd)
    )
    out = np.empty_like(q)
    for n in range(len(q)):
        out[n, skeleton.numbers] = pin.rnea(model, data, q[n], qd[n], qdd[n])
    return filtered(out, log.taps)
