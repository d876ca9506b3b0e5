"""Torques of the joints, and moments on the base, per inertial parameter of the links.

They are linear in masses, first moments and moments of inertia (Atkeson, An and Hollerbach 1986),
in the order of Pinocchio's regressors: ten numbers for what each joint carries.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, Skeleton
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

N_INERTIAL = 10
"""Inertial parameters of a link."""
_AT_ONCE = 2000
"""Samples whose regressors are held at a time."""


def regressors(
    tree: KinematicTree,
    state: State,
    g: int,
    gravity: float,
    log: Trajectory,
    *,
    base: bool = False,
) -> Iterator[tuple[F64, slice]]:
    """Torques per inertial parameter along the motion of the links, some samples at a time.

    Args:
        tree: D joints.
        state: placements, and gravity's direction per log.
        g: number of the log.
        gravity: its magnitude [m/s^2].
        log: the motion of the links, of the base's hinges too where they move.
        base: whether forces and moments on the base are wanted, too.

    Yields:
        (n, D, 10 D), or (n, D + 6, 10 D) with those of the base as numbered in :mod:`skeleton`, and
        which samples they are of.
    """
    import pinocchio as pin

    D = tree.n_joints
    skeleton = Skeleton(tree, D + np.arange(N_HINGES if base else 0))
    numbers, first = skeleton.numbers, len(skeleton.hinges)
    built = PinocchioTree(skeleton.tree)
    built.write_joints(skeleton.placements(state.T_parent_joint))
    model = built.model
    model.gravity.linear = -gravity * state.up[g]
    data = model.createData()
    still = np.zeros((len(log.q), max(0, D + first - log.q.shape[1])))
    q, qd, qdd = (
        np.ascontiguousarray(np.hstack([x, still])[:, numbers]) for x in (log.q, log.qd, log.qdd)
    )
    for begin in range(0, len(q), _AT_ONCE):
        at = slice(begin, min(begin + _AT_ONCE, len(q)))
        Y = np.empty((at.stop - begin, D + first, N_INERTIAL * D))
        for i in range(len(Y)):
            n = begin + i
            of_all = pin.computeJointTorqueRegressor(model, data, q[n], qd[n], qdd[n])
            # What hinges carry themselves stands still: its parameters show in nothing.
            Y[i, numbers] = of_all[:, N_INERTIAL * first :]
        yield Y, at


def inertial_sizes(state: State) -> F64:
    """(10 D,) sizes of mass, first and second moments that belong to each other, per unit mass.

    Lengths are those of the robot's links.
    """
    arms = np.concatenate([state.T_parent_joint[:, :3, 3], state.T_joint_su[:, :3, 3]])
    arm = float(np.sqrt((arms**2).sum(axis=1).mean())) or 1.0
    return np.tile([1.0, *[arm] * 3, *[arm**2] * 6], len(state.T_parent_joint))
