"""The noise of encoders makes no sensor slow, and no clock late."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_robots import Joint, robot_of

from skin2urdf import calibrate
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.trajectory.estimate import MotionEstimate
from skin2urdf.estimation.trajectory.front_end import droop
from skin2urdf.estimation.trajectory.shaken import Shaken
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout

ARM = (
    Joint("first", -1, "revolute", rpy=(1.2, 0.3, 0.0)),
    Joint("second", 0, "revolute", xyz=(0.3, 0.0, 0.1), rpy=(1.4, 0.0, 0.0)),
    Joint("third", 1, "revolute", xyz=(0.4, 0.0, 0.0), rpy=(0.2, 0.5, 0.0)),
)


def along_of(folder: Path, **changes: Any) -> MotionEstimate:
    layout = SkinLayout(sus_per_segment=1, sus_on_base=0)
    plain: dict[str, Any] = {"n_poses": 4, "seed": 5, "imu_rate": 250.0, "joint_rate": 125.0}
    settings = SimulationSettings(**(plain | changes))
    simulation = simulate(robot_of(ARM, folder, layout), settings)
    along = calibrate(simulation.recording, CalibrationSettings(gravity_deviation=0.0)).along
    assert along is not None
    return along


@pytest.mark.usefixtures("through_the_patterns_band")
def test_coarse_encoders_make_no_clock_late(tmp_path: Path) -> None:
    along = along_of(tmp_path, seed=6, excite="all", encoder_bits=13)
    # Where a low-pass may cut noise off, all three are off by more than 1.7 ms.
    assert np.abs(along.fitted.state.clock[0, :, 0]).max() < 3e-4
    # Where what is left of it around rests, which count for most, passes for none, 2e-5 and more.
    assert np.abs(droop(along.fitted.state.front)).max() < 4e-6


def test_noise_is_as_large_as_what_is_left_without_any_other(tmp_path: Path) -> None:
    along = along_of(tmp_path, excite="all", grade="ideal", jitter=0.0, n_poses=8)
    problem, fitted = along.problem, along.fitted
    (log,), (predicted,) = problem.logs, fitted.predicted
    even = np.broadcast_to(log.moving.any(axis=1)[:, None, None] * 1.0, predicted.residual.shape)
    shaken = Shaken.of(problem.tree, problem.logs, fitted.state, [even])
    left = np.einsum("kuc,kuc->u", even, predicted.residual**2)
    np.testing.assert_allclose(shaken.chi2.sum(axis=0), left, rtol=0.3)


def test_slopes_are_those_of_differences(tmp_path: Path) -> None:
    along = along_of(tmp_path, excite="all")
    problem, fitted = along.problem, along.fitted
    shaken = Shaken.of(problem.tree, problem.logs, fitted.state, fitted.weights)
    # One has a low-pass, two rise.
    front, h = np.array([[4e-5, 1e-5], [-4e-5, 1e-5], [1e-5, 4e-5]]), 1e-9
    plain, at = fitted.equations, problem.layout.front
    slopes = (shaken.taken_off(plain, problem.layout, front).su_gradient - plain.su_gradient)[:, at]
    for u, n in np.ndindex(3, 2):
        step = np.zeros((3, 2))
        step[u, n] = h
        ahead, behind = shaken.cut_off(front + step), shaken.cut_off(front - step)
        # Gradients are half the slope, with its sign turned.
        assert slopes[u, n] == pytest.approx(-0.5 * (ahead - behind) / (2 * h), rel=1e-4)
    assert shaken.cut_off(0.0 * front) == pytest.approx(0.0, abs=1e-9)
    # No sensor that rises, as steeply as it may, is paid for with more noise than there is.
    steep = np.tile([0.0, 1.0], (3, 1))
    assert -shaken.chi2.sum() < shaken.cut_off(steep) < -0.9 * shaken.chi2.sum()
