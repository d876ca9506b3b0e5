"""Sensors whose scale drifts as they warm up: followed, and told from a base that moves."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from synthetic import RATE, random_state, readings_along, sampled_trajectory, serial_tree, stays

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory import estimate
from skin2urdf.estimation.trajectory.creeping import creeping
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.moving_base import MovingBase
from skin2urdf.estimation.trajectory.priors import motion_priors, prior_information
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import first_derivative, second_derivative

_TREE = serial_tree(3)
_BIAS, _SCALE = 0.03, 5e-3
"""What axes read more or less when the log ends [m/s^2], and per what they read."""


@cache
def _truth() -> State:
    rng = np.random.default_rng(5)
    state = random_state(rng, _TREE, 1, 0.1)
    return replace(state, up=np.array([[0.0, 0.0, 1.0]]))


def _signs(of: int) -> F64:
    """(3, 3) up or down, of each axis of each SU."""
    return np.random.default_rng(of).choice([-1.0, 1.0], (3, 3))


@cache
def _found(scale: float = _SCALE, slips: float = 0.0) -> MotionEstimate:
    """Forty places in two minutes of warming up, and a coupling that slips by so much per way."""
    rng = np.random.default_rng(2)
    q = stays(rng.uniform(-1.5, 1.5, (40, 3)), 180, 120)
    warm = np.expm1(-np.arange(len(q)) / len(q) / 0.5) / np.expm1(-2.0)
    read = readings_along(_TREE, _truth(), q)
    read *= 1 + scale * warm[:, None, None] * _signs(1)
    read += _BIAS * warm[:, None, None] * _signs(2)
    read += 1e-2 * rng.standard_normal(read.shape)
    way = np.cumsum(np.abs(np.diff(q[:, 1], prepend=q[0, 1])))
    log = sampled_trajectory(q + slips * way[:, None] * [0.0, 1.0, 0.0], read, still_below=1e-3)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    return estimate_along([log], _TREE, _truth(), priors, np.zeros(3))


def test_scales_that_drift_are_followed_beside_biases() -> None:
    found = _found()
    assert found.causes == ("drift", "warming")
    # Of biases alone five times as much is left as noise makes.
    assert found.misfit < 1.2 < 2.0 < found.tried["drift"]
    assert found.scale_drifts[1:] == pytest.approx(_SCALE, rel=0.3)


def test_zeros_that_creep_are_found_beside_biases_that_drift() -> None:
    found = _found(scale=0.0, slips=2e-4)
    assert found.causes == ("drift", "creep")
    assert found.misfit < 1.2


def test_sensors_that_warm_up_together_are_no_base_that_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One of them on the base may seem to feel what all others do, and be explained as well."""

    def felt(
        problem: MotionProblem, fitted: Fitted, **_: bool
    ) -> tuple[MotionProblem, Fitted, MovingBase]:
        motion = creeping(problem.tree, problem.logs)
        assert motion is not None
        none = tuple(np.zeros_like(log.readings) for log in problem.logs)
        seeming = MovingBase(np.array([0]), ("su0",), motion, np.array([0.02]), none, False)
        return problem, fitted, seeming

    monkeypatch.setattr(estimate, "standing_still", felt)
    found = _found.__wrapped__()
    assert found.causes == ("drift", "warming")
    assert found.moving_base is None


def test_equations_hold_the_gradient_in_what_scales_change_by() -> None:
    problem, fitted = _found().problem, _found().fitted
    state = fitted.state
    off = replace(state, warming=np.full_like(state.warming, 1e-3))

    def chi2(warming: F64) -> float:
        p = problem.predict(replace(off, warming=warming), 0)
        weighed = float((fitted.weights[0][..., :3] * p.residual**2)[p.measured].sum())
        return weighed + problem.prior_chi2(replace(off, warming=warming))

    predicted = (problem.predict(off, 0),)
    equations = problem.equations(off, predicted, fitted.weights)
    at, rng = problem.layout.warming(0), np.random.default_rng(0)
    for _ in range(3):
        way = rng.standard_normal(off.warming.shape)
        slope = (chi2(off.warming + 1e-5 * way) - chi2(off.warming - 1e-5 * way)) / 2e-5
        own = float((equations.su_gradient[:, at] * way[0].reshape(3, -1)).sum())
        # An axis reads nearly what a perfect sensor does, which derivatives have.
        assert slope == pytest.approx(-2 * own, rel=1e-2)


def _of_two_logs(apart: float) -> MotionEstimate:
    """Two minutes on a base that is tilted for the second one, with other biases by then."""
    rng = np.random.default_rng(4)
    tilted = np.array([0.3, -0.2, np.sqrt(1 - 0.3**2 - 0.2**2)])
    truth = replace(_truth(), up=np.stack([_truth().up[0], tilted]))
    logs = []
    for g in range(2):
        q = stays(rng.uniform(-1.5, 1.5, (12, 3)), 180, 120)
        qd, qdd = first_derivative(q, RATE), second_derivative(q, RATE)
        ideal = specific_forces(truth.model(_TREE), q, qd, qdd, 9.81 * truth.up[g])
        read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
        read += apart * g * rng.standard_normal((3, 3))
        read += 1e-2 * rng.standard_normal(read.shape)
        logs.append(replace(sampled_trajectory(q, read, still_below=1e-3), log=g))
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    return estimate_along(logs, _TREE, truth, priors, np.zeros(3))


def test_sensors_that_were_switched_on_anew_may_have_any_bias() -> None:
    found = _of_two_logs(0.03)
    assert found.causes == ("drift",)
    problem, layout = found.problem, found.problem.layout
    seconds = [float(log.time[-1] - log.time[0]) for log in problem.logs]
    _, su, _, _ = prior_information(problem.priors, layout, seconds, found.fitted.state)
    for g, n in enumerate(layout.n_knots):
        own = su[:, layout.knots(g), layout.knots(g)].reshape(-1, n, 3, n, 3)
        # Of x in all knots alike.
        known = own[:, :, 0, :, 0].sum(axis=(1, 2))
        np.testing.assert_allclose(known, problem.priors.sensors.bias**-2, rtol=1e-6)
