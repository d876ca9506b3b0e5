"""The paper's optimisation of one step (II-C.4): NLopt's MLSL_LDS with LN_NELDERMEAD."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Record


@dataclass(frozen=True)
class SearchSettings:
    """How each step of the progressive estimation is searched.

    Attributes:
        e_stop: global stop criterion e_T_stop [g^2]. Paper: 0.1, without a unit; in g^2 the noise
            of its case amounts to 0.008 and its printed e_T of 0.075 to 0.099 lie below the stop.
        ftol_rel: local relative stop criterion. Paper: printed as 1^-6, read as 1e-6.
        evaluations: calls of the error function until a search is given up and restarted.
            Left open by the paper.
        attempts: searches at most. Left open by the paper.
        population: MLSL's random points per iteration; 0 takes NLopt's default of 4. Left open by
            the paper.
    """

    e_stop: float = 0.1
    ftol_rel: float = 1e-6
    evaluations: int = 100_000
    attempts: int = 5
    population: int = 0


@dataclass(frozen=True, eq=False)
class Found(Record):
    """The best point of a search.

    Attributes:
        x: (n,) parameters, angles in [-pi, pi].
        value: the error there.
        calls: calls of the error function over all attempts; the paper's iterations.
        attempts: searches that were made.
    """

    x: F64
    value: float
    calls: int
    attempts: int


def search(
    error: Callable[[F64], float],
    bounds: tuple[F64, F64],
    angles: Bool,
    settings: SearchSettings,
    rng: np.random.Generator,
) -> Found:
    """Global minimum of an error function, or the first point at or below the stop value.

    The first attempt is the paper's: bounds of eq. 18 and the start in their middle. MLSL_LDS draws
    its points from Sobol's sequence, the same in every run, so a restart would repeat itself: later
    attempts turn the interval of every angle, which describes the same set of robots.

    Args:
        error: the error function.
        bounds: (n,) lower and (n,) upper bounds.
        angles: (n,) True where a parameter is an angle [rad].
        settings: stop criteria and budget.
        rng: source of the turns.
    """
    import nlopt

    nlopt.srand(int(rng.integers(1, 2**31 - 1)))
    lower, upper = bounds
    best_x, best, calls, attempt = 0.5 * (lower + upper), np.inf, 0, 0

    def counted(x: F64, _gradient: F64) -> float:
        nonlocal best_x, best, calls
        calls += 1
        value = error(x)
        if value < best:
            best_x, best = x.copy(), value
        return value

    for attempt in range(1, settings.attempts + 1):
        turn = np.where(angles, rng.uniform(-np.pi, np.pi, len(lower)), 0.0) * (attempt > 1)
        optimiser = nlopt.opt(nlopt.G_MLSL_LDS, len(lower))
        local = nlopt.opt(nlopt.LN_NELDERMEAD, len(lower))
        local.set_ftol_rel(settings.ftol_rel)
        optimiser.set_local_optimizer(local)
        optimiser.set_population(settings.population)
        optimiser.set_lower_bounds(lower + turn)
        optimiser.set_upper_bounds(upper + turn)
        optimiser.set_min_objective(counted)
        optimiser.set_stopval(settings.e_stop)
        optimiser.set_maxeval(settings.evaluations)
        # At the floor of rounding NLopt gives up; the best point is kept.
        with suppress(nlopt.RoundoffLimited):
            optimiser.optimize(0.5 * (lower + upper) + turn)
        if best <= settings.e_stop:
            break
    wrapped = (best_x + np.pi) % (2.0 * np.pi) - np.pi
    return Found(np.where(angles, wrapped, best_x), best, calls, attempt)
