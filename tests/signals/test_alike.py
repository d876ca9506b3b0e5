"""Joints that are multiples of each other all along are named, and no others."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.alike import joints_moved_alike
from skin2urdf.signals.motion import Motion, joint_motion

TIME = np.arange(3000) / 100.0
STEP = 2 * np.pi / 2**12


def motion_of(**positions: object) -> Motion:
    rounded = {name: STEP * np.rint(np.asarray(q) / STEP) for name, q in positions.items()}
    joints = tuple(JointStream(name, TIME, q) for name, q in rounded.items())
    return joint_motion(Recording(joints=joints, sus=()))


def test_fingers_of_one_drive_are_alike() -> None:
    finger = 0.4 * (1 - np.cos(0.8 * TIME))
    arm = np.sin(0.5 * TIME)
    motion = motion_of(arm=arm, finger_1=finger, finger_2=0.3 - 0.5 * finger, wrist=np.cos(TIME))
    assert joints_moved_alike([motion]) == (("finger_1", "finger_2"),)


def test_what_one_log_has_alike_another_may_tell_apart() -> None:
    q = np.sin(0.7 * TIME)
    together, apart = motion_of(a=q, b=2 * q), motion_of(a=q, b=np.cos(0.4 * TIME))
    assert joints_moved_alike([together]) == (("a", "b"),)
    assert joints_moved_alike([together, apart]) == ()


@pytest.mark.parametrize("other", [np.zeros(len(TIME)), 2 * STEP * np.sin(0.7 * TIME)])
def test_joints_that_stay_are_like_none(other: object) -> None:
    assert joints_moved_alike([motion_of(a=np.sin(0.7 * TIME), b=other)]) == ()
