"""In which order joints follow each other that no SU sits between.

Where each of two such joints moved while the other stayed in one place, as in a log that moves one
joint after the other, both orders explain the readings: SUs are elsewhere only where both have
moved. Which one was taken is chance, and the URDF may be wrong by decimetres.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from skin2urdf.calibration.at_rest import fit_rigid, is_likelier
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.rounds import Solution
from skin2urdf.estimation.problem.reordered import apart, elsewhere, reordered
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.solve.estimate import estimate
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.slack import CERTAIN
from skin2urdf.notes import Note
from skin2urdf.structure.ordering import bare_neighbours
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.tree_notes import doubt

_ALIKE = 0.02
"""How differently two orders may carry SUs along a log that may not tell them apart, rms [rad, m]:
gravity that turns by so much more is some ten times what gears and sensors make of it."""
_HARMLESS = 1e-4
"""By how much SUs may be elsewhere for the order of joints not to matter, rms [m]: those that slide
or turn along one direction may as well follow each other the other way round."""
_COMPARED = 400
"""Positions, at most, that two orders are compared at."""


def in_told_order(solution: Solution, along: MotionEstimate, clock: Clock) -> Solution:
    """The robot with joints in the order that all samples find likeliest, and notes on the others.

    Args:
        solution: the robot.
        along: what all samples say of it.
        clock: runs the stages.
    """
    if not _that_may_be(along):
        return solution
    best, rigid = solution, fit_rigid(solution, clock)
    seen = {along.problem.tree.joint_names}
    tried: list[Note] = []
    notes: list[Note] = []
    while rigid is not None:
        notes, before = [], best
        for other_tree, other_state in _that_may_be(rigid):
            other = solved_anew(best, other_tree, other_state, clock)
            there = fit_rigid(other, clock)
            if there is None:
                continue
            doubtful = doubt(rigid.problem.tree, other_tree)
            tried.append(doubtful)
            # What no rigid robot explains tells orders apart by chance.
            certain = CERTAIN * max(1.0, rigid.misfit, there.misfit)
            if other_tree.joint_names not in seen and is_likelier(rigid, there, certain):
                best, rigid = other, there
                seen.add(other_tree.joint_names)
                break
            if not is_likelier(there, rigid, certain):
                robot = rigid.problem.tree, rigid.state
                size = elsewhere(robot, (other_tree, other_state), rigid.positions_of_joints)
                notes += [replace(doubtful, size=size)] * (size > _HARMLESS)
        if best is before:
            break
    return _noted(best, notes, tried)


def _that_may_be(along: MotionEstimate) -> list[tuple[KinematicTree, State]]:
    """A fitted robot with neighbours in the other order, where SUs move nearly as in the logs."""
    tree, q = along.problem.tree, along.positions
    weights = np.concatenate([log.qd[log.kept] for log in along.problem.logs]) ** 2
    few = slice(None, None, max(1, len(q) // _COMPARED))
    compared = {name: own[few] for name, own in along.positions_of_joints.items()}
    others = [
        reordered(tree, along.state, j, q, weights)
        for j in bare_neighbours(tree.parent, tree.su_joint)
    ]
    robot = tree, along.state
    return [other for other in others if max(apart(robot, other, compared)) < _ALIKE]


def solved_anew(solution: Solution, tree: KinematicTree, state: State, clock: Clock) -> Solution:
    """The solution of the same features with another tree, from where it is known to be."""
    settings = solution.logs.settings.estimation
    found = clock.run(
        "estimation",
        lambda tell: estimate(solution.features, tree, settings, state, search=False, tell=tell),
    )
    return replace(solution, found=found)


def _noted(solution: Solution, notes: list[Note], tried: Collection[Note]) -> Solution:
    """A solution with notes on the orders of its joints.

    Those on what was tried, and on another order than the one that was taken, go.
    """
    tree = solution.found.tree
    known, chains = {(note.joints, note.instead) for note in tried}, tree.chains().values()
    before = [
        note
        for note in tree.notes
        if note.kind != "other order"
        or ((note.joints, note.instead) not in known and list(note.joints) in chains)
    ]
    tree = replace(tree, notes=(*before, *notes))
    return replace(solution, found=replace(solution.found, tree=tree))
