"""On which joint an SU sits whose readings the rest of the robot does not explain.

What a first look at the structure says of a single SU rests on little where its joint hardly moves
it, or sensor and gears are poor. All samples say more: where they leave far more of an SU than of
the others, it is tried a joint nearer to the base, and one farther.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from skin2urdf.calibration.at_rest import fit_rigid, is_likelier
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.orders import solved_anew
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.calibration.rounds import Solution
from skin2urdf.estimation.problem.reordered import hung_on
from skin2urdf.estimation.trajectory.attempt import CERTAIN
from skin2urdf.estimation.trajectory.estimate import MotionEstimate
from skin2urdf.estimation.trajectory.misfit import MOST_OF_IT


def in_told_place(solution: Solution, along: MotionEstimate, clock: Clock) -> Solution:
    """The robot with SUs where all samples find them, of those that fit far worse than most.

    Args:
        solution: the robot.
        along: what all samples say of it.
        clock: runs the stages.
    """
    found, rigid = solution, None
    for u in _that_fit_worse(solution, along):
        rigid = rigid or fit_rigid(found, clock)
        if rigid is None:
            break
        for joint in _nearby(rigid, u):
            tree, state = hung_on(
                rigid.problem.tree, rigid.state, u, joint, rigid.positions.mean(axis=0)
            )
            other = solved_anew(found, tree, state, clock)
            there = fit_rigid(other, clock)
            if there is None:
                continue
            left, now = (each.misfit_of_sus[u] - 1 for each in (there, rigid))
            certain = CERTAIN * max(1.0, rigid.misfit, there.misfit)
            if left < MOST_OF_IT * now and is_likelier(rigid, there, certain):
                found, rigid = other, there
                break
    return found


def _that_fit_worse(solution: Solution, along: MotionEstimate) -> Iterator[int]:
    """SUs without a fault of which more than noise is left, where most leave no more."""
    names, tree = along.problem.tree.su_names, solution.found.tree
    worse = np.flatnonzero(along.misfit_of_sus > GOOD_FIT).tolist()
    faulty = {fault.subject for fault in solution.faults}
    if 2 * len(worse) <= len(names) and names == tree.su_names:
        yield from (u for u in worse if names[u] not in faulty)


def _nearby(along: MotionEstimate, u: int) -> list[int]:
    """The joint before that of an SU, -1 for the base, and those behind it."""
    tree = along.problem.tree
    joint = int(tree.su_joint[u])
    before = [int(tree.parent[joint])] if joint >= 0 else []
    return [*np.flatnonzero(tree.parent == joint).tolist(), *before]
