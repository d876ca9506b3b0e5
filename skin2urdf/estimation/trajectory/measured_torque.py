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

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.fit import Fitted, cost_with
from skin2urdf.estimation.trajectory.known_torque import (
    Under,
    fit_under,
    springs_under,
    with_fresh_sensors,
)
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.shaken import Shaken
from skin2urdf.estimation.trajectory.torques import bodies, inertial_sizes, loads_of, regressors
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import filtered
from skin2urdf.signals.trajectory import Trajectory

_SLIDES = 0.02
"""Speed at which friction has nearly its full size [rad/s or m/s]: gears change from sticking to
sliding at some hundredths of a radian per second."""
_SHOWS = 1e-9
"""Least share of the largest eigenvalue that masses and moments are told along a direction from:
less than a ten-thousandth of the largest torque is no torque that shows."""
_MOST = 4
"""Turns of torques and of the motion that they make, at most: one leaves a tenth of what is off,
and a third where half of the efforts is friction."""
_SHARE = 0.01
"""Share of chi-squared that a turn takes off at least if another one is worth it."""
N_OWN = 3
"""Numbers of each effort beside masses and moments: an offset, and friction of two kinds."""


def with_measured_torque(
    problem: MotionProblem, fitted: Fitted, may_explain: Callable[[Unseen], bool] = lambda _: True
) -> tuple[MotionProblem, Fitted] | None:
    """The fit with joints that yield under torques that were measured; None where none were.

    Args:
        problem: the rigid robot.
        fitted: its fit.
        may_explain: tells of the deflections whether they explain enough to first order, as they do
            wherever torques are those that bend joints: they are linear in compliances. Where they
            do not, there is no fit.
    """
    joints = _measured(problem.logs)
    if not len(joints):
        return None
    efforts = [log.effort[:, joints] for log in problem.logs]
    fresh = with_fresh_sensors(problem, fitted.state)

    def along(last: Fitted) -> tuple[list[F64], list[F64]]:
        loads, beside = _of_links(last, joints)
        return [tau - each for tau, each in zip(efforts, beside, strict=True)], loads

    torques, _ = along(fitted)
    if not may_explain(springs_under(joints, torques)):
        return None
    best = first = fit_under(problem, fresh, joints, torques, np.zeros(len(joints)))
    least, kinds = _cost(first, first), [0, 1]
    for _ in range(_MOST):
        # Along the motion that links really make, both are known better.
        both, start = along(best.fitted), best.fitted.state
        further = [fit_under(problem, start, joints, both[kind], best.late) for kind in kinds]
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


def _cost(under: Under, weighed: Under) -> float:
    """Chi-squared of a fit with the weights of another."""
    by = weighed.fitted
    shaken = Shaken.of(by.problem.tree, by.problem.logs, by.state, by.weights)
    return cost_with(by.weights, shaken, under.fitted)
