"""A log some of whose joints are published on a clock of their own is calibrated like any other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from simulated import held_against, simulation

from skin2urdf.arrays import frozen
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.calibration.settings import CalibrationSettings


def _calibrated(names: tuple[str, ...], late: float) -> Calibration:
    """The UR5 with some joints in messages of their own, halfway between the others."""
    plain = simulation("ur5").recording
    time = plain.joints[0].time
    others, stamps = frozen(time[::2]), frozen(time[1::2] + late)
    joints = tuple(
        replace(j, time=stamps, position=j.position[1::2])
        if j.name in names
        else replace(j, time=others, position=j.position[::2])
        for j in plain.joints
    )
    return calibrate(replace(plain, joints=joints), CalibrationSettings(gravity_deviation=0.0))


def test_a_late_publisher_is_told_and_bends_nothing(tmp_path: Path) -> None:
    names = ("wrist_2_joint", "wrist_3_joint")
    found = _calibrated(names, 0.08)
    ((clock,),) = found.publishers
    assert set(clock.joints) == set(names)
    assert clock.latency == pytest.approx(0.08, abs=max(4 * clock.latency_sd, 5e-5))
    assert found.faults == ()
    assert found.quality == "good"
    compared = held_against(found, simulation("ur5").truth.urdf, tmp_path)
    assert compared.tree_equal
    assert all(su.position is None or su.position.rms < 5e-4 for su in compared.sus)


def test_a_publisher_whose_clock_is_sound_is_not_told() -> None:
    # Readings of some seconds, felt through one vertical axis, propose a clock here.
    found = _calibrated(("shoulder_pan_joint",), 0.0)
    assert found.publishers == ((),)
    assert found.quality == "good"
