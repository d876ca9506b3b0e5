"""What the noise of encoders does to a fit, taken off.

Positions are differentiated twice, so that accelerations carry noise, and least squares with noise
in what they rest on shortens: lever arms come out as if part of the acceleration had not been.
With ``dq''`` the noise of a joint's acceleration, the prediction is off by ``tau dq''`` and its
derivatives by ``(d tau) dq''``; their product does not average out. Its mean follows from the
variance of ``dq''``, and one step takes it off (corrected scores: Stefanski 1985; Nakamura 1990).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.arrow import eliminated, newton_step
from skin2urdf.estimation.trajectory.fit import Fitted, held
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Predicted
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.signals.trajectory import Trajectory

_EVERY = 10
"""Kept samples of which one stands for all: some three a second, in which a robot hardly turns."""

_MOST = 1.25
"""Squared residuals of an SU over what they were, from which a step took off more than was there.
Noise of variance C beside motion of S shortens by C / (S + C), which is at most half the noise
(S = C) in what is predicted, and so at most a quarter of what noise leaves."""


def without_shortening(problem: MotionProblem, fitted: Fitted) -> Fitted:
    """A fit without what the noise of encoders does to it.

    Args:
        problem: what was fitted.
        fitted: its optimum.

    Returns:
        The fit, some standard deviations away; the same where one step would not take it off, as in
        a log of motion so slow that it is lost in the noise.
    """
    noise = [log.noise for log in problem.logs if log.noise is not None]
    if len(noise) < len(problem.logs):
        return fitted
    layout, tree = problem.layout, problem.tree
    state = replace(
        fitted.state,
        unseen=np.zeros(0),
        knots=tuple(k[:0] for k in fitted.state.knots),
        gyro=np.zeros((tree.n_sus, 0)),
    )
    still = _posed(problem, None)
    at_rest = _predicted(still, state)
    shared = slice(0, layout.gravity + 1)
    # What is steady shows nothing of clocks, and of front ends what is added below.
    own = slice(0, layout.front.start)
    joint, su = np.zeros(layout.n_joint), np.zeros((tree.n_sus, layout.n_su))
    for d in range(tree.n_joints):
        pushed = _posed(problem, d)
        driven = _predicted(pushed, state)
        # Residuals are readings less predictions, so this is what a unit of acceleration does.
        tau = [
            np.where(a.measured[..., None], a.residual - b.residual, 0.0)
            for a, b in zip(at_rest, driven, strict=True)
        ]
        weights = [
            w[::_EVERY, :, :3] * (_EVERY * log.moving[::_EVERY, d, None, None])
            for w, log in zip(fitted.weights, problem.logs, strict=True)
        ]
        louder = [w * n[d, 0] for w, n in zip(weights, noise, strict=True)]
        with_push = _gradients(pushed, state, driven, tau, louder)
        without = _gradients(still, state, at_rest, tau, louder)
        joint[shared] += (with_push[0] - without[0])[shared]
        joint[layout.further] += (with_push[0] - without[0])[still.layout.further]
        su[:, own] += (with_push[1] - without[1])[:, own]
        for n, w, t in zip(noise, weights, tau, strict=True):
            shaken = n[d, 1] * np.einsum("kuc,kuc->u", w, t**2)
            # A front end's coordinates weigh the second derivative of a reading by 1/2 and -1.
            su[:, layout.front] += shaken[:, None] * np.array([-0.5, 1.0])
    equations = replace(fitted.equations, joint_gradient=joint, su_gradient=su)
    system = eliminated(equations, problem.free_joint, problem.free_su)
    taken_off = held(problem, layout.moved(fitted.state, *newton_step(system, problem.free_joint)))
    left = _left(fitted, fitted)
    small = bool((_left(taken_off, fitted) <= _MOST * left).all())
    return taken_off if small else fitted


def _left(found: Fitted, weighed: Fitted) -> F64:
    """(U,) squared residuals of each SU, with the weights of a fit."""
    by_log = [
        np.einsum("kuc,ku->u", w[..., :3] * p.residual**2, p.measured)
        for w, p in zip(weighed.weights, found.predicted, strict=True)
    ]
    return np.asarray(np.sum(by_log, axis=0))


def _gradients(
    problem: MotionProblem,
    state: MotionState,
    predicted: Sequence[Predicted],
    residual: Sequence[F64],
    weights: Sequence[F64],
) -> tuple[F64, F64]:
    """Gradients (J,) and (U, n) that given residuals (K, U, 3) would make."""
    swapped = [replace(p, residual=r) for p, r in zip(predicted, residual, strict=True)]
    equations = problem.equations(state, swapped, weights)
    return equations.joint_gradient, equations.su_gradient


def _predicted(problem: MotionProblem, state: MotionState) -> list[Predicted]:
    return [problem.predict(state, g) for g in range(len(problem.logs))]


def _posed(problem: MotionProblem, pushed: int | None) -> MotionProblem:
    """A problem whose logs stand still in some of its positions, one joint accelerating by 1."""
    priors = replace(problem.priors, unseen=np.zeros(0))
    logs = [_posed_log(log, pushed) for log in problem.logs]
    return MotionProblem(problem.tree, logs, priors)


def _posed_log(log: Trajectory, pushed: int | None) -> Trajectory:
    q = log.q[log.kept[::_EVERY]]
    qdd = np.zeros_like(q)
    if pushed is not None:
        qdd[:, pushed] = 1.0
    return replace(
        log,
        rate=log.rate / float(np.median(np.diff(log.kept))) / _EVERY,
        taps=np.ones(1),
        q=q,
        qd=np.zeros_like(q),
        qdd=qdd,
        readings=np.zeros((len(q), *log.readings.shape[1:])),
        kept=np.arange(len(q)),
        valid=log.valid[::_EVERY],
        moving=log.moving[::_EVERY],
        rates=None,
        turning=None,
        positions=q,
        beyond=None,
    )
