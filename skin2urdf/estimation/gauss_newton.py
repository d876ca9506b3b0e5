"""Levenberg-Marquardt on the arrow system: the inner solver of the closed-form starts."""

from __future__ import annotations

from skin2urdf.estimation.arrow import factor
from skin2urdf.estimation.cost import Cost
from skin2urdf.estimation.state import Free, State, moved


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
            step = factor(equations, free, damping).newton_step(gradient)
            trial_state = moved(state, step)
            trial = cost.at(trial_state)
            if trial.chi2 <= here.chi2:
                break
            damping = max(damping * 10, 1e-4)
            if damping > 1e8:
                return state, here.chi2
        gain = here.chi2 - trial.chi2
        state, here = trial_state, trial
        damping = damping / 10 if damping > 1e-9 else damping
        if gain <= tolerance * here.chi2:
            break
    return state, here.chi2
