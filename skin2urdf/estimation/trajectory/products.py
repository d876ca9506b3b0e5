"""What readings hold beyond those of a low-passed motion: products of motions.

Readings are low-passed, and so are positions before accelerations are predicted from them, which is
the same to first order. Centripetal and Coriolis accelerations and what gravity does in a link that
turns are products: motions of 3 Hz make readings of 6 Hz, which come with the gain that the
low-pass has at 6 Hz, and are predicted from motions with the gain at 3 Hz. Where the low-pass falls
between the two, lengths make up for the difference. A state that explains the readings to first
order is near enough to tell what it is: the prediction from the motion as it was sampled, which is
low-passed twice afterwards, less that from the low-passed motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Predicted
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.signals.filters import filtered, first_derivative, second_derivative
from skin2urdf.signals.trajectory import Trajectory

NEAR = 30.0
"""Length of a step, in standard deviations of all coordinates together, behind which products are
known: to a thousandth, as lengths are."""
_MOST_OF_IT = 0.5
"""Part of what a fit left that may stay with products where these were most of it."""


def fit_with_products(
    problem: MotionProblem, fitted: Fitted, iterations: int
) -> tuple[MotionProblem, Fitted]:
    """The fit with what readings hold beyond those of the logs' low-passed motion.

    Where that was most of what the fit left, it had led the fit astray, and is looked at again.

    Args:
        problem: the logs, the tree and what is known before.
        fitted: a fit that explains the readings to first order.
        iterations: linearisations, at most, of each fit.
    """
    while True:
        left = _left(fitted)
        problem, predicted = with_products(problem, fitted)
        fitted = fit(problem, fitted.state, near=True, iterations=iterations, predicted=predicted)
        if not _left(fitted) < _MOST_OF_IT * left:
            return problem, fitted


def with_products(
    problem: MotionProblem, fitted: Fitted
) -> tuple[MotionProblem, tuple[Predicted, ...]]:
    """The same problem with what readings hold beyond those of low-passed motion, as of a fit.

    Args:
        problem: the logs, the tree and what is known before.
        fitted: a fit of it.

    Returns:
        The problem, and per log the residuals at the fit, which are then those of the motion as it
        was sampled.
    """
    state = fitted.state
    whole, passed = _as_sampled(problem, state)
    logs, predicted = [], []
    for g, (log, p) in enumerate(zip(problem.logs, fitted.predicted, strict=True)):
        if len(log.positions):
            at = whole.predict(state, g)
            first = p if passed is problem else passed.predict(state, g)
            # In place: with many SUs each such array is large.
            more = _residual(first)
            more -= _residual(at)
            p = _less(p, more)
            if log.beyond is not None:
                more += log.beyond
            log = replace(log, beyond=more)
        logs.append(log)
        predicted.append(p)
    return problem.again(logs=logs), tuple(predicted)


def _left(fitted: Fitted) -> float:
    """Root mean square of all residuals [m/s^2]."""
    square = [(p.residual[p.measured] ** 2).sum() for p in fitted.predicted]
    count = [3 * p.measured.sum() for p in fitted.predicted]
    return float(np.sqrt(sum(square) / max(1, sum(count))))


def _residual(predicted: Predicted) -> F64:
    """(K, U, 3) residuals, 0 where nothing is measured; (K, U, 6) with gyroscopes', theirs last."""
    residual = np.where(predicted.measured[..., None], predicted.residual, 0.0)
    turned = predicted.turned
    return residual if turned is None else np.concatenate([residual, turned.residual], axis=2)


def _less(predicted: Predicted, more: F64) -> Predicted:
    """Residuals where readings are known to hold more: (K, U, 3), or (K, U, 6) with gyroscopes."""
    turned = predicted.turned
    if turned is not None:
        turned = replace(turned, residual=turned.residual - more[..., 3:])
    return replace(predicted, residual=predicted.residual - more[..., :3], turned=turned)


def _as_sampled(problem: MotionProblem, state: MotionState) -> tuple[MotionProblem, MotionProblem]:
    """The problem with motion that is not low-passed, its prediction twice instead; and as it was.

    What links do beyond their encoders is known low-passed, by what leaves nearly all of it: a gain
    of H becomes one of ``1 - (1 - H)^2`` where what is left out is added once more (twicing: Tukey
    1977). Where the low-pass ends that is still too little: what rings there is low-passed from the
    same motion in the second problem, so that the two differ in products alone.
    """
    logs = [_not_low_passed(log) for log in problem.logs]
    unseen, x = problem.unseen, state.unseen
    if unseen is None:
        return problem.again(logs=logs), problem
    sampled, passed = [], []
    for g, log in enumerate(problem.logs):
        moved = np.array(unseen.moved(log, g, x).q)
        moved[:, : log.q.shape[1]] -= log.q
        known = len(log.positions) > 0
        sampled.append(2 * moved - filtered(moved, log.taps) if known else moved)
        passed.append(filtered(sampled[-1], log.taps) if known else moved)

    def along(logs: Sequence[Trajectory], settled: Sequence[F64]) -> MotionProblem:
        known = replace(unseen, settled=tuple(settled), origin=x)
        return MotionProblem(problem.tree, logs, problem.priors, problem.layout.n_knots, known)

    return along(logs, sampled), along(problem.logs, passed)


def _not_low_passed(log: Trajectory) -> Trajectory:
    """A log with the motion as it was sampled."""
    if not len(log.positions):
        return log
    return replace(
        log,
        taps=np.convolve(log.taps, log.taps),
        q=log.positions,
        qd=first_derivative(log.positions, log.rate),
        qdd=second_derivative(log.positions, log.rate),
        beyond=None,
    )
