"""Coarse encoders: the band is narrow, and lengths are known all the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from joint_paths import JointPath
from mujoco_robot import random_arm, record, truth_urdf
from simulated import held_against

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.simulation import SimulationSettings, load_robot, simulate


def stated(found: Calibration) -> float:
    """Position error that is stated, rms over configurations and SUs [m]."""
    low, high = found.limits.T
    at = np.random.default_rng(0).uniform(low, high, (40, len(low)))
    position, _ = aligned_deviations(found.estimate, found.observability, at)
    return float(np.sqrt(np.nanmean(position**2)))


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
    assert comparison.position.rms < 2 * stated(found)
    assert comparison.position.rms < 0.4e-3


def test_drives_that_give_way_within_a_step_are_no_base_that_does(tmp_path: Path) -> None:
    """Held joints yield to the pattern of another one, and encoders show none or one step of it."""
    settings = SimulationSettings(seed=490100, n_poses=8, encoder_bits=13)
    simulation = simulate(load_robot("panda"), settings)
    found = calibrate(simulation.recording, CalibrationSettings(gravity_deviation=0.0))
    assert found.along is not None
    assert found.along.causes == ()
    right = held_against(found, simulation.truth.urdf, tmp_path)
    assert right.tree_equal, right.tree_differences
    assert right.position.rms < 2 * stated(found)
