"""A log some of whose joints are published on a clock of their own is calibrated like any other."""

from __future__ import annotations

from pathlib import Path

import pytest
from random_robots import small_arm
from sensitive.logs import published_apart
from simulated import held_against, simulation_of

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.signals.publishers import joint_clocks

SETTINGS = CalibrationSettings(gravity_deviation=0.0)


def test_a_late_publisher_is_told_and_bends_nothing(tmp_path: Path) -> None:
    names = ("j2", "j3")
    made = simulation_of(small_arm(4), n_poses=2, excite="all")
    found = calibrate(published_apart(made.recording, names, 0.08), SETTINGS)
    ((clock,),) = found.publishers
    assert set(clock.joints) == set(names)
    assert clock.latency_sd < 1e-4
    assert clock.latency == pytest.approx(0.08, abs=max(4 * clock.latency_sd, 5e-5))
    assert found.faults == ()
    assert found.quality == "good"
    compared = held_against(found, made.truth.urdf, tmp_path)
    assert compared.tree_equal
    assert all(su.position is None or su.position.rms < 5e-4 for su in compared.sus)


def test_a_publisher_whose_clock_is_sound_is_not_told() -> None:
    made = simulation_of(small_arm(4), upright=True)
    recording = published_apart(made.recording, ("j3",), 0.0)
    # Readings of some seconds propose a clock here, which all samples do not confirm.
    assert joint_clocks(recording)
    found = calibrate(recording, SETTINGS)
    assert found.publishers == ((),)
    assert found.quality == "good"
