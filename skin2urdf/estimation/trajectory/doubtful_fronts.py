"""Low-passes of sensors that may be nothing but the noise of encoders.

A low-pass that cuts off what encoders' noise makes of predictions leaves less of the readings. What
it gains by that is taken off (see :mod:`shaken`), but only as well as it is known, and where noise
is large a low-pass that is not there can still pay. A real one gains a hundred times as much by
what it makes of the motion. So a fit whose low-passes cut off more noise than chance is held
against one that begins with fast sensors, and is kept where its gain is beyond doubt.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.estimation.trajectory.fit import Fitted, cost_with, fit
from skin2urdf.estimation.trajectory.front_end import N_FRONT, begin_front
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import fit_with_products

UNSURE = 1 / np.sqrt(3)
"""Standard deviation of what the noise of encoders does, over what is taken off for it, where that
is not drawn anew: white noise is taken off, one of few frequencies may do twice that or none."""
_BEYOND_DOUBT = 5.0
"""Standard deviations of what is taken off that a low-pass has to gain."""


def has_doubtful_fronts(fitted: Fitted) -> bool:
    """Whether the low-passes of a fit cut off more of encoders' noise than chance makes them."""
    state = fitted.state
    return fitted.shaken.cut_off(state) > N_FRONT * len(state.front)


def without_doubtful_fronts(
    problem: MotionProblem, fitted: Fitted, iterations: int
) -> tuple[MotionProblem, Fitted]:
    """The fit, or one that begins with fast sensors where its low-passes may be encoders' noise.

    Args:
        problem: the logs, the tree and what is known before.
        fitted: its fit, from sensors that may be slow, with low-passes that are doubtful.
        iterations: linearisations, at most, of another fit.
    """
    state = fitted.state
    front = np.tile(begin_front(problem.priors.front, fast=True), (len(state.front), 1))
    fast = fit(problem, replace(state, front=front), near=True, iterations=iterations)
    shaken = fast.shaken
    gain = fast.chi2 - cost_with(fast.weights, shaken, fitted)
    taken_off = shaken.cut_off(state) - shaken.cut_off(fast.state)
    if gain > _BEYOND_DOUBT * UNSURE * max(taken_off, 0.0):
        return problem, fitted
    return fit_with_products(problem, fast, iterations)
