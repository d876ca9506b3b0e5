"""Robots that MuJoCo moves without a rest, and patterns that begin at once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from joint_paths import JointPath
from mujoco_robot import Arm, random_arm, record, truth_urdf
from simulated import held_against

from skin2urdf.arrays import F64, Bool
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.hypotheses.corrected import Corrected
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.clocks import su_clocks
from skin2urdf.signals.motion import joint_motion
from skin2urdf.signals.poses import find_rests
from skin2urdf.signals.records import EncoderError
from skin2urdf.urdf.records import Comparison

SEED = 21


def names(arm: Arm) -> tuple[list[str], list[str]]:
    return [f"skin_{n}" for n in range(arm.n_joints + 1)], [f"m{n}" for n in range(arm.n_joints)]


def on_the_way(recording: Recording, begin: float, end: float) -> Recording:
    """The part of a recording between two times."""

    def inside(time: F64) -> Bool:
        return np.asarray((time > begin) & (time < end))

    joints = tuple(
        replace(j, time=j.time[inside(j.time)], position=j.position[inside(j.time)])
        for j in recording.joints
    )
    return replace(recording, joints=joints, sus=tuple(s.at(inside(s.time)) for s in recording.sus))


def restless(n_joints: int) -> tuple[Arm, Recording]:
    """All joints swing far, at once and slowly, and none of it is a rest."""
    arm = random_arm(SEED, n_joints)
    sizes = dict(enumerate(np.array([2.2, -1.9, 2.4, -2.1, 2.3])[:n_joints]))
    path = JointPath([0.0] * n_joints).swing(sizes, seconds=110.0, hertz=0.11)
    sus, joints = names(arm)
    whole = record(arm, path, sus, joints, np.random.default_rng(5))
    return arm, on_the_way(whole, 20.0, 90.0)


def compared(arm: Arm, found: Calibration, folder: Path) -> Comparison:
    return held_against(found, truth_urdf(arm, *names(arm)), folder)


def test_a_robot_that_never_rests_is_calibrated(tmp_path: Path) -> None:
    arm, recording = restless(3)
    assert not find_rests(joint_motion(recording))
    found = calibrate(recording)
    comparison = compared(arm, found, tmp_path)
    assert comparison.tree_equal, comparison.tree_differences
    assert found.quality in ("good", "fair")
    assert not found.faults
    low, high = found.limits.T
    at = np.random.default_rng(0).uniform(low, high, (40, arm.n_joints))
    stated, _ = aligned_deviations(found.estimate, found.observability, at)
    assert comparison.position.rms < 2 * np.sqrt(np.nanmean(stated**2))
    assert comparison.position.rms < 1e-3


def test_motion_after_the_only_rest_tells_positions(tmp_path: Path) -> None:
    """Filters reach across all of that rest, which is no reason to leave the motion out."""
    arm = random_arm(SEED, 3)
    path = JointPath([0.0] * 3).swing({0: 1.6, 1: -1.8, 2: 2.0}, seconds=40.0, hertz=0.3)
    whole = record(arm, path, *names(arm), np.random.default_rng(2))
    recording = on_the_way(whole, 3.0, 34.0)
    assert len(find_rests(joint_motion(recording))) == 1
    found = calibrate(recording)
    assert found.quality == "good"
    assert compared(arm, found, tmp_path).position.rms < 1e-3


def test_motion_that_spans_all_readings_tells_no_clock_wrong() -> None:
    """Any slow reading is a sum of slow joints' positions, whatever its lag."""
    _, recording = restless(5)
    assert su_clocks(recording.sus, joint_motion(recording)) == ()


def test_patterns_that_begin_at_once_are_no_hits(tmp_path: Path) -> None:
    """A step of the velocity that a drive is told holds more than is sampled."""
    D = 4
    arm = random_arm(SEED + 1, D)
    rng = np.random.default_rng(6)
    path = JointPath([0.0] * D).rest(1.0)
    for joint in range(D):
        path.move(0.8 * np.eye(D)[joint], 1.2).rest(0.7).move([0.0] * D, 1.2).rest(0.7)
    for pose in rng.uniform(-1.3, 1.3, (4, D)):
        path.move(pose, 2.0).rest(1.0)
        for joint in range(D):
            path.abrupt(joint, 0.1, seconds=2.0, hertz=2.0).rest(0.5)
    sus, joints = names(arm)
    found = calibrate(record(arm, path, sus, joints, rng, lag=0.0))
    comparison = compared(arm, found, tmp_path)
    assert comparison.tree_equal
    assert [fault.kind for fault in found.faults] == []


def moves(jump: float) -> Recording:
    """An arm that goes from place to place, of which one encoder's zero jumps on its way."""
    arm = random_arm(SEED, 3)
    rng = np.random.default_rng(4)
    path = JointPath([0.0] * 3).rest(1.0)
    for _ in range(16):
        path.move(rng.uniform(-1.2, 1.2, 3), 1.5).rest(0.7)
    whole = record(arm, path, *names(arm), rng)

    def jumped(joint: JointStream) -> JointStream:
        later = joint.time > whole.duration / 2
        moved = joint.name == "m1"
        return replace(joint, position=joint.position + jump * later) if moved else joint

    return replace(whole, joints=tuple(map(jumped, whole.joints)))


def test_an_encoder_that_jumps_between_moves_is_named(tmp_path: Path) -> None:
    found = calibrate(moves(0.05))
    (fault,) = found.faults
    assert (fault.kind, fault.subject) == ("encoder jump", "m1")
    assert fault.size == pytest.approx(0.05, abs=2e-3)
    comparison = compared(random_arm(SEED, 3), found, tmp_path)
    assert comparison.tree_equal
    assert comparison.position.rms < 2e-3


def test_readings_have_the_last_word_about_a_leap(monkeypatch: pytest.MonkeyPatch) -> None:
    leap = Corrected(EncoderError("offset", "m1", 0.05, 0, 20.0))
    monkeypatch.setattr("skin2urdf.calibration.beginning.evident_errors", lambda _: (leap,))
    found = calibrate(moves(0.0))
    assert not found.faults
    assert found.quality == "good"
