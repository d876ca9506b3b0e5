"""Joints that yield under torques that the log holds: JointState.effort.

A joint of stiffness K leaves its link at ``q = theta - tau / K``, where theta is the motor's
position. Where tau was measured, the deflection is linear in 1 / K, whatever the links are and
however near to a resonance they swing. A damper in the gear, or an effort that was filtered, is
late by some time, which to first order is one more number, ``e = -tau / K + b tau'``.

Efforts hold more than that torque. Sensors are noisy, and a deflection's noise is differentiated
twice like an encoder's; those that are made of motor currents hold the friction of the gear, which
no spring bears. Links that are stiff and weigh what they weigh tell the two apart: efforts are
linear in masses and moments along a motion that is known (Atkeson, An and Hollerbach 1986), and
what is left of them is noise and friction. So the torques of such links take the place of the
efforts, as a second fit, and the likelier of the two stays: cables and tools load joints as no
links do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.elastic import UnderKnown
from skin2urdf.estimation.trajectory.fit import Fitted, cost_with, fit
from skin2urdf.estimation.trajectory.known_torque import LATE, prior_spread, with_fresh_sensors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import fit_with_products
from skin2urdf.estimation.trajectory.shaken import Shaken
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.torques import bodies, inertial_sizes, loads_of, regressors
from skin2urdf.signals.filters import filtered, first_derivative
from skin2urdf.signals.trajectory import Trajectory

_STEPS = 30
"""Linearisations of a fit at most; it takes 3 to 8."""
_SLIDES = 0.02
"""Speed at which friction has nearly its full size [rad/s or m/s]: gears change from sticking to
sliding at some hundredths of a radian per second."""
_SHOWS = 1e-9
"""Least share of the largest eigenvalue that masses and moments are told along a direction from:
less than a ten-thousandth of the largest torque is no torque that shows."""
N_OWN = 3
"""Numbers of each effort beside masses and moments: an offset, and friction of two kinds."""


def with_measured_torque(
    problem: MotionProblem, fitted: Fitted
) -> tuple[MotionProblem, Fitted] | None:
    """The fit with joints that yield under torques that were measured; None where none were.

    Args:
        problem: the rigid robot.
        fitted: its fit.
    """
    joints = _measured(problem.logs)
    if not len(joints):
        return None
    efforts = [log.effort[:, joints] for log in problem.logs]
    _, beside = _of_links(problem, fitted, joints)
    torques = [tau - each for tau, each in zip(efforts, beside, strict=True)]
    fresh = with_fresh_sensors(problem, fitted.state)
    first = _fit_under(problem, fresh, joints, torques, far=True)
    # Along the motion that links really make, both are known better.
    loads, beside = _of_links(*first, joints)
    torques = [tau - each for tau, each in zip(efforts, beside, strict=True)]
    state = first[1].state
    further = [_fit_under(problem, state, joints, each, far=False) for each in (torques, loads)]
    return min(first, *further, key=lambda each: _cost(each[1], first[1]))


def _measured(logs: Sequence[Trajectory]) -> Int:
    """Joints whose torque all logs hold, and that changes."""
    if not all(len(log.effort) for log in logs):
        return np.zeros(0, dtype=np.int64)
    effort = np.concatenate([log.effort for log in logs])
    there = np.isfinite(effort).all(axis=0)
    return np.flatnonzero(there & (np.ptp(np.where(there, effort, 0.0), axis=0) > 0))


def _fit_under(
    problem: MotionProblem, state: MotionState, joints: Int, torques: Sequence[F64], *, far: bool
) -> tuple[MotionProblem, Fitted]:
    """The fit with joints that yield under given torques.

    Args:
        problem: the rigid robot.
        state: where to begin.
        joints: (J,) which joints.
        torques: per log (N, J) [N m or N], low-passed.
        far: whether nothing of the deflections is known yet.
    """
    elastic = _under(problem.logs, joints, torques)
    spread = prior_spread(problem.tree, elastic)
    spread[elastic.damping] *= LATE
    priors = replace(problem.priors, unseen=spread)
    yielding = MotionProblem(problem.tree, problem.logs, priors, problem.layout.n_knots, elastic)
    if len(state.unseen) != len(spread):
        state = replace(state, unseen=np.zeros(len(spread)))
    return fit_with_products(yielding, fit(yielding, state, far=far, near=not far), _STEPS)


def _under(logs: Sequence[Trajectory], joints: Int, torques: Sequence[F64]) -> UnderKnown:
    """The deflections that torques make, per radian (metre) under the rms of each.

    For every joint there are its deflection, and by how much that is late.
    """
    size = np.sqrt(np.mean(np.concatenate(torques) ** 2, axis=0))
    size = np.where(size > 0, size, 1.0)
    motions = tuple(
        np.hstack([-torque / size, first_derivative(torque / size, log.rate)])
        for log, torque in zip(logs, torques, strict=True)
    )
    damping = np.arange(2 * len(joints)) >= len(joints)
    return UnderKnown(np.tile(joints, 2), motions, damping=damping, size=np.tile(size, 2))


def _friction(log: Trajectory, joints: Int) -> F64:
    """(N, J, 3) an offset, torque of friction of one size, and such as goes with the speed."""
    speed = log.qd[:, joints]
    rubs = filtered(np.tanh(speed / _SLIDES), log.taps)
    return np.stack([np.ones(speed.shape), rubs, speed], axis=2)


def _of_links(problem: MotionProblem, fitted: Fitted, joints: Int) -> tuple[list[F64], list[F64]]:
    """Torques of stiff links along a motion, as heavy as efforts tell, and what is beside them.

    Args:
        problem: joints, which may yield.
        fitted: its fit, with the motion of the links.
        joints: (J,) whose efforts are known.

    Returns:
        Per log (N, J) of these, and of the friction and offset of each effort [N m or N].
    """
    tree, state = problem.tree, fitted.state
    J, size = len(joints), inertial_sizes(state.placements)
    n, own = len(size), len(size) + N_OWN * np.arange(J)[:, None] + np.arange(N_OWN)
    H, b, share = np.zeros((J, own.max() + 1, own.max() + 1)), np.zeros((J, own.max() + 1)), 0.0
    moved = [problem.moved(state, g) for g in range(len(problem.logs))]
    rubs = [_friction(log, joints) for log in problem.logs]
    for g, (log, links) in enumerate(zip(problem.logs, moved, strict=True)):
        effort = log.effort[np.ix_(log.kept, joints)]
        few = replace(links, **{key: getattr(links, key)[log.kept] for key in ("q", "qd", "qdd")})
        for Y, at in regressors(tree, state.placements, g, state.gravity, few):
            rows = np.zeros((J, len(Y), H.shape[1]))
            rows[:, :, :n] = (Y[:, joints] * size).swapaxes(0, 1)
            for j in range(J):
                rows[j, :, own[j]] = rubs[g][log.kept[at], j].T
            H += rows.swapaxes(1, 2) @ rows
            b += np.einsum("jkn,kj->jn", rows, effort[at])
        share = share + (effort**2).sum(axis=0)
    # Each joint counts by what its own efforts leave of noise.
    weights = 1 / share
    for _ in range(2):
        x = _least_squares(np.einsum("j,jnm->nm", weights, H), weights @ b)
        left = share - 2 * b @ x + np.einsum("n,jnm,m->j", x, H, x)
        weights = 1 / np.maximum(left, _SHOWS * share)
    of_links, loads, others = bodies(size * x[:n]), [], []
    for g, (log, links) in enumerate(zip(problem.logs, moved, strict=True)):
        tau = loads_of(tree, state.placements, g, state.gravity, links, of_links, base=False)
        beside = np.einsum("njk,jk->nj", rubs[g], x[own])
        # Before and behind what is compared, differences lack samples.
        inside = slice(log.kept[0], log.kept[-1] + 1)
        whole = log.effort[:, joints] - beside
        whole[inside] = tau[inside][:, joints]
        loads.append(log.smooth(whole))
        others.append(beside)
    return loads, others


def _least_squares(H: F64, b: F64) -> F64:
    """The shortest solution of normal equations, along directions that show."""
    scale = 1 / np.sqrt(np.diag(H).clip(min=1e-300))
    lam, V = np.linalg.eigh(H * scale[:, None] * scale)
    shows = lam > _SHOWS * lam[-1]
    return np.asarray(scale * (V[:, shows] @ ((V[:, shows].T @ (scale * b)) / lam[shows])))


def _cost(fitted: Fitted, weighed: Fitted) -> float:
    """Chi-squared of a fit with the weights of another."""
    about = weighed.problem
    shaken = Shaken.of(about.tree, about.logs, weighed.state, weighed.weights)
    return cost_with(weighed.weights, shaken, fitted)
