"""How good the sensors of one robot are, learnt from what all samples show of each.

Where the fit leaves sensors that are hardly made, it may have ended on the wrong side of a hill:
one that began where causes were not known yet has bent sensors in their place, and would stay.

An SU that only one joint turns can not tell its tilt from a bias or a cross-axis error, so that its
orientation is known as well as its sensor is. What is known of it is what the other SUs show of
theirs. All samples show that far better than the features did that a fit begins with, most of all
in logs without patterns, in which these are rests.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import N_PLACEMENT, N_SU
from skin2urdf.estimation.solve.spread import narrowed
from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse
from skin2urdf.estimation.trajectory.attempt import Explained
from skin2urdf.estimation.trajectory.bending import bends_of
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.senses import minus_log_posterior

_FAR = 5.0
"""Standard deviations of chi-squared from which sensors are hardly made so. What this decides about
is time alone: one fit more."""
_HALF = 0.5
"""Share of chi-squared's mean below which sensors are not bent by much, whatever began it: they are
better than they were said to be. This decides about time alone as well."""
_NOTHING = 1e-13
"""Share by which directions without any information are held: a thousand times rounding. What is
known of a bias before has 1e-10 of the information that an hour at rest has on a tilt, and must
not pass for nothing."""


def with_sensors_alike(problem: MotionProblem, fitted: Fitted) -> tuple[MotionProblem, Fitted]:
    """The fit with sensors that are taken to be as good as the samples show others to be.

    Args:
        problem: what was fitted.
        fitted: its fit.
    """
    learnt = _learnt(problem, fitted)
    if learnt == problem.priors.sensors:
        return problem, fitted
    alike = problem.again(priors=replace(problem.priors, sensors=learnt))
    # The samples say what they said.
    equations = alike.with_other_priors(fitted.equations, fitted.state, problem)
    begin = fitted.predicted
    return alike, fit(alike, fitted.state, near=True, predicted=begin, equations=equations)


def with_likely_sensors(found: Explained, iterations: int) -> Explained:
    """The fit, or one that begins with sensors without errors, where samples are likelier then.

    It is tried where sensors differ from what is known of them by more than chance makes, or by
    half of that at least where the fit began before it was known what they stood for. What bends is
    known about where it was followed to, and not from afar.

    Args:
        found: what was fitted, and the fit.
        iterations: linearisations, at most, of another fit.
    """
    problem, fitted = found.problem, found.fitted
    places, free = fitted.state.placements, problem.free_su[:, N_PLACEMENT:N_SU]
    error = np.concatenate([places.bias, places.shape], axis=1)
    known = np.broadcast_to(problem.priors.sensors.deviations, error.shape)
    chi2, freedom = float(((error[free] / known[free]) ** 2).sum()), int(free.sum())
    bent = bool(found.causes) and bends_of(problem.unseen) is None
    if chi2 <= (_HALF * freedom if bent else freedom + _FAR * np.sqrt(2 * freedom)):
        return found
    exact = replace(places, bias=0 * places.bias, shape=0 * places.shape)
    start = replace(fitted.state, placements=exact)
    other = fit(problem, start, iterations=iterations, far=True)
    likelier = minus_log_posterior(other) < minus_log_posterior(fitted)
    return replace(found, fitted=other) if likelier else found


def _learnt(problem: MotionProblem, fitted: Fitted) -> Priors:
    """What is known of the sensors, narrowed to the errors that the samples show."""
    of = slice(N_PLACEMENT, N_SU)
    places = fitted.state.placements
    error = np.concatenate([places.bias, places.shape], axis=1)
    variance = _variances(problem, fitted)[:, of]
    return narrowed(problem.priors.sensors, error, variance, problem.free_su[:, of])


def _variances(problem: MotionProblem, fitted: Fitted) -> F64:
    """(U, n) variances of the SUs' coordinates, whatever the joints are."""
    free = problem.free_joint, problem.free_su
    system = eliminated(fitted.equations, *free, nothing=_NOTHING)
    joint = joint_inverse(system.schur, free[0], _NOTHING)
    by_joint = np.einsum("unj,jk,unk->un", system.lean, joint, system.lean, optimize=True)
    return np.asarray(np.einsum("unn->un", system.su_inverse) + by_joint)
