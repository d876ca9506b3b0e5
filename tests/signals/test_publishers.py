"""Clocks of publishers of joint states, on recordings with joints in messages of their own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_robots import Joint, robot_of
from sensitive.logs import published_apart
from simulated import simulation

from skin2urdf.recording.records import Recording
from skin2urdf.signals.motion import joint_motion, publishers_beyond_first
from skin2urdf.signals.publishers import (
    all_that_are_off,
    joint_clocks,
    on_one_clock,
    together,
)
from skin2urdf.signals.records import JointClock
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout

_WRIST = ("wrist_2_joint", "wrist_3_joint")


def _beyond_first(recording: Recording) -> list[tuple[str, ...]]:
    motion = joint_motion(recording)
    others = publishers_beyond_first(motion.publisher, motion.moved)
    return [tuple(motion.dof_names[j] for j in joints) for joints in others]


def test_joints_of_one_publisher_have_the_same_stamps() -> None:
    recording = simulation("ur5").recording
    assert _beyond_first(published_apart(recording, _WRIST, 0.0)) == [_WRIST]
    assert _beyond_first(recording) == []


def test_a_joint_that_lacks_values_has_no_publisher_of_its_own() -> None:
    recording = simulation("ur5").recording
    first, *others = recording.joints
    kept = np.arange(len(first.time)) % 7 != 3
    short = replace(first, time=first.time[kept], position=first.position[kept])
    assert _beyond_first(replace(recording, joints=(short, *others))) == []


def test_a_sound_publisher_has_no_clock_to_set() -> None:
    assert joint_clocks(published_apart(simulation("ur5").recording, _WRIST, 0.0)) == ()


@pytest.mark.parametrize(
    ("names", "late", "drift"),
    [
        (_WRIST, 0.3, 0.0),
        (_WRIST, -0.5, 1e-3),
        (("shoulder_pan_joint", "elbow_joint"), 0.15, -3e-3),
    ],
)
def test_a_late_publisher_is_found(names: tuple[str, ...], late: float, drift: float) -> None:
    (clock,) = joint_clocks(published_apart(simulation("ur5").recording, names, late, drift))
    assert set(clock.joints) == set(names)
    assert clock.latency == pytest.approx(late, abs=0.035)
    half = 0.5 * float(np.ptp(simulation("ur5").recording.joints[0].time))
    assert clock.drift * half == pytest.approx(drift * half, abs=0.035)


def test_a_late_publisher_is_set_right() -> None:
    plain = published_apart(simulation("ur5").recording, _WRIST, 0.0)
    late = published_apart(simulation("ur5").recording, _WRIST, 0.2, 1e-3)
    time = simulation("ur5").recording.joints[0].time
    middle = float(time[0] + time[-1]) / 2
    clock = JointClock(_WRIST, 0.2, 0.0, 1e-3, 0.0, middle)
    for mended, true in zip(on_one_clock(late, [clock]).joints, plain.joints, strict=True):
        np.testing.assert_allclose(mended.time, true.time, atol=1e-9)
    assert _beyond_first(on_one_clock(late, [clock])) == [_WRIST]


def test_what_is_left_of_a_clock_adds_to_what_was_found() -> None:
    first = JointClock(("a",), 0.3, 0.01, 1e-3, 1e-4, 50.0)
    then = JointClock(("a",), -0.02, 1e-5, 2e-4, 1e-7, 51.0)
    other = JointClock(("b",), 0.0, 1.0, 0.0, 1.0, 50.0)
    whole, unsure = together([first], [then, other])
    time = np.linspace(0.0, 100.0, 5)
    np.testing.assert_allclose(whole.stamped(time), first.stamped(then.stamped(time)), atol=1e-12)
    assert (whole.latency_sd, whole.drift_sd) == (1e-5, 1e-7)
    assert unsure is other
    assert all_that_are_off([[first]], [[then, other]]) == ((whole,),)


def test_two_arms_of_which_no_su_feels_both_tell_no_clock(tmp_path: Path) -> None:
    arms = [
        (Joint(f"{side}_1", -1, "revolute", rpy=(1.2, 0.3, 0.0)),
         Joint(f"{side}_2", first, "revolute", xyz=(0.3, 0.0, 0.1), rpy=(1.4, 0.0, 0.0)))
        for side, first in (("left", 0), ("right", 2))
    ]  # fmt: skip
    robot = robot_of([*arms[0], *arms[1]], tmp_path, SkinLayout(1, 1))
    settings = SimulationSettings(n_poses=4, seed=2, excite="one", imu_rate=250, joint_rate=125)
    recording = simulate(robot, settings).recording
    right = ("right_1", "right_2")
    assert joint_clocks(published_apart(recording, right, 0.1, 3e-4)) == ()
