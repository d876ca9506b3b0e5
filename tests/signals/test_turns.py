"""Wrapped positions: unwrapped where a log wraps them, and left alone where it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from joint_paths import JointPath

from skin2urdf.arrays import F64
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.motion import joint_motion
from skin2urdf.signals.turns import TURN, unwrapped


def path() -> JointPath:
    """A joint that goes many turns and swings across the seam, and one that hardly moves."""
    path = JointPath([0.0, 0.0]).rest(1.0)
    for goal in (2.9, 9.3, 30.0, -31.0, -np.pi):
        path.move([goal, 0.2], 8.0).rest(1.0).swing({0: 0.4, 1: 0.1}).rest(0.5)
    return path


def wrapped(x: F64, start: float) -> F64:
    return np.asarray((x - start) % TURN + start)


def log(rate: float, start: float | None) -> Recording:
    recording = path().recording(rate)
    if start is None:
        return recording
    joints = tuple(replace(j, position=wrapped(j.position, start)) for j in recording.joints)
    return replace(recording, joints=joints)


@pytest.mark.parametrize("rate", [50.0, 250.0])
@pytest.mark.parametrize("start", [-np.pi, 0.0])
def test_a_wrapped_log_is_the_same_motion_but_for_whole_turns(rate: float, start: float) -> None:
    free, seam = joint_motion(log(rate, None)), joint_motion(log(rate, start))
    turns = (seam.q - free.q) / TURN
    np.testing.assert_allclose(turns, np.round(turns[:1]) * np.ones_like(turns), atol=1e-9)
    np.testing.assert_allclose(seam.qdd, free.qdd, atol=1e-6)
    assert not free.wraps.any()
    assert seam.wraps.tolist() == [True, False]
    np.testing.assert_allclose(seam.noise, free.noise, atol=1e-9)


def test_the_seam_need_not_be_crossed_between_poses_alone() -> None:
    """A pattern that swings across pi jumps back and forth in the log."""
    swing = JointPath([3.1]).rest(1.0).swing({0: 0.2}).rest(1.0).recording()
    (joint,) = swing.joints
    stream, wraps = unwrapped(replace(joint, position=wrapped(joint.position, -np.pi)))
    assert wraps
    np.testing.assert_allclose(stream.position, joint.position, atol=1e-12)


@pytest.mark.parametrize(
    ("position", "rate"),
    [
        (np.repeat([-3.1, 3.1], 100), 2.0),  # a gap in the log, or a very slow one
        (np.repeat([0.0, 3.5], 100), 250.0),  # an encoder that jumps by something else
        ([*np.repeat([-20.0, -20.0 + TURN], 9), 9.0], 250.0),  # not inside one turn
        (np.linspace(-30.0, 30.0, 2000), 250.0),
        (np.zeros(1), 250.0),
    ],
)
def test_other_jumps_and_many_turns_stay_as_they_are(position: F64, rate: float) -> None:
    position = np.asarray(position, dtype=np.float64)
    stream = JointStream("j", np.arange(position.size) / rate, position)
    same, wraps = unwrapped(stream)
    assert not wraps
    np.testing.assert_array_equal(same.position, position)
