"""One small recording and its calibration, made once for all tests that look at results."""

from __future__ import annotations

from functools import cache

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.simulation import Simulation, SimulationSettings, load_robot, simulate


@cache
def simulation() -> Simulation:
    """Three poses of an upright UR5 whose first axis is therefore vertical."""
    settings = SimulationSettings(
        n_poses=3, seed=5, upright=True, gyro="mems", imu_rate=250.0, joint_rate=125.0
    )
    return simulate(load_robot("ur5"), settings)


@cache
def calibration() -> Calibration:
    """What the recording says, without the truth."""
    return calibrate(simulation().recording, CalibrationSettings(gravity_deviation=0.0))
