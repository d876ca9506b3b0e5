"""Sensors whose scale drifts as they warm up.

What an axis reads per m/s^2 changes with temperature as its bias does: data sheets state both, of
MEMS some 0.02 % and 0.1 to 1 mg per kelvin. A bias that drifts is followed whatever it does. A
scale is seen as gravity and moves use it, at other times in other axes, and follows few numbers:
of every axis a line in time, and a square.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.polynomial.legendre import legvander

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.state import N_WARMING, MotionState

_USUAL = 5e-3
"""Standard deviation of what scales change by within a log [1]: 0.02 % per kelvin, over 25 of them.
Of 6 numbers of each SU it takes nothing but what no motion shows."""


def fit_warming(problem: MotionProblem, fitted: Fitted) -> tuple[MotionProblem, Fitted]:
    """The fit with scales that drift.

    Args:
        problem: what was fitted.
        fitted: the fit, near which it begins.
    """
    G, U = len(problem.logs), problem.tree.n_sus
    warming = problem.again(priors=replace(problem.priors, warming=_USUAL))
    state = replace(fitted.state, warming=np.zeros((G, U, N_WARMING, 3)))
    return warming, fit(warming, state, predicted=fitted.predicted)


def with_steady_scales(
    problem: MotionProblem, state: MotionState
) -> tuple[MotionProblem, MotionState]:
    """The problem with scales that stay as they are, and a state with all else as it is."""
    steady = problem.again(priors=replace(problem.priors, warming=0.0))
    return steady, replace(state, warming=MotionState.no_warming())


def scale_drifts(state: MotionState) -> F64:
    """(U, 3) by how much the scale of each axis changes within a log, largest less smallest [1]."""
    if not state.warming.size:
        return np.zeros((len(state.placements.bias), 3))
    course = legvander(np.linspace(-1, 1, 41), N_WARMING)[:, 1:]
    within = np.tensordot(course, state.warming, (1, 2))
    return np.asarray(np.ptp(within, axis=0).max(axis=0))
