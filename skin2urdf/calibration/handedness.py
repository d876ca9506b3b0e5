"""SUs that turn out to be mirror images once all samples are looked at.

Gravity shows an SU's handedness where joints turn it about several axes. Beyond a single horizontal
one, whatever vertical ones carry that, gravity stays in a plane, and a mirror image of the SU reads
it as well: what tells are accelerations.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from skin2urdf.calibration.at_rest import fit_rigid, is_likelier, solved_at_rest
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.places import hidden_from_gravity, that_fit_worse
from skin2urdf.calibration.result import GOOD_FIT, unexplained_sus
from skin2urdf.calibration.rounds import Solution
from skin2urdf.calibration.samples import fit_samples
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.faults import Fault
from skin2urdf.geometry.se3 import screw
from skin2urdf.hypotheses.alone import negated

_PARALLEL = np.cos(np.deg2rad(3.0))
"""Cosine of the angle between two axes up to which gravity stays near a plane about both: sensors'
errors hide as much."""


def with_handedness(
    solution: Solution, along: MotionEstimate, clock: Clock
) -> tuple[Solution, MotionEstimate]:
    """The robot with SUs negated that all samples find to be left-handed, or negated.

    Args:
        solution: the robot, of logs without patterns.
        along: what all samples say of it.
        clock: runs the stages.
    """
    if along.problem.tree.su_names != solution.found.tree.su_names:
        return solution, along
    names = along.problem.tree.su_names
    unexplained = [names.index(su) for su in unexplained_sus(along, solution.faults)]
    doubtful = {*that_fit_worse(solution, along), *unexplained}
    planar = [u for u in sorted(doubtful) if _sees_a_plane(along, u)]
    if not planar or 2 * len(doubtful) > len(names):
        # What is wrong with most of them is no sensor.
        return solution, along
    rigid = fit_rigid(solution, clock)
    for u in planar:
        other = _with_one_mirrored(solution, along, u, clock)
        stiff = fit_rigid(other, clock)
        if rigid is None or stiff is None or not is_likelier(rigid, stiff):
            continue
        there = clock.run("all samples", partial(fit_samples, other))
        if there is None or not is_likelier(along, there):
            continue
        if not (there.misfit_of_sus[u] > GOOD_FIT or there.unexplained[u]):
            solution, along, rigid = other, there, stiff
    return solution, along


def _sees_a_plane(along: MotionEstimate, u: int) -> bool:
    """Whether gravity stays in a plane as an SU sees it, all that turns it being parallel."""
    tree, q = along.problem.tree, along.positions.mean(axis=0)
    hidden, axes = hidden_from_gravity(along, q)
    turning = [j for j in tree.chain(int(tree.su_joint[u])) if not hidden[j]]
    return bool(turning) and bool((np.abs(axes[turning] @ axes[turning[0]]) > _PARALLEL).all())


def _with_one_mirrored(solution: Solution, along: MotionEstimate, u: int, clock: Clock) -> Solution:
    """The robot with an SU negated, and turned half round where gravity then is."""
    tree, state = along.problem.tree, along.state
    name = tree.su_names[u]
    T_joint_su, bias, shape = state.T_joint_su.copy(), state.bias.copy(), state.shape.copy()
    T_joint_su[u] = screw("z", np.pi, 0.0) @ T_joint_su[u]
    bias[u], shape[u] = 0.0, 0.0
    turned = replace(state, T_joint_su=T_joint_su, bias=bias, shape=shape)
    logs = negated(solution.logs, [name])
    other = solved_at_rest(logs, solution.seen, tree, turned, clock)
    return replace(other, faults=(*solution.faults, Fault("mirrored", name)))
