"""Low-passes that no sensor has: those that droop by more than their lag allows.

A stable filter has r of zero or more (see :mod:`front_end`), so that its droop, ``b^2 / 2 - r``, is
at most half the square of its lag b. A fit may leave that range, so that sensors without any
low-pass scatter about none. Where few frequencies are felt, as by an SU on a first joint, another
optimum lies out there: a droop without a lag, which a shorter lever arm makes up for. Which of the
two a fit finds is a matter of its way, and its chi-squared tells little; but only one is a
sensor's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.estimation.trajectory.deviations import su_covariances
from skin2urdf.estimation.trajectory.fit import Fitted, cost_with, fit
from skin2urdf.estimation.trajectory.front_end import begin_front
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import fit_with_products

_BEYOND = 3.0
"""Standard deviations by which a droop exceeds what its lag allows: of 100 sensors without any
low-pass chance makes one in seven logs seem so, which costs another fit."""
_CERTAIN = 5.0
"""Standard deviations by which readings have to ask for a front end that no sensor has: what else
is wrong with an SU may look like one."""


def with_possible_fronts(
    problem: MotionProblem, fitted: Fitted, iterations: int
) -> tuple[MotionProblem, Fitted]:
    """The fit, or one in which no sensor droops by more than its lag allows.

    Args:
        problem: the logs, the tree and what is known before.
        fitted: its fit.
        iterations: linearisations, at most, of another fit.

    Returns:
        The problem and the fit, with products of motions as of the fit where it is another one.
    """
    odd = _droops_without_lag(fitted)
    if not odd.any():
        return problem, fitted
    state = fitted.state
    front = np.where(odd[:, None], begin_front(problem.priors.front), state.front)
    other = fit(problem, replace(state, front=front), near=True, iterations=iterations)
    costs = cost_with(fitted.weights, fitted.shaken, other) - fitted.chi2
    if costs > _CERTAIN**2 * int(odd.sum()):
        return problem, fitted
    return fit_with_products(problem, other, iterations)


def _droops_without_lag(fitted: Fitted) -> Bool:
    """(U,) whether SUs droop by more than their lag allows, and than chance makes it seem."""
    p, r = fitted.state.front.T
    own = fitted.problem.layout.front
    covariance = su_covariances(fitted.equations)[:, own, own]
    # Half of a negative p counts as a part of the droop that no lag allows.
    weight = np.stack([np.where(p < 0, 0.5, 0.0), -np.ones_like(r)], axis=1)
    beyond = np.einsum("uf,uf->u", weight, fitted.state.front)
    variance = np.einsum("uf,ufg,ug->u", weight, covariance, weight)
    return np.asarray(beyond > _BEYOND * np.sqrt(variance.clip(0.0)))
