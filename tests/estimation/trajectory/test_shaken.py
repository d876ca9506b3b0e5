"""The noise of encoders makes no sensor slow, and no clock late."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_robots import Joint, robot_of

from skin2urdf import calibrate
from skin2urdf.arrays import F64
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.trajectory.front_end import droop
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.shaken import Shaken
from skin2urdf.estimation.trajectory.slack import CERTAIN, size_of, with_unseen
from skin2urdf.estimation.trajectory.smoothed import SMOOTHED
from skin2urdf.signals.filters import filtered, second_derivative
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
    along = along_of(tmp_path, seed=6, excite="all", encoder_bits=13, n_poses=3)
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
    (made,) = shaken.of_logs
    np.testing.assert_allclose(made.chi2.sum(axis=0), left, rtol=0.3)


def test_slopes_are_those_of_differences(tmp_path: Path) -> None:
    along = along_of(tmp_path, excite="all")
    problem, fitted = along.problem, along.fitted
    shaken = Shaken.of(problem.tree, problem.logs, fitted.state, fitted.weights)
    # One has a low-pass, two rise.
    front, h = np.array([[4e-5, 1e-5], [-4e-5, 1e-5], [1e-5, 4e-5]]), 1e-9
    plain, at = fitted.equations, problem.layout.front
    state = replace(fitted.state, front=front)
    slopes = (shaken.taken_off(plain, problem, state).su_gradient - plain.su_gradient)[:, at]
    for u, n in np.ndindex(3, 2):
        step = np.zeros((3, 2))
        step[u, n] = h
        ahead, behind = (
            shaken.cut_off(replace(state, front=each)) for each in (front + step, front - step)
        )
        # Gradients are half the slope, with its sign turned.
        assert slopes[u, n] == pytest.approx(-0.5 * (ahead - behind) / (2 * h), rel=1e-4)
    assert shaken.cut_off(replace(state, front=0.0 * front)) == pytest.approx(0.0, abs=1e-9)
    # No sensor that rises, as steeply as it may, is paid for with more noise than there is.
    steep = np.tile([0.0, 1.0], (3, 1))
    most = sum(each.chi2.sum() for each in shaken.of_logs)
    assert -most < shaken.cut_off(replace(state, front=steep)) < -0.9 * most


def test_slopes_of_smoothing_are_those_of_differences(tmp_path: Path) -> None:
    along = along_of(tmp_path, excite="all")
    further = np.random.default_rng(1).normal(0.0, 1e-4, (1, 3))
    logs = [log.with_joints_further(further) for log in along.problem.logs]
    smoothing = SMOOTHED.unseen(logs, np.zeros(0))
    assert smoothing is not None
    problem = with_unseen(along.problem.again(logs=logs), smoothing, 1e-4)
    x = np.random.default_rng(2).normal(0.0, 1e-4, smoothing.n_numbers)
    front = np.array([[4e-5, 1e-5], [-4e-5, 1e-5], [1e-5, 4e-5]])
    state = replace(along.fitted.state, unseen=x, front=front)
    shaken = Shaken.of(problem.tree, logs, state, along.fitted.weights)
    joint, su = shaken.pull(problem, state)

    def cut_off(front: F64, x: F64) -> float:
        return shaken.cut_off(replace(state, front=front, unseen=x), problem.unseen)

    for n, h in enumerate(np.where(np.abs(x) > 0, 1e-9, 0.0)):
        step = h * (np.arange(len(x)) == n)
        slope = (cut_off(front, x + step) - cut_off(front, x - step)) / (2 * h)
        assert joint[problem.layout.unseen][n] == pytest.approx(-0.5 * slope, rel=1e-4, abs=1e-3)
    for u, n in np.ndindex(3, 2):
        ahead, behind = front.copy(), front.copy()
        ahead[u, n] += 1e-9
        behind[u, n] -= 1e-9
        slope = (cut_off(ahead, x) - cut_off(behind, x)) / 2e-9
        assert su[u, problem.layout.front][n] == pytest.approx(-0.5 * slope, rel=1e-4)


def test_positions_set_further_shake_by_as_much_more(tmp_path: Path) -> None:
    (log,) = along_of(tmp_path, excite="all").problem.logs
    noise = filtered(1e-5 * np.random.default_rng(3).standard_normal(log.q.shape), log.taps)
    numbers = np.array([[-4e-4, 0.0, 2e-4], [1e-6, 0.0, 0.0], [1e-7, 0.0, 0.0]])

    def shaking(q: F64) -> F64:
        """What noise makes of accelerations that are low-passed once more."""
        return filtered(second_derivative(q, log.rate), log.taps)[log.kept].var(axis=0)

    louder = log.with_joints_further(numbers)
    further = replace(log, q=log.q + noise).with_joints_further(numbers).q - louder.q
    assert log.noise is not None
    assert louder.noise is not None
    np.testing.assert_allclose(
        louder.noise / log.noise, shaking(further) / shaking(noise), rtol=0.15
    )
    w, spectrum = louder.noise_spectrum()
    assert len(w) == len(spectrum)
    np.testing.assert_allclose(spectrum.sum(axis=0), louder.noise)


def test_noise_of_encoders_smooths_no_joint(tmp_path: Path) -> None:
    along = along_of(tmp_path, excite="one", encoder_bits=17, n_poses=8)
    assert not along.causes
    told = SMOOTHED.told_by(along.problem.logs)
    assert told is not None
    # Were what front ends make of the noise all that counts, 13: joints would seem to rise.
    assert size_of(along.problem, along.fitted, told).gain < CERTAIN
