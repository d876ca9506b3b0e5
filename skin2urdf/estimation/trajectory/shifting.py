"""A base that shifts under the forces of its robot, as on feet or tyres, as well as it turns.

Most bases turn by far more than they shift. So one that turns is fitted first, and it is asked to
first order what shifts by the same loads would explain; where that is certain, both are followed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.balance import Balance, balanced, unsettled
from skin2urdf.estimation.trajectory.bending import Bending, bends_of
from skin2urdf.estimation.trajectory.fit import Fitted, Follow, cost_with, fit_following
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.skeleton import N_HINGES
from skin2urdf.estimation.trajectory.slack import CERTAIN, Size, size_of
from skin2urdf.estimation.trajectory.unseen import Unseen

_LEAST = 0.1
"""Compliance along an axis of the base over its largest, with which a fit begins at least."""


def with_shifts(
    problem: MotionProblem, fitted: Fitted, follow: Follow, *, steps: int, tolerance: float
) -> tuple[MotionProblem, Fitted]:
    """The fit with a base that shifts as well, where the readings show it for certain.

    Args:
        problem: of a base that turns under its loads.
        fitted: its fit.
        follow: makes the problem about another state.
        steps: at most that many.
        tolerance: length of the last one in standard deviations.
    """
    bends = bends_of(problem.unseen)
    if bends is None or not (bends.base and bends.holds):
        return problem, fitted
    state, tree = fitted.state, problem.tree
    there = balanced(
        bends, tree, problem.logs, state.placements, state.gravity, state.unseen[: bends.n_numbers]
    )
    found = _shifts(problem, fitted, there)
    if not found.gain > CERTAIN:
        return problem, fitted
    shifting, x = that_shifts(there, found.numbers / _changes(there))
    spread = np.array(shifting.spread)
    P = len(bends.basis)
    spread[:P] = problem.priors.unseen[:P]
    about = MotionProblem(
        tree,
        problem.logs,
        replace(problem.priors, unseen=spread),
        problem.layout.n_knots,
        unsettled(shifting, problem.logs),
    )
    led = follow(about, replace(state, unseen=x))
    if led is None:
        return problem, fitted
    more, moved = fit_following(
        led.whole(), led.state, follow, iterations=steps, tolerance=tolerance
    )
    keeps = cost_with(fitted.weights, fitted.shaken, moved) < fitted.chi2
    return (more, moved) if keeps else (problem, fitted)


def _shifts(problem: MotionProblem, fitted: Fitted, there: Balance) -> Size:
    """What shifts along the base's axes by the forces on it would explain.

    Numbers are the root mean square of each [m].

    Args:
        problem: of a base that turns.
        fitted: its fit.
        there: its deflections, in balance with their loads.
    """
    n_joints, size = problem.tree.n_joints, _changes(there)
    forces = tuple(-each / size for each in there.forces)
    none = tuple(np.zeros((len(log.q), n_joints + N_HINGES)) for log in problem.logs)
    hinges, every = n_joints + np.arange(3), there.deflections.every
    return size_of(problem, fitted, Unseen(hinges, forces, every=every, settled=none))


def _changes(there: Balance) -> float:
    """Root mean square of the forces on a base about their means, all axes together."""
    about = [each - each.mean(axis=0) for each in there.forces]
    return max(float(np.sqrt(np.mean(np.concatenate(about) ** 2))), 1e-300)


def that_shifts(there: Balance, compliance: F64) -> tuple[Bending, F64]:
    """The deflections of a base that shifts as well, and their numbers.

    Args:
        there: those of one that turns, in balance.
        compliance: (3,) by how much it shifts along its axes.
    """
    turning, first = there.deflections, there.deflections.of_base.start
    shifts = turning.parts[first] - 3 + np.arange(3)
    parts = np.insert(turning.parts, first, shifts)
    others = np.delete(np.arange(len(parts)), first + np.arange(3))
    C = np.zeros((len(parts), len(parts)))
    C[np.ix_(others, others)] = turning.compliance
    # None yields against its load.
    C[first + np.arange(3), first + np.arange(3)] = np.maximum(
        compliance, _LEAST * np.abs(compliance).max()
    )
    shifting = replace(turning, parts=parts, compliance=C, origin=np.zeros(0))
    x, P = np.zeros(shifting.n_numbers), len(turning.basis)
    x[:P], x[-3:] = there.x[:P], there.x[-3:]
    x[shifting.of_crosses.start :][:3] = there.x[turning.of_crosses]
    x[shifting.of_dampers][others] = there.x[turning.of_dampers]
    x[shifting.of_inertia.start :][:6] = there.x[turning.of_inertia]
    return shifting, x
