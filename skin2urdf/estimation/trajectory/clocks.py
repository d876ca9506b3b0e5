"""What the clocks of SUs tell of each other's.

SUs of one robot mostly share a bus, a driver and so a clock, or have clocks that differ by as much
as those of the others do. An SU on a vertical joint that moves slowly feels next to nothing of its
motion: a fit may end at any lag, with another place for each, and half a period of a pattern off it
is on the other side of the joint. So an SU's clock that stands out is tried among the others: it
stays there unless that leaves more by what a clock of its own costs, the choice of one out of all
that could be. How far clocks spread is learnt, and is as wide as they are where each has its own;
few clocks tell little of it (Student 1908).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.solve.spread import BEYOND_NOISE, DETERMINED, ENOUGH, spread
from skin2urdf.estimation.trajectory.deviations import su_covariances
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.priors import ClockPriors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.state import MotionState

_STANDS_OUT = 2.0
"""Standard deviations from which a clock is tried among the others: one in twenty by chance, which
costs a fit. What decides is chi-squared."""
_OTHERS = 2
"""Other SUs that tell where clocks are, at least: of a single one nobody knows how far clocks
spread."""
_BOTH_SIDES = 0.9772
"""Share of a normal distribution that is not beyond two standard deviations on one side: as much of
Student's is within, whose width says how little few others tell of how far clocks spread."""
_PASSES = 3
"""Times that clocks are looked at again: some that stand out make the others look spread."""


def clocks_of_others(clock: F64, variance: F64, mended: F64, given: F64) -> ClockPriors:
    """What the other SUs tell of clocks that stand out, or that they tell more of than the SU does.

    Args:
        clock: (G, U, 2) lag [s] and drift [1] of each SU in each log.
        variance: (G, U, 2) of them.
        mended: (G, U, 2) what of both was taken off each SU's stamps before.
        given: (2,) their standard deviations before anything is known.

    Returns:
        Of clocks of which the others do not tell more, no more than was given.
    """
    total = clock + mended
    mean, deviation = np.zeros(total.shape), np.broadcast_to(given, total.shape).copy()
    told = variance < DETERMINED * given**2
    for g, c, u in np.ndindex(len(total), len(given), total.shape[1]):
        others = told[g, :, c] & (np.arange(total.shape[1]) != u)
        if others.sum() < _OTHERS:
            continue
        least = BEYOND_NOISE**2 * float(np.median(variance[g, told[g, :, c], c]))
        usual = float(np.median(total[g, others, c]))
        wide = float(stdtrit(others.sum() - 1, _BOTH_SIDES)) / _STANDS_OUT
        apart = spread(total[g, others, c] - usual, variance[g, others, c])
        size2 = max((wide * apart) ** 2, least)
        # Its own samples may have led to where a pattern looks right half a period off.
        out = abs(total[g, u, c] - usual) > _STANDS_OUT * np.sqrt(size2 + variance[g, u, c])
        vague = others.sum() >= ENOUGH and variance[g, u, c] > max(least, size2)
        if (out or vague) and size2 < given[c] ** 2:
            mean[g, u, c], deviation[g, u, c] = usual - mended[g, u, c], np.sqrt(size2)
    return ClockPriors(mean, deviation)


def with_likely_clocks(
    problem: MotionProblem,
    fitted: Fitted,
    begin: MotionState,
    mended: F64,
    iterations: int,
) -> tuple[MotionProblem, Fitted]:
    """The fit in which no SU has a clock of its own that its samples do not pay for.

    Args:
        problem: what was fitted.
        fitted: its fit.
        begin: where it began.
        mended: (G, U, 2) latency [s] and drift [1] that were taken off each SU's stamps before.
        iterations: linearisations at most.
    """
    own = np.asarray((mended != 0).any(axis=(0, 2)))  # other samples have confirmed these
    for _ in range(_PASSES):
        variance = _variances(problem, fitted)
        expected = clocks_of_others(fitted.state.clock, variance, mended, _given(problem))
        off = np.abs(fitted.state.clock - expected.mean)
        narrow = expected.deviation < _given(problem)
        out = narrow & (off > _STANDS_OUT * np.hypot(expected.deviation, np.sqrt(variance)))
        tried = out.any(axis=(0, 2)) & ~own
        if not tried.any():
            break
        about, there = _among_the_others(problem, fitted, begin, expected, tried, iterations)
        stays = tried & (_rise(fitted, there) > _price(problem, variance, own))
        if (tried & ~stays).any():
            if stays.any():
                tried = tried & ~stays
                about, there = _among_the_others(
                    problem, fitted, begin, expected, tried, iterations
                )
            problem, fitted = about, there
        own |= stays
    return problem, fitted


def _among_the_others(
    problem: MotionProblem,
    fitted: Fitted,
    begin: MotionState,
    expected: ClockPriors,
    which: Bool,
    iterations: int,
) -> tuple[MotionProblem, Fitted]:
    """The fit with some SUs (U,) on the clocks that the others tell.

    Their places begin anew: they were what went with the clocks that they had.
    """
    state, given = fitted.state, _given(problem)
    clock, places, first = state.clock.copy(), state.placements, begin.placements
    clock[:, which] = expected.mean[:, which]
    at = which[:, None, None]
    places = replace(
        places,
        T_joint_su=np.where(at, first.T_joint_su, places.T_joint_su),
        bias=np.where(which[:, None], first.bias, places.bias),
        shape=np.where(which[:, None], first.shape, places.shape),
    )
    priors = ClockPriors(
        np.where(at[:, :, 0], expected.mean, 0.0),
        np.where(at[:, :, 0], expected.deviation, given),
    )
    about = problem.again(priors=replace(problem.priors, clocks=priors))
    return about, fit(about, replace(state, placements=places, clock=clock), iterations=iterations)


def _rise(fitted: Fitted, other: Fitted) -> F64:
    """(U,) by how much chi-squared of each SU's samples is larger in another fit."""
    rise, left, count = 0.0, 0.0, 0.0
    for w, here, there in zip(fitted.weights, fitted.predicted, other.predicted, strict=True):
        both = (here.measured & there.measured)[..., None]
        before, after = (
            np.where(both, w[..., :3] * p.residual**2, 0.0).sum(axis=(0, 2)) for p in (here, there)
        )
        rise, left = rise + after - before, left + before
        count = count + np.where(both, w[..., :3] > 0, False).sum(axis=(0, 2))
    return np.asarray(rise / np.maximum(left / np.maximum(count, 1), 1.0))


def _price(problem: MotionProblem, variance: F64, own: Bool) -> F64:
    """(U,) fall of chi-squared that a clock of an SU's own is worth at least.

    One out of all that could be is as much less likely as it is better known, and as fewer of the
    others have one.
    """
    choice = np.log(_given(problem) ** 2 / variance).clip(min=0.0).sum(axis=(0, 2))
    return np.asarray(choice + 2 * np.log((len(own) + 1) / (own.sum() + 1)))


def _given(problem: MotionProblem) -> F64:
    """(2,) standard deviations of lag [s] and drift before anything is known."""
    return np.array([problem.priors.lag, problem.priors.drift])


def _variances(problem: MotionProblem, fitted: Fitted) -> F64:
    """(G, U, 2) variances of the clocks."""
    variance = np.einsum("uii->ui", su_covariances(fitted.equations))
    logs = range(problem.layout.n_logs)
    return np.stack([variance[:, problem.layout.clock(g)] for g in logs]).clip(min=1e-24)
