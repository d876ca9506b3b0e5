"""Sensors whose errors the samples show tell how good those are whose errors they do not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from synthetic import RATE, random_state, sampled_trajectory, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State, identifiable
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.uncertainty.observability import Subject, observability_along
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import first_derivative, second_derivative

_TREE = serial_tree(4)
_GIVEN = Priors()
_UP = np.array([0.0, 0.0, 1.0])


@cache
def _truth(cross: float) -> State:
    """A robot whose first SU only one joint turns, with sensors of so large cross-axis errors."""
    rng = np.random.default_rng(3)
    state = replace(random_state(rng, _TREE, 1, 0.3), up=_UP[None])
    shape = np.zeros((4, 6))
    shape[:, 3:] = cross * rng.standard_normal((4, 3))
    return replace(state, bias=0.03 * rng.standard_normal((4, 3)), shape=shape)


@cache
def _found(cross: float, alike: bool) -> MotionEstimate:
    rng, truth = np.random.default_rng(4), _truth(cross)
    t = np.arange(round(60 * RATE)) / RATE
    rates, phases = rng.uniform(0.5, 8.0, (6, 4)), rng.uniform(0, 6, (6, 4))
    q = (0.6 / rates * np.sin(rates * t[:, None, None] + phases)).sum(axis=1)
    ways = q, first_derivative(q, RATE), second_derivative(q, RATE)
    ideal = specific_forces(truth.model(_TREE), *ways, 9.81 * _UP)
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
    log = sampled_trajectory(q, read + 1e-2 * rng.standard_normal(read.shape))
    priors = motion_priors(_GIVEN, gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    start = replace(truth, bias=np.zeros((4, 3)), shape=np.zeros((4, 6)))
    return estimate_along([log], _TREE, start, priors, np.zeros(4), alike=alike)


def _first_axis(state: State) -> F64:
    """(3,) the first joint's axis as the first SU sees it, which no choice of frames changes."""
    return np.asarray(state.T_joint_su[0, :3, :3].T[:, 2])


def _off(found: MotionEstimate, cross: float) -> float:
    """By how much the first SU is tilted against its axis, more than in truth [rad]."""
    return float(np.linalg.norm(np.cross(_first_axis(found.state), _first_axis(_truth(cross)))))


def _stated(found: MotionEstimate) -> float:
    """The same as it is stated, whatever cross-axis errors hide."""
    sensors = replace(found.problem.priors.sensors, hidden=0.0)
    q, free = found.problem.logs[0].q[:: round(RATE)], identifiable(_TREE, 1, True)
    subject = Subject(_TREE, found.state, free, q, sensors, sensors)
    T, C = found.state.T_joint_su[0], observability_along(subject, found.information)
    tilts = T[:2, :3] @ C.su_covariance[0, 3:, 3:]
    return float(np.sqrt(np.trace(tilts @ T[:2, :3].T)))


def test_a_tilt_that_its_sensor_hides_is_known_by_the_other_sensors() -> None:
    alone, alike = (_found(0.0, each) for each in (False, True))
    assert _stated(alike) < 0.3 * _stated(alone)
    for found in (alone, alike):
        assert _off(found, 0.0) < 2.5 * _stated(found)
    # What the samples determine is what it was.
    np.testing.assert_allclose(alike.state.bias[2:], alone.state.bias[2:], atol=1e-3)


@pytest.mark.parametrize("cross", [3e-4, 3e-3])
def test_sensors_are_not_taken_to_be_better_than_the_others_are(cross: float) -> None:
    found = _found(cross, alike=True)
    learnt = found.problem.priors.sensors
    assert 0.5 * cross < learnt.cross < 3 * cross
    assert 0.015 < learnt.bias < 0.09
    assert learnt.scale < 0.1 * _GIVEN.scale
    assert _off(found, cross) < 2.5 * _stated(found)
