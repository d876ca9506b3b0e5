"""What the clock of a limb leaves unknown of its lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from synthetic import (
    motion_state,
    random_state,
    readings_along,
    sampled_trajectory,
    serial_tree,
    stays,
)

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.trajectory.ahead import step_along
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.time_scale import of_the_other_clock
from skin2urdf.signals.trajectory import Trajectory

_TREE = replace(serial_tree(4), parent=np.array([-1, 0, -1, 2]))
_TRUTH = replace(
    random_state(np.random.default_rng(3), _TREE, 1, 0.3), up=np.array([[0.0, 0.0, 1.0]])
)
_DRIFT = 1e-3
"""By how much the clock of the second limb's joints gains."""


def _log(publisher: F64) -> Trajectory:
    rng = np.random.default_rng(4)
    q = stays(rng.uniform(-1.5, 1.5, (8, 4)), 100, 200)
    read = readings_along(_TREE, _TRUTH, q)
    read += 1e-3 * rng.standard_normal(read.shape)
    return replace(sampled_trajectory(q, read), publisher=publisher.astype(np.int64))


def _fit(log: Trajectory) -> tuple[MotionProblem, Fitted]:
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    problem = MotionProblem(_TREE, [log], priors)
    return problem, fit(problem, motion_state(_TRUTH, np.zeros(0), priors.sensors.gravity))


def test_lengths_go_with_the_clock_that_is_right() -> None:
    log = _log(np.array([0, 0, 1, 1]))
    problem, fitted = _fit(log)
    # As if the second limb's joints had moved faster, at the same places.
    faster = np.array([1.0, 1.0, 1 + _DRIFT, 1 + _DRIFT])
    _, other = _fit(replace(log, qd=log.qd * faster, qdd=log.qdd * faster**2))
    drift = np.full((1, 4), -_DRIFT)
    (pull,) = of_the_other_clock(problem, fitted, drift)
    step = step_along(fitted, *pull).steps
    expected = problem.layout.moved(fitted.state, *step)
    # Places along the only axis that turns a link show in nothing: readings are compared.
    here, there, told = (
        problem.predict(state, 0).residual for state in (fitted.state, other.state, expected)
    )
    makes = np.sqrt(((there - here) ** 2).mean(axis=(0, 2)))
    misses = np.sqrt(((there - told) ** 2).mean(axis=(0, 2)))
    assert (misses[2:] < 0.05 * makes[2:]).all()
    assert (makes[:2] < 1e-3 * makes[2:]).all()
    assert (misses[:2] < 1e-3 * makes[2:]).all()


def test_of_limbs_of_one_publisher_nothing_is_open() -> None:
    problem, fitted = _fit(_log(np.zeros(4)))
    assert of_the_other_clock(problem, fitted, np.full((1, 4), _DRIFT)) == []


def test_what_feels_joints_of_both_publishers_tells_the_clock() -> None:
    # The second publisher moves the last joint of each limb, and no SU but behind the first's.
    problem, fitted = _fit(_log(np.array([0, 1, 0, 1])))
    assert of_the_other_clock(problem, fitted, np.full((1, 4), _DRIFT)) == []
