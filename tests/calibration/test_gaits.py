"""Gaits, where all joints swing as one, look like patterns that tell which SU feels which joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from joint_paths import FINE, JointPath
from mujoco_robot import Arm, ArmJoint, record, truth_urdf
from simulated import held_against

from skin2urdf.calibration.pipeline import calibrate

SUS, JOINTS = ("su_a", "su_b", "su_c", "su_d"), ("waist", "neck", "shoulder")
TORSO = Arm(
    (
        ArmJoint((0, 0, 0.1), (0, 0, 0), (0, 0, 1), (-0.01, -0.02, 0.09), (0.3, 0.4, 0.5), 4.0),
        ArmJoint(
            (0.05, -0.05, 0.02), (0, 0, 0), (0, 0, 1), (-0.006, 0.003, 0.05), (1, -0.4, 0.3), 2.0
        ),
        ArmJoint(
            (0.05, -0.04, 0.02), (1.4, 0.5, 0.2), (0, 0, 1), (0.01, -0.01, 0.02), (-1, 0.6, 2), 2.0,
            parent=0,
        ),
    ),
    ((-0.02, 0.005, 0.03), (0.1, 0.2, 0.3)), (0.0, 0.0, 0.0),
)  # fmt: skip
"""A waist, an arm, and a neck of an upright axis 7 cm beside it, whose SU sits 7 mm from that."""


def gait(rng: np.random.Generator, pieces: int) -> JointPath:
    """Swings of all joints at one frequency and twice that, and moves to other places between."""
    path = JointPath([0.0] * 3).rest(1.5)
    phase, size = rng.uniform(0.0, 6.0, (2, 3)), rng.uniform(0.1, 0.5, 3)
    for _ in range(pieces):
        t = np.arange(round(FINE * rng.uniform(5.0, 12.0))) / FINE
        ramp = np.minimum(1.0, np.minimum(t, t[-1] - t))
        turn = 2 * np.pi * 0.8 * t[:, None]
        swing = np.sin(turn + phase[0]) + 0.3 * np.sin(2 * turn + phase[1])
        softly = (ramp**2 * (3 - 2 * ramp))[:, None]
        path.follow(softly * size * rng.uniform(0.6, 1.3) * swing)
        path.rest(0.5).move(rng.uniform(-0.6, 0.6, 3), 1.5).rest(0.5)
    return path


def test_joints_that_swing_as_one_are_told_apart(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    found = calibrate(record(TORSO, gait(rng, 12), SUS, JOINTS, rng, bias=0.2))
    assert held_against(found, truth_urdf(TORSO, SUS, JOINTS), tmp_path).tree_equal
    assert found.quality == "good"
    # The search for faults would have nothing to find, and would take long.
    assert found.seconds.keys().isdisjoint({"what is wrong"})
