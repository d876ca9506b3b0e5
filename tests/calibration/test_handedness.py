"""A left-handed SU that gravity turns in a plane alone is found by what accelerates it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from joint_paths import JointPath
from mujoco_robot import random_arm, record, upright

from skin2urdf.calibration.pipeline import calibrate


def test_a_left_handed_su_beyond_one_horizontal_axis_is_named() -> None:
    plain = upright(random_arm(6, 4))
    square = (
        replace(plain.joints[0], rpy=(0.0, 0.0, 0.4), axis=(0.0, 0.0, 1.0)),
        replace(plain.joints[1], rpy=(np.pi / 2, 0.0, 0.0), axis=(0.0, 0.0, 1.0)),
    )
    arm = replace(plain, joints=(*square, *plain.joints[2:]))
    rng = np.random.default_rng(5)
    path = JointPath([0.0] * 4).rest(1.0)
    for pose in rng.uniform(-1.2, 1.2, (24, 4)):
        path.move(pose, 1.0).rest(0.7)
    recording = record(
        arm, path, [f"skin_{n}" for n in range(5)], [f"motor_{n}" for n in range(4)], rng
    )
    streams = list(recording.sus)
    odd = next(u for u, su in enumerate(streams) if su.name == "skin_2")
    streams[odd] = replace(
        streams[odd], specific_force=streams[odd].specific_force * [1.0, -1.0, 1.0]
    )
    found = calibrate(replace(recording, sus=tuple(streams)))
    assert [(fault.kind, fault.subject) for fault in found.faults] == [("mirrored", "skin_2")]
    assert found.misfit < 1.2
    assert found.model.tree.chains()["skin_2"] == ["motor_0", "motor_1"]
