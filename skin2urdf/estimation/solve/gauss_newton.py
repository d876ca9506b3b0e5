"""Levenberg-Marquardt on the arrow system: the inner solver of the closed-form starts."""

from __future__ import annotations

import numpy as np

from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.problem.state import Free, State, screwed
from skin2urdf.estimation.solve.arrow import factor
from skin2urdf.estimation.solve.sensors import sensors_refitted

_STIFFNESS = 100.0
"""How many times as much joints are damped as SUs.

An SU that turns against the rest about a vertical axis shows in little. It can go round exactly,
along a screw; the rest can not, for joints lack the coordinates along and about their axes.
"""

_MOST_SHAPE = 0.5
"""Scale or cross-axis error that no sensor has; beyond lie the mirror images of placements."""


def gauss_newton(
    cost: Cost,
    state: State,
    free: Free,
    iterations: int = 20,
    tolerance: float = 1e-6,
    damping: float = 1e-6,
) -> tuple[State, float]:
    """Minimise chi-squared over the free coordinates.

    Args:
        cost: the cost.
        state: where to start.
        free: which coordinates may move.
        iterations: at most that many linearisations.
        tolerance: stop when chi-squared falls by less than this fraction.
        damping: at the start, relative to each coordinate's own information.

    Returns:
        The best state found and its chi-squared.
    """
    here = cost.at(state)
    for _ in range(iterations):
        equations, gradient = here.normal_equations(), here.gradient()
        while True:
            step = factor(equations, free, damping, _STIFFNESS).newton_step(gradient)
            trial_state, trial = sensors_refitted(cost, screwed(state, step), free)
            sensible = _is_sensor(trial_state, state)
            if trial.chi2 <= here.chi2 and sensible:
                break
            if not sensible and not _is_sensor(sensors_refitted(cost, state, free)[0], state):
                # Shorter steps end where the sensors would be refitted without any.
                return state, here.chi2
            damping = max(damping * 10, 1e-8)
            if damping > 1e8:
                return state, here.chi2
        gain = here.chi2 - trial.chi2
        state, here = trial_state, trial
        damping = damping / 10 if damping > 1e-9 else damping
        if gain <= tolerance * here.chi2:
            break
    return state, here.chi2


def _is_sensor(state: State, before: State) -> bool:
    """Whether no SU's scales and cross-axis terms have just left what a sensor can have."""
    largest, earlier = (float(np.abs(s.shape).max(initial=0.0)) for s in (state, before))
    return largest <= max(_MOST_SHAPE, earlier)
