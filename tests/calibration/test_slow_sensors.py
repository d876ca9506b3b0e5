"""Sensors with a low-pass look like SUs that came loose, until all samples tell."""

from __future__ import annotations

from pathlib import Path

from skin2urdf import calibrate, save
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.simulation.defects import LowPass


def test_what_is_taken_back_leaves_the_parts_of_the_tree(tmp_path: Path) -> None:
    settings = SimulationSettings(
        n_poses=4, excite="one", seed=5, imu_rate=250.0, joint_rate=125.0, defects=(LowPass(10.0),)
    )
    recording = simulate(load_robot("ur3"), settings).recording
    found = calibrate(recording, CalibrationSettings(gravity_deviation=0.0))
    assert found.faults == ()
    # An SU that seemed to have come loose counted as two.
    assert len(found.goodness.by_su.chi2) == len(recording.sus)
    urdf, _ = save(found, tmp_path / "robot.urdf")
    assert urdf.exists()
