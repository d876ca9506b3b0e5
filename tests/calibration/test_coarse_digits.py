"""Accelerometers whose digits are far coarser than their noise, as many cells of skins have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from joint_paths import JointPath
from mujoco_robot import G, random_arm, record, truth_urdf
from simulated import changed_sus, held_against

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.recording.records import SuStream
from skin2urdf.recording.retiming import retimed
from skin2urdf.report.findings import findings

SUS, JOINTS = ("su0", "su1", "su2", "su3"), ("j0", "j1", "j2")
DIGIT = 0.016 * G


def rounded(su: SuStream) -> SuStream:
    return replace(su, specific_force=np.round(su.specific_force / DIGIT) * DIGIT)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_digits_of_ten_times_the_noise_are_neither_slack_nor_drift(
    seed: int, tmp_path: Path
) -> None:
    """All readings of a rest are off alike: not each by itself, of which many would know more."""
    rng = np.random.default_rng(seed)
    arm = random_arm(seed, 3)
    path = JointPath([0.0] * 3).rest(1.0)
    for pose in rng.uniform(-1.4, 1.4, (18, 3)):
        path.move(pose, 2.0).rest(1.0)
    log = retimed(record(arm, path, SUS, JOINTS, rng, noise=1.5e-3 * G))
    found = calibrate(changed_sus(log, rounded))
    assert found.along is not None
    assert not found.along.causes
    assert found.quality == "good"
    errors = held_against(found, truth_urdf(arm, SUS, JOINTS), tmp_path)
    assert errors.tree_equal
    off = np.sqrt(np.mean([su.position.rms**2 for su in errors.sus if su.position]))
    assert off < 2 * findings(found).expected_position
