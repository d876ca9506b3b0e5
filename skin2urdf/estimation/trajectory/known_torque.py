"""Joints that yield under torques that are known: a fit with two numbers for each joint.

How much a joint yields to its torque is one, and how much later it does the other, which is told
to first order about what is known of it, and then once more. What springs bear is known where the
log holds it (:mod:`measured_torque`), or where a vendor's URDF has masses, centres of mass and
inertias of the links: torques are those of Pinocchio's inverse dynamics along the motion that links
make, which is known once deflections are. Both are found in turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse
from skin2urdf.estimation.trajectory.bending import SPINDLE, YIELD
from skin2urdf.estimation.trajectory.elastic import UnderKnown
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.front_end import begin_front
from skin2urdf.estimation.trajectory.misfit import MOST_OF_IT, SPAN, misfit_of
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import fit_with_products
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.torques import bodies, loads_of
from skin2urdf.signals.filters import first_derivative
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_BORNE = 1e-3
"""Least torque of a joint, over the largest, whose twist counts: of milliradians, microradians."""
_OF_LINKS = 6
"""Turns of torques of known links and of the motion that they make, at most; each leaves a fifth to
a tenth of the error."""
_STEPS = 30
"""Linearisations of a fit at most; it takes 3 to 8."""
_TURNS = 3
"""How often a fit begins anew about how late deflections are: each leaves a tenth of what is off to
second order, (w T)^2 of a deflection that is late by T at w."""
_ON_TIME = 2e-4
"""By how much deflections may still be late [s], as parts of the largest: at 4 Hz what that leaves
to second order is 3e-5 of them."""
_NOTHING = 1e-2
"""Deflection of a joint, over the largest, that tells nothing of how late it is."""
_LATE = 1e-2
"""Standard deviation of the time by which deflections under known torques are late [s]: that of a
resonance at 8 Hz, damped to a quarter of the critical."""
_SETTLED = 1e-3
"""Change of torques in a turn, over their rms, at which deflections are known: what that changes is
micrometres."""
_NEGATIVE = 10.0
"""Deviations below zero at which a compliance is none: what torques lack in truth, as those of
cables and tools that a model leaves out, makes small ones wrong by several."""


def with_known_torque(
    problem: MotionProblem, fitted: Fitted
) -> tuple[MotionProblem, Fitted] | None:
    """The fit with joints that yield under the loads of known links; None where they are not.

    Args:
        problem: the rigid robot.
        fitted: its fit.
    """
    blueprint = problem.priors.blueprint
    if blueprint is None or blueprint.inertials is None:
        return None
    torques = _of_links(fitted, blueprint.inertials)
    size = np.sqrt(np.mean(np.concatenate(torques) ** 2, axis=0))
    joints = np.flatnonzero(size > _BORNE * size.max(initial=0.0)).astype(np.int64)
    if not len(joints):
        return None
    start, late = with_fresh_sensors(problem, fitted.state), np.zeros(len(joints))
    promised = MOST_OF_IT * misfit_of(problem, fitted, SPAN)
    for _ in range(_OF_LINKS):
        own = [tau[:, joints] for tau in torques]
        under = fit_under(problem, start, joints, own, late)
        fitted, start, late = under.fitted, under.fitted.state, under.late
        if misfit_of(fitted.problem, fitted, SPAN) > promised:
            break
        before, torques = torques, _of_links(fitted, blueprint.inertials)
        off = np.concatenate([a - b for a, b in zip(torques, before, strict=True)])[:, joints]
        if np.sqrt(np.mean(off**2, axis=0)).max() < _SETTLED * size.max():
            break
    return fitted.problem, fitted


def _of_links(fitted: Fitted, inertials: F64) -> list[F64]:
    """Per log (N, D) torques of known links along the motion of a fit [N m or N]."""
    problem, state, links = fitted.problem, fitted.state, bodies(inertials)
    out = []
    for g, log in enumerate(problem.logs):
        moved = problem.moved(state, g)
        tau = loads_of(problem.tree, state.placements, g, state.gravity, moved, links, base=False)
        # Above the low-pass, accelerations are noise, and more so with every differentiation.
        out.append(log.smooth(tau))
    return out


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


@dataclass(frozen=True, eq=False)
class Under:
    """A fit with joints that yield under given torques.

    Attributes:
        fitted: the fit.
        late: (J,) by how much deflections are later than torques [s].
    """

    fitted: Fitted
    late: F64


def fit_under(
    problem: MotionProblem, start: MotionState, joints: Int, torques: Sequence[F64], late: F64
) -> Under:
    """The fit with joints that yield under given torques.

    Args:
        problem: the rigid robot.
        start: where to begin.
        joints: (J,) which joints.
        torques: per log (N, J) [N m or N], low-passed.
        late: (J,) by how much deflections are late, to begin with [s].
    """
    far, state = len(start.unseen) == 0, start
    for _ in range(_TURNS):
        there = [_later(log, tau, late) for log, tau in zip(problem.logs, torques, strict=True)]
        elastic = _deflections(problem.logs, joints, there)
        spread = _spread(problem.tree, elastic)
        spread[elastic.damping] *= _LATE
        priors = replace(problem.priors, unseen=spread)
        n_knots = problem.layout.n_knots
        yielding = MotionProblem(problem.tree, problem.logs, priors, n_knots, elastic)
        known = np.zeros(len(spread)) if far else state.unseen
        state = replace(state, unseen=np.where(elastic.damping, 0.0, known))
        fitted = fit(yielding, state, far=far, near=not far)
        _, fitted = fit_with_products(yielding, fitted, _STEPS)
        far, state, (bent, by_late) = False, fitted.state, fitted.state.unseen.reshape(2, -1)
        # What bears next to nothing tells no time.
        largest = np.abs(bent).max()
        late = late + by_late * bent / (bent**2 + (_NOTHING * largest) ** 2)
        if np.abs(by_late).max() < _ON_TIME * largest:
            break
    return Under(fitted, late)


def _later(log: Trajectory, torque: F64, late: F64) -> F64:
    """(N, J) torques behind a pole of each joint, or before one where times (J,) are negative."""
    if not late.any():
        return torque
    pad = len(log.taps)
    padded = np.pad(torque, ((pad, pad), (0, 0)), mode="edge")
    s = 2j * np.pi * np.fft.rfftfreq(len(padded), 1 / log.rate)[:, None]
    gain = np.where(late > 0, 1 / (1 + s * late.clip(min=0.0)), 1 - s * late)
    return np.fft.irfft(gain * np.fft.rfft(padded, axis=0), len(padded), axis=0)[pad:-pad]


def springs_under(joints: Int, torques: Sequence[F64]) -> UnderKnown:
    """The deflections that torques make at once, per radian (metre) under the rms of each.

    Args:
        joints: (J,) which joints.
        torques: per log (N, J) [N m or N], low-passed.
    """
    size = np.sqrt(np.mean(np.concatenate(torques) ** 2, axis=0))
    size = np.where(size > 0, size, 1.0)
    at_once = np.zeros(len(joints), dtype=bool)
    motions = tuple(-torque / size for torque in torques)
    return UnderKnown(joints, motions, damping=at_once, size=size)


def _deflections(logs: Sequence[Trajectory], joints: Int, torques: Sequence[F64]) -> UnderKnown:
    """The same, and by how much the deflection of each joint is late."""
    springs = springs_under(joints, torques)
    motions = tuple(
        np.hstack([bent, -first_derivative(bent, log.rate)])
        for log, bent in zip(logs, springs.motions, strict=True)
    )
    damping = np.arange(2 * len(joints)) >= len(joints)
    return UnderKnown(np.tile(joints, 2), motions, damping=damping, size=np.tile(springs.size, 2))


def _spread(tree: KinematicTree, elastic: UnderKnown) -> F64:
    """(S,) standard deviations of deflections under the size of their torques [rad or m]."""
    return np.asarray(YIELD * np.where(tree.prismatic, SPINDLE, 1.0)[elastic.joint])
