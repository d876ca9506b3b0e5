"""Tilts of a base by itself: splines that turn gravity, and what they accelerate by is not felt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import (
    RATE,
    motion_state,
    random_state,
    readings_along,
    sampled_trajectory,
    serial_tree,
    stays,
)

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.fit import fit, held
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.rocking import of_accelerations
from skin2urdf.estimation.trajectory.skeleton import turn
from skin2urdf.estimation.trajectory.tilting import tilts
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.signals.trajectory import Trajectory

_CHAIN = serial_tree(1)
_TREE = replace(_CHAIN, su_names=(*_CHAIN.su_names, "base"), su_joint=np.array([0, -1]))
_UP = np.array([0.0, 0.0, 1.0])


def _log(seconds: float = 40.0) -> Trajectory:
    """A joint that goes from place to place, on a base that turns slowly about x."""
    rng = np.random.default_rng(1)
    q = stays(rng.uniform(-1, 1, (int(seconds / 2), 1)), int(RATE), int(RATE))
    tilt = 0.01 * np.sin(0.4 * np.arange(len(q)) / RATE)
    felt = np.swapaxes(rotation_exp(tilt[:, None] * [1.0, 0.0, 0.0]), 1, 2) @ (9.81 * _UP)
    readings = np.stack([felt, felt], axis=1) + 0.01 * rng.standard_normal((len(q), 2, 3))
    return sampled_trajectory(q, readings, still_below=0.02)


def _problem(log: Trajectory) -> tuple[MotionProblem, F64]:
    more = tilts(_TREE, [log], _UP[None])
    assert more is not None
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    priors = replace(priors, unseen=np.full(more.n_numbers, 0.01))
    x = 0.01 * np.random.default_rng(2).standard_normal(more.n_numbers)
    return MotionProblem(_TREE, [log], priors, unseen=more), x


def test_a_constant_tilt_is_one_of_them() -> None:
    log = _log()
    more = tilts(_TREE, [log], _UP[None])
    assert more is not None
    np.testing.assert_allclose(more.motions[0].sum(axis=1), 1.0)
    moved = more.moved(log, 0, np.tile([0.01, 0.0], more.n_numbers // 2))
    turned = np.linalg.norm(moved.q[:, 1:], axis=1)
    np.testing.assert_allclose(turned, 0.01)
    # Its axis is level.
    np.testing.assert_allclose(moved.q[:, turn(_TREE, 2)], 0.0)


def test_axes_are_level_in_their_own_log() -> None:
    log, lying = _log(), np.array([1.0, 0.0, 0.0])
    more = tilts(_TREE, [log, log], np.stack([_UP, lying]))
    assert more is not None
    x = np.ones(more.n_numbers)
    for g, (up, other) in enumerate([(_UP, lying), (lying, _UP)]):
        turned = more.moved(log, g, x).q[:, turn(_TREE, 0) : turn(_TREE, 2) + 1]
        np.testing.assert_allclose(turned @ up, 0.0, atol=1e-12)
        assert np.abs(turned @ other).min() > 0.1


@pytest.mark.parametrize("seconds", [10.0, 40.0, 600.0])
def test_numbers_are_as_many_as_there_is_time_for(seconds: float) -> None:
    more = tilts(_TREE, [_log(seconds)], _UP[None])
    assert more is not None
    assert 2 * seconds / 2 < more.n_numbers <= 610


def test_positions_turn_and_nothing_accelerates() -> None:
    log = _log()
    problem, x = _problem(log)
    assert problem.unseen is not None
    moved = problem.unseen.moved(log, 0, x)
    assert np.abs(moved.q[:, 1:]).max() > 1e-3
    np.testing.assert_array_equal(moved.qd[:, 1:], 0.0)
    np.testing.assert_array_equal(moved.qdd[:, 1:], 0.0)
    (motions,) = problem.unseen.at_kept([log])
    assert motions[0].any()
    np.testing.assert_array_equal(motions[1:], 0.0)
    assert not problem.base_swings
    # Where an SU is on a base that is not felt to accelerate, nothing shows.
    assert not problem.free_su[1, :3].any()


def test_information_on_tilts_is_that_of_readings() -> None:
    log = _log(10.0)
    problem, x = _problem(log)
    placements = random_state(np.random.default_rng(3), _TREE, 1, 0.3)
    state = motion_state(replace(placements, up=_UP[None]), x)
    weights = [np.ones((len(log.kept), 2, 3))]
    at = problem.layout.unseen.start + 5
    step, slope = 1e-6, np.zeros((len(log.kept), 2, 3))
    for sign in (1, -1):
        there = state.unseen.copy()
        there[5] += sign * step
        slope -= sign * problem.predict(replace(state, unseen=there), 0).residual / (2 * step)
    equations = problem.equations(state, [problem.predict(state, 0)], weights)
    information = equations.joint[at, at] - problem.priors.unseen[5] ** -2
    assert information == pytest.approx(float((slope**2).sum()), rel=1e-3)


def test_what_it_accelerates_by_is_a_part_of_the_error_only_where_it_tilts() -> None:
    log = _log()
    problem, x = _problem(log)
    placements = random_state(np.random.default_rng(3), _TREE, 1, 0.3)
    begin = motion_state(replace(placements, up=_UP[None]), x)
    stiff = problem.stiff()
    still = held(stiff, replace(begin, unseen=np.zeros(0)))
    assert of_accelerations(stiff, still) == []
    fitted = fit(problem, begin)
    parts = of_accelerations(problem, fitted)
    # About the frame, about a point below, and for each axis of the lever of an SU on the base.
    assert len(parts) == 5
    assert all(np.abs(joint).max() + np.abs(su).max() > 0 for joint, su in parts)
    for _, su in parts[2:]:
        np.testing.assert_array_equal(su[0], 0.0)


def test_what_drifting_sensors_do_is_no_tilt() -> None:
    """Tilts follow it as well, by many more numbers, and leave little more than noise."""
    rng = np.random.default_rng(3)
    truth = replace(random_state(rng, _TREE, 1, 0.3), up=_UP[None])
    q = stays(rng.uniform(-1, 1, (20, 1)), int(RATE), int(RATE))
    warmth = 1 - np.exp(-np.arange(len(q)) / RATE / 60)
    readings = readings_along(_TREE, truth, q)
    readings += 0.06 * rng.uniform(-1, 1, (2, 3)) * warmth[:, None, None]
    readings += 0.03 * rng.standard_normal(readings.shape)
    log = sampled_trajectory(q, readings, still_below=0.02)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    found = estimate_along([log], _TREE, truth, priors, np.zeros(2))
    assert found.causes == ("drift",)
    assert found.misfit < found.tried["tilts"] < 2.0
