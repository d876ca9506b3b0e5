"""Slow moves under encoders of 12 bits: the band is narrow, and lengths are known all the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from joint_paths import JointPath
from mujoco_robot import random_arm, record, truth_urdf
from simulated import held_against

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.estimation.uncertainty.observability import aligned_deviations


def test_slow_moves_under_coarse_encoders_tell_lengths(tmp_path: Path) -> None:
    """Through 5 Hz the same recording has errors and stated errors twice as large."""
    n = 4
    arm, rng = random_arm(31, n), np.random.default_rng(31)
    path = JointPath([0.0] * n).rest(1.0)
    for goal in rng.uniform(-0.5, 0.5, (20, n)):
        path.move(goal.tolist()).rest(0.6)
    sus, joints = [f"skin_{k}" for k in range(n + 1)], [f"m{k}" for k in range(n)]
    found = calibrate(record(arm, path, sus, joints, np.random.default_rng(5), bits=12))
    assert found.quality == "good"
    comparison = held_against(found, truth_urdf(arm, sus, joints), tmp_path)
    assert comparison.tree_equal, comparison.tree_differences
    low, high = found.limits.T
    at = np.random.default_rng(0).uniform(low, high, (40, n))
    stated, _ = aligned_deviations(found.estimate, found.observability, at)
    assert comparison.position.rms < 2 * np.sqrt(np.nanmean(stated**2))
    assert comparison.position.rms < 0.4e-3
