"""Joints that yield under torques that the log holds: JointState.effort.

A joint of stiffness K leaves its link at ``q = theta - tau / K``, where theta is the motor's
position. Where tau was measured, the deflection is linear in 1 / K, whatever the links are and
however near to a resonance they swing. A damper d beside the spring makes it late by a pole,
``e + (d / K) e' = -tau / K``, and an effort that was filtered makes it early; one more number per
joint tells to first order by how much it is later, and about that it is told once more.

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
from dataclasses import dataclass, replace

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
_TURNS = 3
"""How often a fit begins anew about how late deflections are: each leaves a tenth of what is off to
second order, (w T)^2 of a deflection that is late by T at w."""
_ON_TIME = 2e-4
"""By how much deflections may still be late [s], as parts of the largest: at 4 Hz what that leaves
to second order is 3e-5 of them."""
_MOST = 4
"""Turns of torques and of the motion that they make, at most: one leaves a tenth of what is off,
and a third where half of the efforts is friction."""
_SHARE = 0.01
"""Share of chi-squared that a turn takes off at least if another one is worth it."""
_NOTHING = 1e-2
"""Deflection of a joint, over the largest, that tells nothing of how late it is."""
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
    fresh = with_fresh_sensors(problem, fitted.state)

    def along(last: Fitted) -> tuple[list[F64], list[F64]]:
        loads, beside = _of_links(last, joints)
        return [tau - each for tau, each in zip(efforts, beside, strict=True)], loads

    best = first = _fit_under(problem, fresh, joints, along(fitted)[0], np.zeros(len(joints)))
    least, kinds = _cost(first, first), [0, 1]
    for _ in range(_MOST):
        # Along the motion that links really make, both are known better.
        torques, start = along(best.fitted), best.fitted.state
        further = [_fit_under(problem, start, joints, torques[kind], best.late) for kind in kinds]
        costs = [_cost(each, first) for each in further]
        winner = int(np.argmin(costs))
        if not costs[winner] < least:
            break
        fell, best, least = least - costs[winner], further[winner], costs[winner]
        kinds = [kinds[winner]]
        if fell < _SHARE * least:
            break
    return best.fitted.problem, best.fitted


def _measured(logs: Sequence[Trajectory]) -> Int:
    """Joints whose torque all logs hold, and that changes."""
    if not all(len(log.effort) for log in logs):
        return np.zeros(0, dtype=np.int64)
    effort = np.concatenate([log.effort for log in logs])
    there = np.isfinite(effort).all(axis=0)
    return np.flatnonzero(there & (np.ptp(np.where(there, effort, 0.0), axis=0) > 0))


@dataclass(frozen=True, eq=False)
class _Under:
    """A fit with joints that yield under given torques.

    Attributes:
        fitted: the fit.
        late: (J,) by how much deflections are later than torques [s].
    """

    fitted: Fitted
    late: F64


def _fit_under(
    problem: MotionProblem, start: MotionState, joints: Int, torques: Sequence[F64], late: F64
) -> _Under:
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
        elastic = _under(problem.logs, joints, there)
        spread = prior_spread(problem.tree, elastic)
        spread[elastic.damping] *= LATE
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
    return _Under(fitted, late)


def _later(log: Trajectory, torque: F64, late: F64) -> F64:
    """(N, J) torques behind a pole of each joint, or before one where times (J,) are negative."""
    if not late.any():
        return torque
    pad = len(log.taps)
    padded = np.pad(torque, ((pad, pad), (0, 0)), mode="edge")
    s = 2j * np.pi * np.fft.rfftfreq(len(padded), 1 / log.rate)[:, None]
    gain = np.where(late > 0, 1 / (1 + s * late.clip(min=0.0)), 1 - s * late)
    return np.fft.irfft(gain * np.fft.rfft(padded, axis=0), len(padded), axis=0)[pad:-pad]


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


def _of_links(fitted: Fitted, joints: Int) -> tuple[list[F64], list[F64]]:
    """Torques of stiff links along a motion, as heavy as efforts tell, and what is beside them.

    Args:
        fitted: the fit of joints, which may yield, with the motion of the links.
        joints: (J,) whose efforts are known.

    Returns:
        Per log (N, J) of these, and of the friction and offset of each effort [N m or N].
    """
    problem, state = fitted.problem, fitted.state
    tree = problem.tree
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


def _cost(under: _Under, weighed: _Under) -> float:
    """Chi-squared of a fit with the weights of another."""
    by = weighed.fitted
    shaken = Shaken.of(by.problem.tree, by.problem.logs, by.state, by.weights)
    return cost_with(by.weights, shaken, under.fitted)
