"""Sensors with a low-pass are found to have one, whatever the way to it is like."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from random_robots import Joint, robot_of

from skin2urdf import calibrate
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.defects import LowPass
from skin2urdf.simulation.robots import SkinLayout

ARM = (
    Joint("first", -1, "revolute", rpy=(1.2, 0.3, 0.0)),
    Joint("second", 0, "revolute", xyz=(0.3, 0.0, 0.1), rpy=(1.4, 0.0, 0.0)),
    Joint("third", 1, "revolute", xyz=(0.4, 0.0, 0.0), rpy=(0.2, 0.5, 0.0)),
)


def test_filters_of_second_order_are_found(tmp_path: Path) -> None:
    cutoff = 10.0
    settings = SimulationSettings(
        n_poses=4, seed=5, imu_rate=250.0, joint_rate=125.0, defects=(LowPass(cutoff, 2),)
    )
    simulation = simulate(robot_of(ARM, tmp_path, SkinLayout(1, 0)), settings)
    along = calibrate(simulation.recording, CalibrationSettings(gravity_deviation=0.0)).along
    assert along is not None
    found = along.fitted.state.front[:, 1]
    np.testing.assert_allclose(found[1:], (2 * np.pi * cutoff) ** -2, rtol=0.1)
