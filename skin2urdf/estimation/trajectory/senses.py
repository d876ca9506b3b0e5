"""Which way round joints turn whose axes are vertical, where no others turn what they carry.

Gravity does not show such a joint, and patterns show what it pushes to first order: as well an axis
on the one side that turns to the left as one on the other side that turns to the right. What tells
them apart is the pull towards the axis when the joint turns fast, which moves have. So a fit is
held against one that begins on the other side. Several such joints hide each other's senses where
their axes lie close to each other. Where a joint that is not vertical turns what is carried,
patterns do tell, and slow moves may not: a joint in the wrong sense then moves by minus twice of
what its encoder says besides, as the readings have it, or sensors beyond it are mirror images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import size_of
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.geometry.se3 import inverse, placement, screw
from skin2urdf.geometry.so3 import axis_rotation, frame_with_z, wahba
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_VERTICAL = np.cos(np.deg2rad(20.0))
"""Cosine of the angle between an axis and gravity up to which the other sense is looked at.

An axis is known to a degree or better where gravity shows it; a sense that is wrong has bent one by
11 and 21 deg. What this decides about is time alone: one fit more."""
_BACKWARDS = 0.1
"""Share of what its encoder says by which a joint seems to move less from which the other sense is
looked at. Minus two is drawn towards zero, where the readings tell little, and no gear's ratio is
off by a tenth: what this decides about is time alone, one fit more."""


def in_likelier_sense(
    problem: MotionProblem, fitted: Fitted, begin: State, iterations: int
) -> Fitted:
    """The fit, or one with joints the other way round where samples are likelier then.

    Args:
        problem: the logs, the tree and what is known before.
        fitted: its fit.
        begin: where that began; a fit in the wrong sense may have bent all axes.
        iterations: linearisations, at most, of another fit.
    """
    if problem.priors.blueprint is not None:
        return fitted
    tree, logs = problem.tree, problem.logs
    for joint in _bent(tree, fitted.state.placements):
        start = mirrored(tree, begin, joint, logs)
        likelier = _likelier(problem, fitted, start, iterations)
        if likelier is not fitted:
            fitted, begin = likelier, start
    q = np.concatenate([log.q for log in logs]).mean(axis=0)
    groups = _backwards(problem, fitted) + hidden_senses(tree, fitted.state.placements)
    for joints in groups:
        start = turned_round(tree, fitted.state.placements, joints, q)
        fitted = _likelier(problem, fitted, start, iterations)
    return fitted


def _likelier(problem: MotionProblem, fitted: Fitted, start: State, iterations: int) -> Fitted:
    """The fit, or one that begins elsewhere where samples are likelier then."""
    other = fit(problem, replace(fitted.state, placements=start), iterations=iterations)
    return other if minus_log_posterior(other) < minus_log_posterior(fitted) else fitted


def _backwards(problem: MotionProblem, fitted: Fitted) -> list[tuple[int, ...]]:
    """Vertical joints that carry others and seem to move against their encoders, to first order."""
    first = _carrying(problem.tree, fitted.state.placements)
    if not first:
        return []
    more = Unseen(np.array(first), tuple(log.q[:, first] for log in problem.logs))
    shares = size_of(problem, fitted, more).numbers
    return [(j,) for j, share in zip(first, shares, strict=True) if share < -_BACKWARDS]


def _bent(tree: KinematicTree, state: State) -> list[int]:
    """Vertical joints beyond which, and beyond another one, sensors have errors that none has."""
    odd = {int(j) for j in tree.su_joint[~are_plausible(state)]}
    beyond = {k for joint in odd for k in tree.chain(joint)[:-1]}
    return [j for j in _carrying(tree, state) if j in beyond]


def _carrying(tree: KinematicTree, state: State) -> list[int]:
    """Vertical joints that only sliding ones come before, and that carry others than such."""
    told = {joints[0] for joints in hidden_senses(tree, state)}
    return [
        j for j in range(tree.n_joints)
        if j not in told
        and not tree.prismatic[j]
        and all(tree.prismatic[k] for k in tree.chain(j)[:-1])
        and _is_vertical(tree, state, j)
    ]  # fmt: skip


def minus_log_posterior(fitted: Fitted) -> float:
    """Negative logarithm of the posterior of a fit, but for a constant.

    Of noise that all samples of an SU in a log share: fast moments tell senses apart, and these are
    few, so that noise by most samples takes no notice. Sensors that are mirrored across the axis
    would explain the wrong one, but are none.
    """
    total = 0.5 * fitted.problem.prior_chi2(fitted.state)
    for log, each in zip(fitted.problem.logs, fitted.predicted, strict=True):
        square = np.where(each.measured, (each.residual**2).sum(axis=2), 0.0).sum(axis=0)
        count = 3.0 * log.independence * each.measured.sum(axis=0)
        heard = (count > 0) & (square > 0)
        total += float((count[heard] / 2 * np.log(square[heard] / count[heard])).sum())
    return total


def hidden_senses(tree: KinematicTree, state: State) -> list[tuple[int, ...]]:
    """Joints whose senses neither gravity nor patterns need show, by those that hide each other's.

    Of several vertical axes patterns tell the senses by how far apart these are.

    Args:
        tree: the structure.
        state: its placements.

    Returns:
        The joints of each group, the one that carries the others first.
    """
    vertical = [
        not tree.prismatic[j] and _is_vertical(tree, state, j) for j in range(tree.n_joints)
    ]
    chains = [tree.chain(k) for k in range(tree.n_joints)]
    out = []
    for j in range(tree.n_joints):
        carried = [k for k in range(tree.n_joints) if j in chains[k] and not tree.prismatic[k]]
        before = [k for k in chains[j] if k != j and not tree.prismatic[k]]
        if not tree.prismatic[j] and not before and all(vertical[k] for k in carried):
            out.append(tuple(carried))
    return out


def _is_vertical(tree: KinematicTree, state: State, joint: int) -> bool:
    """Whether the axis of a joint that only sliding ones come before is vertical in all logs."""
    axis = np.eye(3)[2]
    for k in reversed(tree.chain(joint)):
        axis = state.T_parent_joint[k, :3, :3] @ axis
    return bool((np.abs(state.up @ axis) > _VERTICAL).all())


def turned_round(tree: KinematicTree, state: State, joints: Sequence[int], q: F64) -> State:
    """Placements with joints in the other sense, and what the first carries on its other side.

    Orientations stay, and so do pushes to first order. The sensors of what it carries begin without
    errors: a fit in the wrong sense bends them to the mirror images that no sensor is.

    Args:
        tree: the structure.
        state: placements.
        joints: the joints, the one that carries the others first.
        q: (D,) positions of the joints at which orientations stay.
    """
    motion = [
        screw("z", 0.0, at) if slides else screw("z", at, 0.0)
        for at, slides in zip(q, tree.prismatic, strict=True)
    ]
    before = _in_base(tree, state, motion)
    first, axis = joints[0], before[joints[0]]
    across = axis @ screw("z", np.pi, 0.0) @ inverse(axis)
    after = list(before)
    for k in range(tree.n_joints):
        if first in tree.chain(k):
            after[k] = _moved(across, before[k])
        if k in joints:
            after[k] = after[k] @ screw("x", np.pi, 0.0)
    T_parent_joint, T_joint_su = state.T_parent_joint.copy(), state.T_joint_su.copy()
    for k, parent in enumerate(tree.parent):
        if first in tree.chain(k):
            base = after[parent] if parent >= 0 else np.eye(4)
            T_parent_joint[k] = inverse(base) @ after[k] @ inverse(motion[k])
    bias, shape = state.bias.copy(), state.shape.copy()
    for u, k in enumerate(tree.su_joint):
        if k >= 0 and first in tree.chain(int(k)):
            T_joint_su[u] = inverse(after[k]) @ _moved(across, before[k] @ state.T_joint_su[u])
            bias[u], shape[u] = 0.0, 0.0
    return replace(
        state, T_parent_joint=T_parent_joint, T_joint_su=T_joint_su, bias=bias, shape=shape
    )


def mirrored(tree: KinematicTree, state: State, first: int, logs: Sequence[Trajectory]) -> State:
    """Placements of which these are a mirror image, without offsets and errors of sensors.

    A vertical joint in the wrong sense makes axes beyond it those of a robot that is mirrored at a
    horizontal plane, and sensors mirror images of what they are, as far as gravity tells.

    Args:
        tree: the structure.
        state: placements.
        first: the vertical joint.
        logs: trajectories, whose readings tell how SUs are turned.
    """
    up = state.up[0]
    across = np.eye(3) - 2 * np.outer(up, up)
    T_parent_joint, T_joint_su = state.T_parent_joint.copy(), state.T_joint_su.copy()
    before = _in_base(tree, state, [np.eye(4)] * tree.n_joints)
    after = list(before)
    for k, parent in enumerate(tree.parent):
        if first in tree.chain(k):
            # What slides has a direction, what turns an axis, which a mirror turns round besides.
            axis = (-across if tree.prismatic[k] else across) @ before[k][:3, 2]
            base = after[parent] if parent >= 0 else np.eye(4)
            after[k] = placement(frame_with_z(axis), base[:3, 3])
            T_parent_joint[k] = inverse(base) @ after[k]
    turned = replace(state, T_parent_joint=T_parent_joint)
    bias, shape = state.bias.copy(), state.shape.copy()
    for u, joint in enumerate(tree.su_joint.tolist()):
        if joint >= 0 and first in tree.chain(joint):
            T_joint_su[u] = placement(_facing(tree, turned, u, logs), np.zeros(3))
            bias[u], shape[u] = 0.0, 0.0
    return replace(turned, T_joint_su=T_joint_su, bias=bias, shape=shape)


def _facing(tree: KinematicTree, state: State, u: int, logs: Sequence[Trajectory]) -> F64:
    """(3, 3) how an SU is turned on its joint, as gravity has it."""
    read, seen = [], []
    for log, up in zip(logs, state.up, strict=True):
        at = log.kept[log.valid[:, u]]
        there = np.broadcast_to(up, (len(at), 3))
        for k in tree.chain(int(tree.su_joint[u])):
            there = there @ state.T_parent_joint[k, :3, :3]
            if not tree.prismatic[k]:
                turns = axis_rotation(np.array([0.0, 0.0, 1.0]), log.q[at, k])
                there = np.einsum("ni,nij->nj", there, turns)
        read.append(log.readings[at, u])
        seen.append(there)
    body = np.concatenate(read)
    return wahba(body, np.concatenate(seen), np.ones(len(body)))[0]


def _in_base(tree: KinematicTree, state: State, motion: Sequence[F64]) -> list[F64]:
    """(4, 4) each joint's frame, moved, in that of the base."""
    out: list[F64] = []
    for k, parent in enumerate(tree.parent):
        base = out[parent] if parent >= 0 else np.eye(4)
        out.append(base @ state.T_parent_joint[k] @ motion[k])
    return out


def _moved(across: F64, T: F64) -> F64:
    """A frame at another place, turned as it was."""
    return placement(T[:3, :3], (across @ T[:, 3])[:3])
