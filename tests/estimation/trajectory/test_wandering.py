"""Clocks that wander or step are followed by all samples; steady ones have nothing to follow."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from synthetic import (
    RATE,
    error_along_another_motion,
    random_state,
    sampled_trajectory,
    serial_tree,
    stays,
)

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.wandering import wandering
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import Spline, first_derivative, second_derivative

_TREE = serial_tree(3)
_UP = np.array([0.0, 0.0, 1.0])
_STAY, _MOVE, _PLACES = 100, 150, 25


@cache
def _truth() -> State:
    return replace(random_state(np.random.default_rng(3), _TREE, 1, 0.3), up=_UP[None])


@cache
def _fit(slewed: float, stepped: float, of_joints: bool = False) -> MotionEstimate:
    """A minute from place to place, with readings that are late by what changes.

    Args:
        slewed: amplitude of a wave that takes 20 s [s].
        stepped: by how much later they are after two thirds of the log [s].
        of_joints: whether it is the joints' clock that wanders.
    """
    rng, truth = np.random.default_rng(2), _truth()
    q = stays(rng.uniform(-1.5, 1.5, (_PLACES, 3)), _STAY, _MOVE)
    qd, qdd = first_derivative(q, RATE), second_derivative(q, RATE)
    ideal = specific_forces(truth.model(_TREE), q, qd, qdd, 9.81 * _UP)
    late = _late(len(q), slewed, stepped)
    at = np.clip(np.arange(len(q)) + RATE * (-late if of_joints else late), 0, len(q) - 1)
    if of_joints:
        q = Spline(q).within(at)
    else:
        ideal = Spline(ideal.reshape(len(q), -1)).within(at).reshape(ideal.shape)
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
    read = read + 7e-3 * rng.standard_normal(read.shape)
    log = sampled_trajectory(q, read, still_below=1e-3)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    return estimate_along([log], _TREE, truth, priors, np.zeros(3))


def _late(n: int, slewed: float, stepped: float) -> F64:
    """(N,) by how much readings are late [s]; neither is a drift."""
    time = np.arange(n) / RATE
    wave = slewed * np.cos(2 * np.pi * (time - time.mean()) / 20.0)
    return np.asarray(wave + stepped * (time > 0.66 * time[-1]))


def _errors(found: MotionEstimate) -> float:
    """Root mean square error of what sensors read along another motion [m/s^2]."""
    return error_along_another_motion(_TREE, found.state, _truth())


def test_steady_clocks_are_not_followed() -> None:
    found = _fit(0.0, 0.0)
    assert "clock" not in found.causes
    assert found.wandering == ()


@pytest.mark.parametrize("of_joints", [False, True])
@pytest.mark.parametrize("slewed", [1e-3, 1e-2])
def test_clocks_that_wander_are_followed_and_bend_nothing(slewed: float, of_joints: bool) -> None:
    found = _fit(slewed, 0.0, of_joints)
    assert found.causes == ("clock",)
    (late,) = found.wander
    kept = found.problem.logs[0].kept
    time, off = kept / RATE, (late - _late(len(late), slewed, 0.0))[kept]
    # What an offset and a drift make of it belongs to the SUs' clocks.
    off = off - np.polyval(np.polyfit(time, off, 1), time)
    assert np.abs(off).max() < 0.1 * slewed
    assert found.wandering[0] == pytest.approx(2 * slewed, rel=0.25)
    # Without, 5 and 50 times as much.
    assert _errors(found) < 4 * _errors(_fit(0.0, 0.0))


@pytest.mark.parametrize("stepped", [0.02, 0.06])
def test_a_clock_that_steps_is_taken_back_where_it_did(stepped: float) -> None:
    found = _fit(0.0, stepped)
    assert found.causes == ("clock",)
    assert found.wandering[0] == pytest.approx(stepped, rel=0.02)
    # Without, 50 and 150 times as much.
    assert _errors(found) < 2 * _errors(_fit(0.0, 0.0))


def test_every_moment_moves_all_joints_as_fast_as_they_go() -> None:
    log = _fit(0.0, 0.0).problem.logs[0]
    more = wandering([log])
    assert more is not None
    moved = more.motions[0].reshape(len(log.q), more.n_numbers, 3)
    # Moments that are all as late are joints that are late.
    np.testing.assert_allclose(moved.sum(axis=1), log.qd, atol=1e-9)
