"""Sensors with a low-pass look like SUs that came loose, unless all samples are asked."""

from __future__ import annotations

from pathlib import Path

from skin2urdf import calibrate, save
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.simulation.defects import LowPass


def test_sensors_that_are_slow_are_not_loose(tmp_path: Path) -> None:
    settings = SimulationSettings(
        n_poses=2, excite="one", seed=5, imu_rate=250.0, joint_rate=125.0, defects=(LowPass(10.0),)
    )
    recording = simulate(load_robot("ur3"), settings).recording
    found = calibrate(recording, CalibrationSettings(gravity_deviation=0.0))
    assert found.faults == ()
    # An SU that came loose would count as two.
    assert len(found.goodness.by_su.chi2) == len(recording.sus)
    urdf, _ = save(found, tmp_path / "robot.urdf")
    assert urdf.exists()
