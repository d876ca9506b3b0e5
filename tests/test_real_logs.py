"""Logs with the defects that real ones have calibrate as sound ones do, or say what is wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from random_robots import small_arm
from simulated import PATTERNS, changed_joints, changed_sus, held_against, simulation_of

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.writing import write
from skin2urdf.simulation import Simulation


@cache
def sound() -> Simulation:
    return simulation_of(small_arm(3), excite="all", seed=3, imu_rate=250.0)


@cache
def calibrated() -> Calibration:
    """The recording as it is."""
    return calibrate(sound().recording)


def position_error(found: Calibration, folder: Path) -> float:
    """Error of the SUs' positions [m] after the tree is found right."""
    comparison = held_against(found, sound().truth.urdf, folder)
    assert comparison.tree_equal, comparison.tree_differences
    return comparison.position.rms


@pytest.mark.parametrize("times", [2, 5])
def test_readings_that_are_sent_several_times(times: int, tmp_path: Path) -> None:
    """As exact as their number allows: with a fifth of the readings, sqrt(5) times the error."""

    def held(su: SuStream) -> SuStream:
        number = np.arange(len(su.time)) // times * times
        return replace(su, specific_force=su.specific_force[number])

    recording = changed_sus(sound().recording, held)
    whole = position_error(calibrated(), tmp_path)
    assert position_error(calibrate(recording), tmp_path) < 2 * np.sqrt(times) * whole


def test_spikes_and_a_clock_that_is_set_change_nothing(tmp_path: Path) -> None:
    """0.1 % of the readings are 1e5 m/s^2, and all stamps are an hour later from the middle on."""
    rng = np.random.default_rng(0)
    middle = sound().recording.duration / 2

    def spiked(su: SuStream) -> SuStream:
        force = su.specific_force.copy()
        force[rng.random(len(force)) < 1e-3] = 1e5
        return replace(su, time=_set(su.time, middle), specific_force=force)

    def late(joint: JointStream) -> JointStream:
        return replace(joint, time=_set(joint.time, middle))

    path = tmp_path / "log.mcap"
    write(changed_joints(changed_sus(sound().recording, spiked), late), path)
    recording = read(path)
    assert recording.duration < sound().recording.duration + 5.0
    whole = position_error(calibrated(), tmp_path)
    assert position_error(calibrate(recording), tmp_path) < 1.5 * whole


def _set(time: np.ndarray, when: float) -> np.ndarray:
    return time + np.where(time > when, 3600.0, 0.0)


def test_limits_are_what_was_measured_however_long_nothing_was() -> None:
    """No message while the robot moves fastest: what a curve would do in between is no limit."""
    recording = sound().recording
    time, fastest = _fastest(recording)
    gap = (time > fastest - 0.6) & (time < fastest + 0.6)
    late = np.where(time > fastest, 20.0, 0.0)
    assert 0.005 < gap.mean() < 0.3

    def cut(joint: JointStream) -> JointStream:
        return replace(joint, time=(time + late)[~gap], position=joint.position[~gap])

    def cut_su(su: SuStream) -> SuStream:
        inside = np.abs(su.time - fastest) < 0.6
        moved = su.time + np.where(su.time > fastest, 20.0, 0.0)
        return replace(su, time=moved[~inside], specific_force=su.specific_force[~inside])

    found = calibrate(changed_joints(changed_sus(recording, cut_su), cut), PATTERNS)
    measured = {j.name: j.position[~gap] for j in recording.joints}
    for name, (low, high) in zip(found.model.tree.joint_names, found.limits, strict=True):
        assert measured[name].min() - 1e-3 < low < high < measured[name].max() + 1e-3


def _fastest(recording: Recording) -> tuple[np.ndarray, float]:
    """Times of the joints' samples, and when the joints move fastest [s]."""
    time = recording.joints[0].time
    assert all(np.array_equal(joint.time, time) for joint in recording.joints)
    speed = sum(np.abs(np.gradient(joint.position, time)) for joint in recording.joints)
    return time, float(time[int(np.argmax(np.convolve(speed, np.ones(60), "same")))])
