"""Joints that yield under torques that are known: one number for each joint, its compliance.

Where the masses, centres of mass and inertias pi of the links are known, as a vendor's URDF has
them, the torques ``tau = Y(q, q', q'') pi`` are (Pinocchio's inverse dynamics), and a joint of
stiffness K leaves its link at ``q = theta - tau / K``, where theta is the motor's position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse
from skin2urdf.estimation.trajectory.bending import SPINDLE, YIELD
from skin2urdf.estimation.trajectory.elastic import Elasticity, UnderKnown, followed
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.front_end import begin_front
from skin2urdf.estimation.trajectory.misfit import MOST_OF_IT, SPAN, misfit_of
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.yielding import NEARLY
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_BORNE = 1e-3
"""Least torque of a joint, over the largest, whose twist counts: of milliradians, microradians."""
_TURNS = 6
"""Turns of deflections by known torques and of motion, at most; each leaves a fifth to a tenth of
the error."""
LATE = 1e-2
"""Standard deviation of the time by which deflections under known torques are late [s]: that of a
resonance at 8 Hz, damped to a quarter of the critical."""
_SETTLED = 1e-2
"""Change of deflections in a turn, over the largest, at which the next one is the last: that one
leaves some 0.001 of deflections, which is micrometres."""
_NEGATIVE = 10.0
"""Deviations below zero at which a compliance is none: what torques lack in truth, as those of
cables and tools that a model leaves out, makes small ones wrong by several."""


def known_elasticity(
    tree: KinematicTree, logs: Sequence[Trajectory], state: State, gravity: float, inertials: F64
) -> Elasticity:
    """The deflections that known links make of the motion of the logs, as encoders have it.

    Args:
        tree: D joints.
        logs: trajectories.
        state: placements, and gravity's direction per log.
        gravity: its magnitude [m/s^2].
        inertials: (10 D,) of what each joint carries, in the order of Pinocchio's regressors and in
            the frames of the joints [kg, kg m, kg m^2].

    Returns:
        For every joint that bears something the deflection per radian (metre) of its rms, and the
        time by which it is late.
    """
    D = tree.n_joints
    every = np.arange(D, dtype=np.int64)
    alone = _of_joints(every, np.tile(inertials, (D, 1)), np.ones(D), logs)
    torque = followed(alone, tree, logs, state, gravity, np.zeros(2 * D))
    count = sum(len(log.q) for log in logs)
    square = np.sum([(d[:, :D] ** 2).sum(axis=0) for d in torque.motions], axis=0)
    size = np.sqrt(square / count)
    borne = np.flatnonzero(size > _BORNE * size.max(initial=0.0)).astype(np.int64)
    scaled = inertials / size[borne, None]
    nothing = np.zeros(2 * len(borne))
    bearing = _of_joints(borne, scaled, size[borne], logs)
    return followed(bearing, tree, logs, state, gravity, nothing)


def _of_joints(joints: Int, basis: F64, size: F64, logs: Sequence[Trajectory]) -> Elasticity:
    """Deflections of some joints by given parameters, and their damping, along no motion yet."""
    n = len(basis)
    both = np.tile(joints, 2)
    damping = np.arange(2 * n) >= n
    directions = np.concatenate([basis, np.zeros_like(basis)])
    motions = tuple(np.zeros((len(log.q), 2 * n)) for log in logs)
    return Elasticity(both, motions, damping, np.tile(size, 2), directions)


def with_known_torque(
    problem: MotionProblem, fitted: Fitted
) -> tuple[MotionProblem, Fitted] | None:
    """The fit with joints that yield under torques that are known; None where they are not.

    Args:
        problem: the rigid robot.
        fitted: its fit.
    """
    blueprint, state = problem.priors.blueprint, fitted.state
    if blueprint is None or blueprint.inertials is None:
        return None
    elastic = known_elasticity(
        problem.tree, problem.logs, state.placements, state.gravity, blueprint.inertials
    )
    fresh = replace(fitted, state=with_fresh_sensors(problem, state))
    return _with_elastic_joints(problem, fresh, elastic)


def with_fresh_sensors(problem: MotionProblem, state: MotionState) -> MotionState:
    """A state with sensors as they are before anything is known of them.

    They have taken up of deflections what they could, and would hold these back.
    """
    places = state.placements
    return replace(
        state,
        placements=replace(
            places, bias=np.zeros_like(places.bias), shape=np.zeros_like(places.shape)
        ),
        front=np.tile(begin_front(problem.priors.front), (len(state.front), 1)),
    )


def yields(problem: MotionProblem, fitted: Fitted, *, in_either_sense: bool = False) -> bool:
    """Whether all compliances under known torques are such as springs have: not below zero.

    Args:
        problem: with nothing but these in what encoders do not see.
        fitted: its fit.
        in_either_sense: whether all may be below zero instead, as of torques that are told as those
            of the load, not of the drive.
    """
    elastic, at = problem.unseen, problem.layout.unseen
    if not isinstance(elastic, UnderKnown):
        return False
    system = eliminated(fitted.equations, problem.free_joint, problem.free_su)
    variance = np.diag(joint_inverse(system.schur, problem.free_joint))[at]
    spring = ~elastic.damping
    x, beyond = fitted.state.unseen[spring], _NEGATIVE * np.sqrt(variance[spring].clip(min=0.0))
    return bool((x > -beyond).all() or (in_either_sense and (x < beyond).all()))


def prior_spread(tree: KinematicTree, elastic: UnderKnown) -> F64:
    """(S,) standard deviations of deflections under the size of their torques [rad or m]."""
    return np.asarray(YIELD * np.where(tree.prismatic, SPINDLE, 1.0)[elastic.joint])


def _with_elastic_joints(
    problem: MotionProblem, fitted: Fitted, elastic: Elasticity
) -> tuple[MotionProblem, Fitted]:
    """The fit with joints that yield under torques that are known.

    Torques go with the motion of the links, which is known once the deflections are: both are found
    in turns.
    """
    tree, logs, state = problem.tree, problem.logs, fitted.state
    spread = prior_spread(tree, elastic)
    spread[elastic.damping] = LATE
    priors = replace(problem.priors, unseen=spread)
    state = replace(state, unseen=np.zeros(len(spread)))
    n_knots = problem.layout.n_knots
    yielding = MotionProblem(tree, logs, priors, n_knots, elastic)
    rigid = misfit_of(problem, fitted, SPAN)
    for turn in range(_TURNS):
        before = yielding.deflections(state)
        fitted = fit(yielding, state, tolerance=NEARLY, far=turn == 0)
        state = fitted.state
        if turn == 0 and misfit_of(yielding, fitted, SPAN) > MOST_OF_IT * rigid:
            return yielding, fitted
        change = _change(before, yielding.deflections(state))
        for _ in range(2):
            x = state.unseen
            elastic = followed(elastic, tree, logs, state.placements, state.gravity, x)
        yielding = MotionProblem(tree, logs, priors, n_knots, elastic)
        if change < _SETTLED:
            break
    return yielding, fit(yielding, state)


def _change(before: Sequence[F64], after: Sequence[F64]) -> float:
    """Largest change of deflections, over the largest deflection."""
    largest = max(float(np.abs(a).max(initial=0.0)) for a in after)
    moved = max(float(np.abs(a - b).max(initial=0.0)) for a, b in zip(after, before, strict=True))
    return moved / largest if largest > 0 else 0.0
