"""Sensors with a low-pass are found to have one, whatever the way to it is like."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_robots import Joint, robot_of

from skin2urdf import calibrate
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.trajectory.fit import fit
from skin2urdf.estimation.trajectory.impossible_fronts import with_possible_fronts
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.defects import LowPass
from skin2urdf.simulation.robots import SkinLayout

ARM = (
    Joint("first", -1, "revolute", rpy=(1.2, 0.3, 0.0)),
    Joint("second", 0, "revolute", xyz=(0.3, 0.0, 0.1), rpy=(1.4, 0.0, 0.0)),
    Joint("third", 1, "revolute", xyz=(0.4, 0.0, 0.0), rpy=(0.2, 0.5, 0.0)),
)


CUTOFF = 10.0
R = (2 * np.pi * CUTOFF) ** -2
"""Of a filter of second order [s^2]; p is twice that."""


@pytest.fixture(scope="module")
def along(tmp_path_factory: pytest.TempPathFactory) -> MotionEstimate:
    """Of an arm whose sensors have a filter of second order."""
    settings = SimulationSettings(
        n_poses=4, seed=5, imu_rate=250.0, joint_rate=125.0, defects=(LowPass(CUTOFF, 2),)
    )
    folder: Path = tmp_path_factory.mktemp("arm")
    simulation = simulate(robot_of(ARM, folder, SkinLayout(1, 0)), settings)
    found = calibrate(simulation.recording, CalibrationSettings(gravity_deviation=0.0)).along
    assert found is not None
    return found


def test_filters_of_second_order_are_found(along: MotionEstimate) -> None:
    np.testing.assert_allclose(along.fitted.state.front[1:, 1], R, rtol=0.1)


def test_no_sensor_droops_without_a_lag(along: MotionEstimate) -> None:
    """What an SU on a first joint feels has another optimum, with a lever arm that is too short."""
    problem, state = along.problem, along.fitted.state
    front = np.array(state.front)
    front[0] = -0.05 * R, -0.15 * R
    astray = fit(problem, replace(state, front=front), near=True)
    p, r = astray.state.front[0]
    assert r - 0.5 * p < -0.05 * R
    p, r = with_possible_fronts(problem, astray, 30)[1].state.front[0]
    assert r == pytest.approx(R, rel=0.3)
    assert p == pytest.approx(2 * R, rel=0.3)
