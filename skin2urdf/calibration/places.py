"""On which joint an SU sits, or a branch begins, that the rest of the robot does not explain.

What a first look at the structure says of a single SU rests on little where its joint hardly moves
it, or sensor and gears are poor, and so does which branches stand on a slide or a vertical joint,
which turn no gravity. All samples say more: where they leave far more of an SU than of the others,
it is tried a joint nearer to the base, and one farther; and where no rigid robot explains them,
branches are tried behind more of those joints, and fewer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.calibration.at_rest import fit_rigid, is_likelier
from skin2urdf.calibration.by_physics import leaves_only_noise
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.orders import solved_anew
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.calibration.rounds import Solution
from skin2urdf.estimation.problem.reordered import branched, hung_on
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.misfit import MOST_OF_IT
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.moving_base import felt_beside_the_mean
from skin2urdf.estimation.trajectory.slack import CERTAIN
from skin2urdf.estimation.trajectory.vertical import NEAREST, may_sit_on_the_base
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.model.poses import joint_poses
from skin2urdf.structure.records import KinematicTree

_VERTICAL = np.deg2rad(3.0)
"""Angle between an axis and gravity in which sensors' errors hide that it turns any."""


def in_told_place(
    solution: Solution, along: MotionEstimate, clock: Clock, *, of_patterns: bool
) -> Solution:
    """The robot with SUs where all samples find them, and branches behind the joints they find.

    Args:
        solution: the robot.
        along: what all samples say of it.
        clock: runs the stages.
        of_patterns: whether the robot rests on patterns, which show what a branch stands on.

    Returns:
        What a rigid robot finds likeliest: whether it is has to be seen with all that robots have.
    """
    if along.problem.tree.su_names != solution.found.tree.su_names:
        return solution
    worse = that_fit_worse(solution, along)
    ways: list[Callable[[MotionEstimate], Iterator[tuple[KinematicTree, State]]]]
    ways = [partial(_with_su_nearby, u=u) for u in worse]
    # What a rigid robot leaves, and other causes explain, may be a wrong tree's. And what a joint
    # that gravity does not show makes of slow readings passes for their noise.
    if worse or along.causes:
        ways.append(_with_branch_elsewhere)
    elif not of_patterns:
        ways.append(partial(_with_branch_elsewhere, only_farther=True))
    found, rigid = solution, None
    for way in ways:
        for tree, state in way(rigid or along):
            rigid = rigid or fit_rigid(found, clock)
            other = solved_anew(found, tree, state, clock)
            there = fit_rigid(other, clock)
            if rigid is not None and there is not None and _is_certain(rigid, there):
                found, rigid = other, there
    return found


def with_one_on_the_base(solution: Solution, along: MotionEstimate, clock: Clock) -> Solution:
    """The robot with an SU on the base that seemed to sit on the first joint.

    A base that sways as its first joint moves is felt as that joint is. Where all samples are not
    explained, and SUs on that joint fit worse than others, or it is vertical and does not tell, the
    one that feels least may sit on the base; so may one that would need errors that no sensor has,
    or would sit on the axis itself.
    Whether the base sways shows with all that robots have: to a rigid one the SU sits where it
    feels the same.

    Args:
        solution: the robot.
        along: what all samples say of it.
        clock: runs the stages.

    Returns:
        What was given where no SU is in such doubt.
    """
    tree = along.problem.tree
    if tree.su_names != solution.found.tree.su_names:
        return solution
    first = {u for u, j in enumerate(tree.su_joint) if j >= 0 and tree.parent[j] < 0}
    doubtful = first.intersection(np.flatnonzero(~are_plausible(along.state)).tolist())
    unexplained = along.misfit > GOOD_FIT
    if unexplained:
        doubtful |= first.intersection(that_fit_worse(solution, along))
    within = np.inf if unexplained else NEAREST
    in_doubt = may_sit_on_the_base(along.problem, along.state, within)
    doubtful |= {tree.su_names.index(su) for su in in_doubt}
    if not doubtful:
        return solution
    logs = along.problem.logs
    least = min(doubtful, key=lambda u: felt_beside_the_mean(logs, np.array([u]))[0])
    q = along.positions.mean(axis=0)
    return solved_anew(solution, *hung_on(tree, along.state, least, -1, q), clock)


def is_told(along: MotionEstimate, other: MotionEstimate) -> bool:
    """Whether SUs are elsewhere for certain.

    Where some of those fitted worse before, at most half of that is left of one of them: of another
    it may be as much as before, as its own sensor may be what is wrong with it. What an SU on the
    base feels is what the base does, and no part of a likelihood: that all others are then
    explained tells that it sits there, where it was not before, or by a sensor that is none, or on
    the axis itself.

    Args:
        along: the fit of all samples before, and
        other: with some elsewhere.
    """
    before, after = (each.problem.tree.chains() for each in (along, other))
    moved = np.array([before[name] != after.get(name) for name in along.problem.tree.su_names])
    worse = moved & (along.misfit_of_sus > GOOD_FIT)
    were, are = (each.misfit_of_sus[worse] - 1 for each in (along, other))
    explained = not worse.any() or bool((are <= MOST_OF_IT * were).any())
    plausible, still = (are_plausible(each.state) for each in (along, other))
    not_before = along.misfit > GOOD_FIT or bool((moved & ~plausible & still).any())
    if other.moving_base is not None:
        near = may_sit_on_the_base(along.problem, along.state, NEAREST)
        not_before |= bool(moved[[along.problem.tree.su_names.index(su) for su in near]].any())
    told = _is_certain(along, other) or (not_before and leaves_only_noise(other))
    return explained and told


def _is_certain(one: MotionEstimate, other: MotionEstimate) -> bool:
    """Whether another fit is likelier, by more where either leaves more than noise."""
    return is_likelier(one, other, CERTAIN * max(1.0, one.misfit, other.misfit))


def that_fit_worse(solution: Solution, along: MotionEstimate) -> list[int]:
    """SUs without a fault of which more than noise is left, where most leave no more.

    Args:
        solution: the robot, with its faults.
        along: the fit of all samples.
    """
    names = along.problem.tree.su_names
    worse = np.flatnonzero(along.misfit_of_sus > GOOD_FIT).tolist()
    faulty = {fault.subject for fault in solution.faults}
    return [u for u in worse if names[u] not in faulty] if 2 * len(worse) <= len(names) else []


def _with_su_nearby(along: MotionEstimate, u: int) -> Iterator[tuple[KinematicTree, State]]:
    """Robots with an SU on the joint before its own, the base before the first, or one behind."""
    tree, q = along.problem.tree, along.positions.mean(axis=0)
    joint = int(tree.su_joint[u])
    before = [int(tree.parent[joint])] if joint >= 0 else []
    for other in (*np.flatnonzero(tree.parent == joint).tolist(), *before):
        yield hung_on(tree, along.state, u, other, q)


def _with_branch_elsewhere(
    along: MotionEstimate, *, only_farther: bool = False
) -> Iterator[tuple[KinematicTree, State]]:
    """Robots with a branch behind more, or fewer, of the joints that gravity does not show.

    Slides and vertical joints turn gravity in no SU: that they carry a branch shows in
    accelerations alone, and of slow motion in little.
    """
    tree, q = along.problem.tree, along.positions.mean(axis=0)
    hidden = set(np.flatnonzero(hidden_from_gravity(along, q)[0]).tolist())
    for joint in range(tree.n_joints):
        here = int(tree.parent[joint])
        for parent in range(-1, tree.n_joints):
            chain = tree.chain(parent)
            others = set(chain) ^ set(tree.chain(here))
            if only_farther and not others <= set(chain):
                continue
            if parent != here and joint not in chain and others <= hidden:
                yield branched(tree, along.state, joint, parent, q)


def hidden_from_gravity(along: MotionEstimate, q: F64) -> tuple[Bool, F64]:
    """Joints that do not turn gravity, which slide or are vertical, and the axes of all.

    Args:
        along: the fit of all samples.
        q: (D,) positions of the joints.

    Returns:
        (D,) which they are, and (D, 3) unit vectors in the base's frame.
    """
    axes = joint_poses(along.state.model(along.problem.tree), q)[:-1, :3, 2]
    vertical = np.abs(axes @ along.state.up[0]) > np.cos(_VERTICAL)
    return np.asarray(along.problem.tree.prismatic | vertical), axes
