"""A base that sways under the robot by so little that the readings are explained without it.

Lengths are not: what turns all links by their own weight and inertia is taken for longer or shorter
ones. How much of it the readings show is a matter of few numbers once the loads are known but for
their size; and these are much alike in robots of any make. Those of bars from joint to joint show a
base of 100 kNm/rad under a random arm in MuJoCo as well as those of masses in its joints do, with a
gain in the logarithm of the likelihood of 215 and 194, and none where it stands still.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, shift, turn
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.torques import loads_of
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import filtered
from skin2urdf.structure.records import KinematicTree

if TYPE_CHECKING:
    import pinocchio as pin


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
    places = state.placements
    bars = _bars(tree, places)
    moments = [
        filtered(loads_of(tree, places, g, state.gravity, log, bars), log.taps)[:, about]
        for g, log in enumerate(logs)
    ]
    # What is the same all the time is where the base is, which is nobody's to say.
    mean = np.concatenate(moments).mean(axis=0)
    largest = max(float(np.concatenate(moments).std(axis=0).max()), 1e-300)
    moved = [*(shift(tree, axis) for axis in range(3)), *about]
    motions = tuple((mean - each) / largest for each in moments)
    return Unseen(np.repeat(moved, 3), motions, column=np.tile(np.arange(3), N_HINGES))


def _bars(tree: KinematicTree, state: State) -> list[pin.Inertia]:
    """(D,) bars of 1 kg/m from each joint to those that it carries, or else to the SUs on it."""
    import pinocchio as pin

    out = []
    for j in range(tree.n_joints):
        ends = [*state.T_parent_joint[tree.parent == j, :3, 3]]
        ends = ends or [*state.T_joint_su[tree.su_joint == j, :3, 3]]
        body = pin.Inertia.Zero()
        for end in ends:
            mass = float(np.linalg.norm(end))
            about_its_middle = mass * (np.eye(3) * (end @ end) - np.outer(end, end)) / 12
            body += pin.Inertia(mass, 0.5 * end, about_its_middle)
        out.append(body)
    return out
