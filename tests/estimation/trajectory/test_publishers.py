"""Publishers with clocks of their own are found by all samples, and sound ones have none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from synthetic import RATE, random_state, sampled_trajectory, serial_tree, stays

from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import Spline, first_derivative, second_derivative

_TREE = serial_tree(3)
_UP = np.array([0.0, 0.0, 1.0])
_STAY, _MOVE, _PLACES = 130, 170, 10
_SLOW = 40


@cache
def _truth() -> State:
    return replace(random_state(np.random.default_rng(3), _TREE, 1, 0.3), up=_UP[None])


@cache
def _fit(late: float, drift: float, seed: int = 2, shaken: float = 0.0) -> MotionEstimate:
    """Half a minute between ten places, with the last of three joints on a clock of its own.

    Args:
        late: of that clock [s].
        drift: of that clock.
        seed: of the places and the noise.
        shaken: slow vibration of the last SU while the arm moves [m/s^2].
    """
    rng, truth = np.random.default_rng(seed), _truth()
    q = stays(rng.uniform(-1.5, 1.5, (_PLACES, 3)), _STAY, _MOVE)
    qd, qdd = first_derivative(q, RATE), second_derivative(q, RATE)
    ideal = specific_forces(truth.model(_TREE), q, qd, qdd, 9.81 * _UP)
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
    read = read + 7e-3 * rng.standard_normal(read.shape)
    if shaken:
        slow = uniform_filter1d(rng.standard_normal((len(q), 3)), _SLOW, axis=0) * np.sqrt(_SLOW)
        read[:, -1] += shaken * slow * np.abs(qd).max(axis=1, keepdims=True) / np.abs(qd).max()
    grid = np.arange(len(q))
    # Stamped t is what was at t' with t - t' = late + drift (t' - middle).
    at = grid - RATE * late - drift * (grid - RATE * late - grid.mean()) / (1 + drift)
    seen = np.array(q)
    seen[:, 2] = Spline(q[:, 2:]).within(np.clip(at, 0, grid[-1]))[:, 0]
    log = replace(sampled_trajectory(seen, read, still_below=1e-3), publisher=np.array([0, 0, 1]))
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    # What is shaken is to stay unexplained.
    return estimate_along([log], _TREE, truth, priors, np.zeros(3), look_further=not shaken)


def test_a_sound_publisher_has_no_clock() -> None:
    assert _fit(0.0, 0.0).late is None


@pytest.mark.parametrize(("late", "drift"), [(1e-3, 0.0), (0.03, 3e-3), (0.3, -1e-3)])
def test_a_clock_is_found_as_well_as_stated(late: float, drift: float) -> None:
    found = _fit(late, drift).late
    assert found is not None
    assert found.log.tolist() == [0]
    assert found.joints[0].tolist() == [2]
    assert abs(found.latency[0] - late) < max(4 * found.latency_sd[0], 2e-5)
    assert abs(found.drift[0] - drift) < 4 * found.drift_sd[0]
    assert found.latency_sd[0] < 2e-4


def test_what_lasts_for_longer_than_a_sample_widens_the_deviations_of_clocks() -> None:
    late, drift = 0.03, 1e-3
    off = []
    for seed in (0, 2):
        found = _fit(late, drift, seed, 0.01).late
        assert found is not None
        off.append((found.latency[0] - late) / found.latency_sd[0])
        off.append((found.drift[0] - drift) / found.drift_sd[0])
    assert np.sqrt(np.mean(np.square(off))) < 2.0


def test_what_was_late_is_fitted_as_if_it_were_not() -> None:
    sound, late = _fit(0.0, 0.0), _fit(0.3, -1e-3)
    assert late.misfit < 1.2 * sound.misfit + 0.1
    moved = late.state.T_joint_su[2] - sound.state.T_joint_su[2]
    assert np.abs(moved[:, :3]).max() < 5e-4
    # Along the last axis nothing is known of where it is.
    assert np.abs(moved[:2, 3]).max() < 5e-4
