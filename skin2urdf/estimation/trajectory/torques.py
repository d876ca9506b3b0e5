"""Torques of the joints, and moments on the base, per inertial parameter of the links.

They are linear in masses, first moments and moments of inertia (Atkeson, An and Hollerbach 1986),
in the order of Pinocchio's regressors: ten numbers for what each joint carries.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, Skeleton
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

if TYPE_CHECKING:
    import pinocchio as pin

N_INERTIAL = 10
"""Inertial parameters of a link."""
_MASSLESS = 1e-6
"""Mass of a body at least, over that of others and over its moments at 1 m: torques are then as
exact as regressors make them, to 1e-14."""
_HEAVY = 2.0
"""Mass of each body, over the largest mass and moment at 1 m, beside which no mass is negative."""
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
    model, skeleton, (q, qd, qdd) = _dynamics(tree, state, g, gravity, log, base=base)
    data, numbers, first = model.createData(), skeleton.numbers, len(skeleton.hinges)
    for begin in range(0, len(q), _AT_ONCE):
        at = slice(begin, min(begin + _AT_ONCE, len(q)))
        Y = np.empty((at.stop - begin, D + first, N_INERTIAL * D))
        for i in range(len(Y)):
            n = begin + i
            of_all = pin.computeJointTorqueRegressor(model, data, q[n], qd[n], qdd[n])
            # Of a single joint it is a vector. What hinges carry themselves stands still: its
            # parameters show in nothing.
            Y[i, numbers] = of_all.reshape(D + first, -1)[:, N_INERTIAL * first :]
        yield Y, at


def loads_of(
    tree: KinematicTree,
    state: State,
    g: int,
    gravity: float,
    log: Trajectory,
    inertias: Sequence[pin.Inertia],
    *,
    base: bool = True,
) -> F64:
    """(N, D + 6) torques of joints, and loads of the base's hinges, by known bodies [N m or N].

    Args:
        tree: D joints.
        state: placements, and gravity's direction per log.
        g: number of the log.
        gravity: its magnitude [m/s^2].
        log: the motion of the links.
        inertias: (D,) of what each joint carries, in its frame.
        base: whether those of the base are wanted; else (N, D).
    """
    import pinocchio as pin

    model, skeleton, motion = _dynamics(tree, state, g, gravity, log, base=base)
    _load(model, inertias)
    out = np.empty_like(motion[0])
    # All samples in one call: one by one, most of the time is spent between the calls.
    of_all = pin.rneaInParallel(1, pin.ModelPool(model, 1), *(x.T for x in motion))
    # Of a single joint they are a vector.
    out[:, skeleton.numbers] = of_all.T.reshape(out.shape)
    return out


def joint_inertias(
    tree: KinematicTree,
    state: State,
    log: Trajectory,
    parameters: F64,
    *,
    base: bool = False,
) -> F64:
    """(N, D, D) inertia that bodies have in the joints, along a log [kg m^2, kg m or kg].

    Args:
        tree: D joints.
        state: placements.
        log: the motion of the links.
        parameters: (10 D,) of the bodies, in the order of Pinocchio's regressors.
        base: whether that in the base's hinges is wanted, too; (N, D + 6, D + 6) then.
    """
    import pinocchio as pin

    # Pinocchio takes it for granted that what a joint carries follows it in a row.
    order = tree.depth_first
    tree, state, log = _ordered(tree, state, log, order)
    model, skeleton, (q, _, _) = _dynamics(tree, state, 0, 0.0, log, base=base)
    # Pinocchio adds up bodies, of which none may weigh nothing: what is added is taken off again.
    parameters = parameters.reshape(-1, N_INERTIAL)[order]
    heavy = np.zeros_like(parameters)
    heavy[:, 0] = _HEAVY * np.abs(parameters[:, :4]).max(initial=1e-300)
    upper = np.zeros((len(q), model.nv, model.nv))
    for sign, added in ((1, heavy + parameters), (-1, heavy)):
        _load(model, bodies(added.ravel()))
        data = model.createData()
        for n, x in enumerate(q):
            upper[n] += sign * pin.crba(model, data, x)
    upper = np.triu(upper)
    out = np.empty_like(upper)
    numbers = np.append(order, tree.n_joints + np.arange(N_HINGES))[skeleton.numbers]
    out[:, numbers[:, None], numbers] = upper + np.triu(upper, 1).swapaxes(1, 2)
    return out


def bodies(parameters: F64) -> list[pin.Inertia]:
    """The bodies of inertial parameters (10 D,), in the order of Pinocchio's regressors.

    Pinocchio divides by masses; one that shows in no motion may be found to be none beside moments
    that show. It is then as small a part of these, and of other masses, as changes nothing.
    """
    import pinocchio as pin

    out = np.array(parameters.reshape(-1, N_INERTIAL))
    mass, moments = out[:, 0], np.linalg.norm(out[:, 1:4], axis=1)
    least = _MASSLESS * np.maximum(moments, np.abs(mass).max(initial=0.0)).clip(min=1e-300)
    out[:, 0] = np.where(np.abs(mass) < least, np.copysign(least, mass), mass)
    return [pin.Inertia.FromDynamicParameters(each) for each in out]


def _load(model: pin.Model, inertias: Sequence[pin.Inertia]) -> None:
    """Give the last joints of a model their bodies."""
    for joint, inertia in enumerate(inertias, model.njoints - len(inertias)):
        model.inertias[joint] = inertia


def _dynamics(
    tree: KinematicTree, state: State, g: int, gravity: float, log: Trajectory, *, base: bool
) -> tuple[pin.Model, Skeleton, tuple[F64, F64, F64]]:
    """A robot without masses, its hinges, and positions and their derivatives in its order."""
    D = tree.n_joints
    skeleton = Skeleton(tree, D + np.arange(N_HINGES if base else 0))
    built = PinocchioTree(skeleton.tree)
    built.write_joints(skeleton.placements(state.T_parent_joint))
    built.model.gravity.linear = -gravity * state.up[g]
    still = np.zeros((len(log.q), max(0, D + len(skeleton.hinges) - log.q.shape[1])))
    q, qd, qdd = (
        np.ascontiguousarray(np.hstack([x, still])[:, skeleton.numbers])
        for x in (log.q, log.qd, log.qdd)
    )
    return built.model, skeleton, (q, qd, qdd)


def _ordered(
    tree: KinematicTree, state: State, log: Trajectory, order: Int
) -> tuple[KinematicTree, State, Trajectory]:
    """The same with joints in another order (D,); the base's hinges stay where they are."""
    rank = np.append(np.argsort(order), -1)
    columns = np.append(order, tree.n_joints + np.arange(N_HINGES))[: log.q.shape[1]]
    return (
        replace(
            tree,
            joint_names=tuple(tree.joint_names[j] for j in order),
            parent=rank[tree.parent[order]],
            joint_types=tuple(tree.joint_types[j] for j in order),
            su_joint=rank[tree.su_joint],
        ),
        replace(state, T_parent_joint=state.T_parent_joint[order]),
        replace(log, q=log.q[:, columns], qd=log.qd[:, columns], qdd=log.qdd[:, columns]),
    )


def inertial_sizes(state: State) -> F64:
    """(10 D,) sizes of mass, first and second moments that belong to each other, per unit mass.

    Lengths are those of the robot's links.
    """
    arms = np.concatenate([state.T_parent_joint[:, :3, 3], state.T_joint_su[:, :3, 3]])
    arm = float(np.sqrt((arms**2).sum(axis=1).mean())) or 1.0
    return np.tile([1.0, *[arm] * 3, *[arm**2] * 6], len(state.T_parent_joint))
