"""Gears with play whose links do not lie where loads alone would have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from joint_paths import JointPath
from mujoco_robot import random_arm, record, truth_urdf
from simulated import held_against

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.report.findings import findings


def test_gaps_that_friction_crosses_are_not_told_by_loads(tmp_path: Path) -> None:
    """Gaps by loads explain less than half, and leave SUs off by three times what they state."""
    arm, rng = random_arm(42, 4), np.random.default_rng(42)
    path = JointPath([0.0] * 4).rest(1.0)
    for goal in rng.uniform(-1.2, 1.2, (40, 4)):
        path.move(goal.tolist()).rest(0.6)
    sus, joints = [f"skin_{k}" for k in range(5)], [f"m{k}" for k in range(4)]
    gaps = (4.8e-3, 1.5e-3, 2.1e-3, 4.2e-3)
    log = record(arm, path, sus, joints, np.random.default_rng(5), bits=14, gaps=gaps)
    found = calibrate(log, CalibrationSettings(gravity_deviation=0.0))
    assert found.along is not None
    assert "play" not in found.along.causes
    comparison = held_against(found, truth_urdf(arm, sus, joints), tmp_path)
    assert comparison.tree_equal, comparison.tree_differences
    assert comparison.position.rms < 2 * findings(found).expected_position
