"""What it would change if the other one of two clocks were right.

Lengths come from accelerations: where time runs too fast by a share d, they come out longer by 2 d.
Of a limb whose joints have a publisher of their own, and whose SUs feel no other's joints, nothing
tells whose clock keeps time, that of its joints or that of its SUs, where all of these drift alike.
Positions are taken to be stamped rightly, and what the other choice would make of lengths is an
error that nobody can rule out.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.state import N_JOINT, State
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.publishers import beyond_first
from skin2urdf.structure.records import KinematicTree


def of_the_other_clock(problem: MotionProblem, fitted: Fitted, drift: F64) -> list[tuple[F64, F64]]:
    """Parts (J,) and (U, n) of the gradient, one for each limb with a publisher of its own.

    Args:
        problem: what was fitted.
        fitted: the fit.
        drift: (G, U) by how much the clock of each SU gains on the joints', in every log [s/s].
    """
    out, equations = [], fitted.equations
    for log, of_log in zip(problem.logs, drift, strict=True):
        for joints in beyond_first(log):
            sus = _beyond_these_alone(problem.tree, joints)
            if not len(sus):
                continue
            joint, su = _longer(problem, fitted.state.placements, joints, sus)
            joint, su = (2 * float(np.median(of_log[sus])) * each for each in (joint, su))
            by_joint = equations.joint @ joint + np.einsum("unj,un->j", equations.mixed, su)
            by_su = np.einsum("unm,um->un", equations.su, su) + equations.mixed @ joint
            out.append((by_joint, by_su))
    return out


def _beyond_these_alone(tree: KinematicTree, joints: Int) -> Int:
    """SUs that feel some of these joints, and no other."""
    chains = [set(tree.chain(j)) if j >= 0 else set() for j in tree.su_joint.tolist()]
    return np.flatnonzero([bool(chain) and chain <= set(joints.tolist()) for chain in chains])


def _longer(problem: MotionProblem, places: State, joints: Int, sus: Int) -> tuple[F64, F64]:
    """Steps (J,) and (U, n) by which a limb is longer by its own length.

    A joint's frame stays where it is along its axis, which nothing shows: what it carries goes
    along in its place.
    """
    tree, layout = problem.tree, problem.layout
    joint, su = np.zeros(layout.n_joint), np.zeros((tree.n_sus, layout.n_su))
    along = np.zeros((tree.n_joints, 3))
    for j in range(tree.n_joints):
        parent = int(tree.parent[j])
        if j in joints and parent in joints:
            T = places.T_parent_joint[j]
            step = T[:3, :3].T @ (T[:3, 3] + along[parent])
            joint[N_JOINT * j : N_JOINT * j + 2] = step[:2]
            along[j, 2] = step[2]
    for u in sus:
        T = places.T_joint_su[u]
        su[u, :3] = T[:3, :3].T @ (T[:3, 3] + along[tree.su_joint[u]])
    return np.where(problem.free_joint, joint, 0.0), np.where(problem.free_su, su, 0.0)
