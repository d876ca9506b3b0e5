"""One small recording and its calibration, made once for all tests that look at results."""

from __future__ import annotations

import time
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Run:
    """A calibration as its caller sees it.

    Attributes:
        result: what the recording says, without the truth.
        told: stages and the share that was done of each, as they were told.
        seconds: time that passed [s].
    """

    result: Calibration
    told: tuple[tuple[str, float], ...]
    seconds: float


@cache
def run() -> Run:
    """The calibration of :func:`simulation`, watched."""
    told: list[tuple[str, float]] = []
    recording, settings = simulation().recording, CalibrationSettings(gravity_deviation=0.0)
    begin = time.perf_counter()
    found = calibrate(
        recording, settings, progress=lambda stage, share: told.append((stage, share))
    )
    return Run(found, tuple(told), time.perf_counter() - begin)


def calibration() -> Calibration:
    """What the recording says, without the truth."""
    return run().result
