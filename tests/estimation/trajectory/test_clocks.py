"""An SU whose clock the log hardly tells runs as the others do; one with its own keeps it."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import RATE, sampled_trajectory, stays

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.clocks import clocks_of_others
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import first_derivative, second_derivative
from skin2urdf.structure.records import KinematicTree

GIVEN = np.array([1.0, 1e-2])
UP = np.array([0.0, 0.0, 1.0])
N = 8
TREE = KinematicTree(
    ("pan", "tilt"), np.array([-1, 0]), ("revolute", "revolute"),
    ("on pan", *(f"on tilt {u}" for u in range(N))), np.array([0] + [1] * N),
)  # fmt: skip


def clocks(lags: F64, sds: F64) -> tuple[F64, F64]:
    """(1, U, 2) clocks without drift, and their variances."""
    clock, variance = np.zeros((1, len(lags), 2)), np.full((1, len(lags), 2), 1e-12)
    clock[0, :, 0], variance[0, :, 0] = lags, sds**2
    return clock, variance


def test_a_clock_that_hardly_shows_is_expected_where_the_others_are() -> None:
    rng = np.random.default_rng(0)
    lags, sds = 1e-4 * rng.standard_normal(10), np.full(10, 1e-4)
    lags[3], sds[3] = 0.5, 0.05
    expected = clocks_of_others(*clocks(lags, sds), np.zeros((1, 10, 2)), GIVEN)
    assert abs(expected.mean[0, 3, 0]) < 2e-4
    assert 1e-4 < expected.deviation[0, 3, 0] < 2e-3
    # What its own samples tell better than the others is left to them.
    np.testing.assert_array_equal(np.delete(expected.deviation[0, :, 0], 3), GIVEN[0])


def test_where_clocks_differ_little_is_known_of_the_next() -> None:
    rng = np.random.default_rng(1)
    lags, sds = 0.3 * rng.standard_normal(12), np.full(12, 1e-4)
    sds[0] = 0.5
    expected = clocks_of_others(*clocks(lags, sds), np.zeros((1, 12, 2)), GIVEN)
    assert expected.deviation[0, 0, 0] > 0.15


def test_stamps_that_were_set_right_count_with_what_they_were_off_by() -> None:
    lags, sds = np.zeros(10), np.full(10, 1e-4)
    sds[3] = 0.05
    mended = np.full((1, 10, 2), (0.4, 0.0))
    mended[0, 3] = 0.0
    expected = clocks_of_others(*clocks(lags, sds), mended, GIVEN)
    assert expected.mean[0, 3, 0] == pytest.approx(0.4)


def test_two_others_are_too_few_to_tell_of_a_clock_that_hardly_shows() -> None:
    few = clocks(np.zeros(3), np.array([1e-4, 1e-4, 0.1]))
    expected = clocks_of_others(*few, np.zeros((1, 3, 2)), GIVEN)
    np.testing.assert_array_equal(expected.deviation[0], np.tile(GIVEN, (3, 1)))


def test_few_others_tell_little_of_how_far_clocks_spread() -> None:
    """Of a single one nothing; of two 6 ms apart that 0.1 s stands out, and that 20 ms do not."""

    def off(*lags: float) -> bool:
        n = len(lags)
        told = clocks(np.array(lags), np.full(n, 1e-5)), np.zeros((1, n, 2))
        expected = clocks_of_others(*told[0], told[1], GIVEN)
        return bool(expected.deviation[0, -1, 0] < GIVEN[0])

    assert not off(0.0, 0.25)
    assert off(-0.003, 0.003, 0.1)
    assert not off(-0.003, 0.003, 0.02)


@pytest.mark.parametrize("n", [3, 4, 10])
def test_a_clock_that_stands_out_is_tried_among_the_others(n: int) -> None:
    """However well its own samples tell it: half a period of a pattern off looks right as well."""
    rng = np.random.default_rng(0)
    lags = 1e-4 * rng.standard_normal(n)
    lags[-1] = 0.25
    expected = clocks_of_others(*clocks(lags, np.full(n, 1e-4)), np.zeros((1, n, 2)), GIVEN)
    assert abs(expected.mean[0, -1, 0]) < 1e-3
    assert expected.deviation[0, -1, 0] < 2e-3


def found(late: float, begin: float, noise: float) -> MotionEstimate:
    """A fit in which the SU on the vertical joint is late, and its clock begins off."""
    rng = np.random.default_rng(2)
    places = rng.uniform(-1.0, 1.0, (10, 2))
    q = stays(places, 150, 100)
    joints = np.tile(np.eye(4), (2, 1, 1))
    joints[1, :3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    joints[1, :3, 3] = (0.1, 0.0, 0.3)
    sus = np.tile(np.eye(4), (N + 1, 1, 1))
    sus[:, :3, 3] = rng.uniform(-0.3, 0.3, (N + 1, 3))
    truth = State(joints, sus, UP[None], np.zeros((N + 1, 3)), np.zeros((N + 1, 6)))
    ways = q, first_derivative(q, RATE), second_derivative(q, RATE)
    read = specific_forces(truth.model(TREE), *ways, 9.81 * UP)
    t = np.arange(len(q)) / RATE
    read[:, 0] = np.stack([np.interp(t - late, t, f) for f in read[:, 0].T], axis=1)
    log = sampled_trajectory(q, read + noise * rng.standard_normal(read.shape), still_below=1e-3)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    latency = np.zeros(N + 1)
    latency[0] = begin
    return estimate_along([log], TREE, truth, priors, latency)


@pytest.mark.parametrize("begin", [0.0, -0.5])
def test_an_su_that_hears_little_runs_as_the_others_do(begin: float) -> None:
    along = found(0.0, begin, 0.05)
    assert abs(along.fitted.state.clock[0, 0, 0]) < 0.02


def test_an_su_that_has_a_clock_of_its_own_keeps_it() -> None:
    along = found(0.1, 0.1, 5e-3)
    assert along.fitted.state.clock[0, 0, 0] == pytest.approx(0.1, abs=0.01)
