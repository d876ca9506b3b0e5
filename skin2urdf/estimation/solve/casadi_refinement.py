"""Refinement with CasADi: one weighted least-squares over the whole tree.

Levenberg-Marquardt with two measures against the narrow, curved valleys of weakly determined
directions (an upright first axis leaves the yaw of what it carries to the noise): placements move
along screws, which a turn of everything beyond a joint is exactly, and every step is bent by the
second derivative of the residuals along it (geodesic acceleration, Transtrum & Sethna 2012).
"""

from __future__ import annotations

import numpy as np

from skin2urdf.errors import BadFitError
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.problem.state import Free, State, screwed
from skin2urdf.estimation.solve.arrow import factor
from skin2urdf.estimation.solve.symbolic_cost import Linearisation, SymbolicCost

_NEGLIGIBLE = 1e-4
"""Fall of chi-squared, per chi-squared of one measurement, that is not worth another step: it moves
no parameter by more than a hundredth of its standard deviation."""
_ROUNDING = 1e-13
"""Fall of chi-squared relative to itself that rounding can produce."""
_MOST_BENDING = 0.375
"""Largest second-order part of a step, relative to its first-order part."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-7, 1e-16, 1e8


def refine(
    cost: Cost, state: State, free: Free, *, max_iterations: int = 20
) -> tuple[State, float]:
    """Minimise chi-squared over all free coordinates at once.

    Args:
        cost: the cost; its features, tree and priors are used, its derivatives are not.
        state: where to start.
        free: which coordinates may move.
        max_iterations: at most that many linearisations.

    Returns:
        The best state found and its chi-squared, at most that of ``state``.

    Raises:
        BadFitError: the chi-squared of ``state`` is not finite.
    """
    start = cost.at(state).chi2
    if not np.isfinite(start):
        raise BadFitError(
            f"the refinement can not start from a state whose chi-squared is {start}",
            "check the features and the start for values that are not finite",
        )
    refined = _levenberg_marquardt(
        SymbolicCost(cost), state, free, max_iterations, _NEGLIGIBLE / max(cost.n_data, 1)
    )
    chi2 = cost.at(refined).chi2
    return (refined, chi2) if chi2 <= start else (state, start)


def _levenberg_marquardt(
    cost: SymbolicCost, state: State, free: Free, max_iterations: int, tolerance: float
) -> State:
    """The best state met."""
    chi2, damping = cost.chi2(state), _FIRST_DAMPING
    for _ in range(max_iterations):
        model = cost.linearised(state)
        eased = max(damping / 10, _LEAST_DAMPING)
        while True:
            trial = _trial(model, free, damping)
            trial_chi2 = np.inf if trial is None else cost.chi2(trial)
            if trial is not None and trial_chi2 <= chi2:
                break
            eased = damping = 10 * damping
            if damping > _MOST_DAMPING:
                return state
        gain = chi2 - trial_chi2
        state, chi2, damping = trial, trial_chi2, eased
        if gain <= (tolerance + _ROUNDING) * chi2:
            break
    return state


def _trial(model: Linearisation, free: Free, damping: float) -> State | None:
    """The state a damped and bent step leads to; None where it bends too much to be trusted."""
    solver = factor(model.equations, free, damping)
    step = solver.newton_step(model.gradient)
    bending = model.bending(step)
    bend = solver.newton_step(step.like(0.5 * bending.flat()))
    information = np.concatenate(
        [np.diagonal(model.equations.joint), np.einsum("uii->ui", model.equations.su).ravel()]
    )
    straight, bent = step.flat(), bend.flat()
    if not information @ bent**2 <= _MOST_BENDING**2 * (information @ straight**2):
        return None
    return screwed(model.state, step.like(straight + bent))
