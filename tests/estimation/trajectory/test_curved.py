"""Sensors whose axes are curved: found from what all of them read, and followed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from synthetic import RATE, random_state, readings_along, sampled_trajectory, serial_tree, stays

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.attempt import CERTAIN
from skin2urdf.estimation.trajectory.curved import likeliest_curvature, may_be_curved
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.trajectory import Trajectory

_TREE = serial_tree(4)
_SIZE = 2e-3 / (4 * GRAVITY)
"""Curvature of axes that are off by 0.2 % of 4 g at 4 g [s^2/m]."""


@cache
def _truth() -> State:
    rng = np.random.default_rng(5)
    state = replace(random_state(rng, _TREE, 1, 0.3), up=np.array([[0.0, 0.0, 1.0]]))
    return replace(
        state,
        bias=0.03 * rng.standard_normal((4, 3)),
        shape=5e-3 * rng.standard_normal((4, 6)),
    )


def _curvature(size: float) -> F64:
    """(4, 3) up or down."""
    return size * np.random.default_rng(8).choice([-1.0, 1.0], (4, 3))


@cache
def _log(size: float, ripple: float = 0.0) -> Trajectory:
    """Rests in sixteen places, and moves between them that swing.

    Args:
        size: curvature of axes [s^2/m].
        ripple: by how much links are ahead and behind their encoders, 150 times per turn [rad].
    """
    rng = np.random.default_rng(6)
    q = stays(rng.uniform(-1.6, 1.6, (16, 4)), 90, 160)
    t = np.arange(len(q))[:, None] / RATE
    q = q + 0.02 * np.sin(2 * np.pi * np.array([0.9, 1.1, 1.3, 1.7]) * t) * (t % 10 > 5)
    straight = readings_along(_TREE, _truth(), q + ripple * np.sin(150 * q)) - _truth().bias
    read = straight + _curvature(size) * straight**2 + _truth().bias
    read = read + 5e-3 * rng.standard_normal(read.shape)
    return sampled_trajectory(q, read, still_below=1e-3)


@cache
def _found(size: float, *, ripple: float = 0.0, look_further: bool = True) -> MotionEstimate:
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    start = replace(_truth(), bias=np.zeros((4, 3)), shape=np.zeros((4, 6)))
    return estimate_along(
        [_log(size, ripple)], _TREE, start, priors, np.zeros(4), look_further=look_further
    )


def _straight() -> MotionEstimate:
    """The fit of curved sensors with straight axes."""
    return _found(_SIZE, look_further=False)


def test_curved_axes_are_found_as_well_as_stated() -> None:
    found = _found(_SIZE)
    assert found.causes == ("nonlinearity",)
    curvature, deviation = found.curvature
    off = (curvature - _curvature(_SIZE)) / deviation
    assert np.sqrt(np.mean(off[1:] ** 2)) < 1.5
    assert (deviation[1:] < _SIZE).all()


@pytest.mark.parametrize("ripple", [3e-5, 1e-4])
def test_ripples_that_say_more_are_found_before_curved_axes(ripple: float) -> None:
    """They are too fast for slack of places, and less of them was told as elastic joints."""
    assert _found(_SIZE, ripple=ripple).causes == ("ripples", "nonlinearity")


def test_straight_axes_are_left_straight() -> None:
    found = _found(0.0)
    assert found.causes == ()
    assert not found.problem.layout.curves
    for each in found.curvature:
        assert not each.any()


def test_what_curves_are_worth_is_the_same_seen_from_straight_axes_and_from_theirs() -> None:
    found = _found(_SIZE)
    problem, fitted = found.problem, found.fitted
    none = np.zeros(problem.layout.n_joint, dtype=bool)
    there = likeliest_curvature(problem, fitted.equations, none, fitted.state.curvature)
    straight = replace(_straight().fitted.state, curvature=np.zeros((4, 3)))
    predicted = (problem.predict(straight, 0),)
    equations = problem.equations(straight, predicted, fitted.weights)
    from_zero = likeliest_curvature(problem, equations, none)
    assert there.gain > CERTAIN
    assert there.gain == pytest.approx(from_zero.gain, rel=0.1)
    assert there.size == pytest.approx(from_zero.size, rel=0.3)
    assert there.size == pytest.approx(_SIZE, rel=0.5)


def test_equations_hold_the_gradient_in_curvatures() -> None:
    found = _found(_SIZE)
    problem, fitted = found.problem, found.fitted
    state, at = fitted.state, problem.layout.curvature
    off = replace(state, curvature=np.zeros((4, 3)))

    def chi2(curvature: F64) -> float:
        p = problem.predict(replace(off, curvature=curvature), 0)
        return float((fitted.weights[0][..., :3] * p.residual**2)[p.measured].sum()) + (
            problem.prior_chi2(replace(off, curvature=curvature))
        )

    there = problem.predict(off, 0)
    gradient = problem.equations(off, (there,), fitted.weights).su_gradient[:, at]
    for u, axis in ((0, 0), (1, 2), (3, 1)):
        step = np.zeros((4, 3))
        step[u, axis] = 0.1 * _SIZE
        slope = -0.5 * (chi2(step) - chi2(-step)) / (2 * step[u, axis])
        assert gradient[u, axis] == pytest.approx(slope, rel=0.05)


def test_exact_sensors_have_no_curved_axes() -> None:
    problem = _straight().problem
    assert may_be_curved(problem)
    exact = replace(problem.priors, sensors=replace(problem.priors.sensors, scale=0.0))
    assert not may_be_curved(problem.again(priors=exact))
