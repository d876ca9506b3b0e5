"""A robot with joints in another order, or an SU elsewhere, nearly where they were.

Where no SU sits between two joints and each moved while the other stayed in one place, both orders
carry all SUs along the same ways: about the same axes, which are elsewhere while the robot is where
it never was. With ``E`` the motion of a joint along its z axis, ``a`` before ``b``, a at c while b
moves, and b at d while a does::

    A E(a) B E(b) C  =  A' E(b) B' E(a) C',    A' = A E(c) B,  B' = (E(c) B E(d))^-1,  C' = B E(d) C
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.geometry.se3 import inverse
from skin2urdf.geometry.so3 import rotation_log
from skin2urdf.model.poses import joint_poses, joint_transform, su_poses
from skin2urdf.structure.records import KinematicTree

_DRAWN = 400
"""Positions that are drawn from the joints' ranges."""


def reordered(
    tree: KinematicTree, state: State, joint: int, q: F64, weights: F64
) -> tuple[KinematicTree, State]:
    """A robot with a joint before the one that it follows.

    Args:
        tree: D joints.
        state: their placements.
        joint: one of :func:`~skin2urdf.structure.ordering.bare_neighbours`.
        q: (N, D) positions [rad or m].
        weights: (N, D) how much each tells where other joints are while this one moves.
    """
    a, b = int(tree.parent[joint]), joint
    # How far a is while b moves, and b while a does.
    c, d = (
        float(weights[:, moving] @ q[:, staying] / max(weights[:, moving].sum(), 1e-300))
        for moving, staying in ((b, a), (a, b))
    )
    A, B = state.T_parent_joint[a], state.T_parent_joint[b]
    E_c, E_d = joint_transform(tree, a, np.array(c)), joint_transform(tree, b, np.array(d))
    T_parent_joint, T_joint_su = state.T_parent_joint.copy(), state.T_joint_su.copy()
    T_parent_joint[a], T_parent_joint[b] = A @ E_c @ B, inverse(E_c @ B @ E_d)
    T_parent_joint[tree.parent == b] = B @ E_d @ T_parent_joint[tree.parent == b]
    T_joint_su[tree.su_joint == b] = B @ E_d @ T_joint_su[tree.su_joint == b]
    names, types = list(tree.joint_names), list(tree.joint_types)
    names[a], names[b], types[a], types[b] = names[b], names[a], types[b], types[a]
    other = replace(tree, joint_names=tuple(names), joint_types=tuple(types))
    return other, replace(state, T_parent_joint=T_parent_joint, T_joint_su=T_joint_su)


def hung_on(
    tree: KinematicTree, state: State, su: int, joint: int, q: F64
) -> tuple[KinematicTree, State]:
    """A robot with an SU on another joint, where it is at some positions.

    Args:
        tree: D joints.
        state: their placements.
        su: which SU.
        joint: that carries it then; -1 for the base.
        q: (D,) positions [rad or m].
    """
    T = joint_poses(state.model(tree), q)
    T_joint_su, su_joint = state.T_joint_su.copy(), tree.su_joint.copy()
    T_joint_su[su] = inverse(T[joint]) @ T[su_joint[su]] @ T_joint_su[su]
    su_joint[su] = joint
    return replace(tree, su_joint=su_joint), replace(state, T_joint_su=T_joint_su)


def branched(
    tree: KinematicTree, state: State, joint: int, parent: int, q: F64
) -> tuple[KinematicTree, State]:
    """A robot with a joint, and all beyond it, on another joint, where it is at some positions.

    Args:
        tree: D joints.
        state: their placements.
        joint: that goes.
        parent: that carries it then, none beyond it; -1 for the base.
        q: (D,) positions [rad or m].
    """
    T = joint_poses(state.model(tree), q)
    T_parent_joint, parents = state.T_parent_joint.copy(), tree.parent.copy()
    T_parent_joint[joint] = inverse(T[parent]) @ T[tree.parent[joint]] @ T_parent_joint[joint]
    parents[joint] = parent
    order: list[int] = []
    while len(order) < tree.n_joints:
        order += [j for j in range(tree.n_joints) if j not in order and parents[j] in (*order, -1)]
    place = np.append(np.argsort(order), -1)
    other = replace(
        tree,
        joint_names=tuple(tree.joint_names[j] for j in order),
        joint_types=tuple(tree.joint_types[j] for j in order),
        parent=place[parents[order]],
        su_joint=place[tree.su_joint],
    )
    return other, replace(state, T_parent_joint=T_parent_joint[order])


def apart(
    one: tuple[KinematicTree, State],
    other: tuple[KinematicTree, State],
    positions: Mapping[str, F64],
) -> tuple[float, float]:
    """How differently two robots carry the SUs that both have.

    Args:
        one: a robot, and
        other: another one.
        positions: (N,) of each joint that either has, by name; displacements are those from the
            first.

    Returns:
        By how much SUs are displaced [m] and turned [rad] otherwise, rms over positions and SUs.
    """
    displaced = []
    names = [name for name in one[0].su_names if name in other[0].su_names]
    for tree, state in (one, other):
        q = np.stack([positions[name] for name in tree.joint_names], axis=1)
        T = su_poses(state.model(tree), q)
        T = T[:, [tree.su_names.index(name) for name in names]]
        displaced.append(inverse(T[:1]) @ T)
    T_one, T_other = displaced
    shift = T_one[..., :3, 3] - T_other[..., :3, 3]
    turn = rotation_log(np.swapaxes(T_one[..., :3, :3], -1, -2) @ T_other[..., :3, :3])
    return _rms(shift), _rms(turn)


def elsewhere(
    one: tuple[KinematicTree, State],
    other: tuple[KinematicTree, State],
    positions: Mapping[str, F64],
) -> float:
    """By how much SUs are elsewhere over all positions within the ranges of some, rms [m].

    Args:
        one: a robot, and
        other: another one that carries SUs alike along these positions.
        positions: of each joint that either has, by name [rad or m].
    """
    rng = np.random.default_rng(0)
    drawn = {
        name: np.append(q[0], rng.uniform(q.min(), q.max(), _DRAWN))
        for name, q in positions.items()
    }
    return apart(one, other, drawn)[0]


def _rms(vectors: F64) -> float:
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))
