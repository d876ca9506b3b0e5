"""Positions that are of other ages under one stamp, or smoothed, are set right and bend nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter
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
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.reading_times import Read, ReadingTimes
from skin2urdf.estimation.trajectory.smoothed import SMOOTHED
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import Spline, first_derivative, second_derivative

_TREE = serial_tree(3)
_UP = np.array([0.0, 0.0, 1.0])
_AGES = np.array([0.0, 4e-3, 12e-3])
_MEANS = 8
"""Samples that a mean of positions is made of."""
_POLE = 0.012
"""Time constant of low-passes [s]."""
_LINES = 1 / 12 / RATE**2
"""What straight lines from sample to sample take of the second derivative [s^2]."""


@cache
def _truth() -> State:
    return replace(random_state(np.random.default_rng(3), _TREE, 1, 0.3), up=_UP[None])


@cache
def _fit(how: str = "") -> MotionEstimate:
    """A minute from place to place, with positions that a driver reads in some way."""
    rng, truth = np.random.default_rng(2), _truth()
    q = stays(rng.uniform(-1.5, 1.5, (30, 3)), 60, 120)
    qd, qdd = first_derivative(q, RATE), second_derivative(q, RATE)
    ideal = specific_forces(truth.model(_TREE), q, qd, qdd, 9.81 * _UP)
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
    read = read + 7e-3 * rng.standard_normal(read.shape)
    log = sampled_trajectory(_read(q, how), read, still_below=1e-3)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    return estimate_along([log], _TREE, truth, priors, np.zeros(3))


def _read(q: F64, how: str) -> F64:
    """Positions as they are logged: one after another, as means, or with play that stays."""
    at = np.arange(len(q))
    if how == "in turn":
        earlier = (np.clip(at - RATE * age, 0, None) for age in _AGES)
        return np.hstack([Spline(x[:, None]).within(t) for x, t in zip(q.T, earlier, strict=True)])
    if how == "means":
        before = np.concatenate([np.repeat(q[:1], _MEANS, axis=0), q])
        total = np.cumsum(before, axis=0)
        return np.asarray((total[_MEANS:] - total[:-_MEANS]) / _MEANS)
    if "pole" in how:
        # As of motion that goes from sample to sample in straight lines.
        kept = np.exp(-1 / RATE / _POLE)
        share = 1 - _POLE * RATE * (1 - kept)
        for _ in range(2 if "two" in how else 1):
            old, new = [1 - kept - share, share], [1.0, -kept]
            q = lfilter(old[::-1], new, q, axis=0, zi=(1 - share) * q[:1])[0]
        return q
    if how == "play":
        away = np.sign(np.gradient(q, axis=0).round(6))
        for i in range(1, len(away)):
            away[i] = np.where(away[i] == 0, away[i - 1], away[i])
        return np.asarray(q + 1e-3 * away)
    return q


def _errors(found: MotionEstimate) -> float:
    """Root mean square error of what sensors read along another motion [m/s^2]."""
    return error_along_another_motion(_TREE, found.state, _truth())


def test_positions_as_encoders_have_them_are_left_as_they_are() -> None:
    found = _fit()
    assert not found.causes
    assert not found.ages.any()
    assert not found.smoothing.any()


def test_joints_that_are_read_one_after_another_are_taken_when_they_were() -> None:
    found = _fit("in turn")
    assert found.causes == ("lags",)
    np.testing.assert_allclose(found.ages, _AGES - _AGES.mean(), atol=1e-4)
    # What all are late by is what the clocks of all SUs are early by.
    np.testing.assert_allclose(found.fitted.state.clock[..., 0], -_AGES.mean(), atol=1e-4)
    # Without, 40 times as much.
    assert _errors(found) < 1.5 * _errors(_fit())


def test_means_of_positions_get_back_what_they_lack() -> None:
    found = _fit("means")
    assert found.causes == ("smoothed",)
    np.testing.assert_allclose(found.smoothing, -(_MEANS**2 - 1) / 24 / RATE**2, rtol=0.02)
    assert found.unreached < 1e-3
    # Without, 40 times as much.
    assert _errors(found) < 1.5 * _errors(_fit())


def test_low_passes_of_one_pole_get_back_what_they_lack() -> None:
    found = _fit("pole")
    assert found.causes == ("smoothed",)
    np.testing.assert_allclose(found.smoothing, -(_POLE**2) / 2 - _LINES, rtol=0.03)
    assert _errors(found) < 1.5 * _errors(_fit())


def test_filters_of_another_kind_get_back_what_they_lack() -> None:
    found = _fit("two poles")
    assert found.causes == ("smoothed",)
    np.testing.assert_allclose(found.smoothing, -(_POLE**2) - 2 * _LINES, rtol=0.05)
    assert _errors(found) < 1.5 * _errors(_fit())


def test_what_explains_nothing_once_it_is_followed_is_no_cause(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beside springs smoothing is shown for certain, and leads their numbers away from loads."""

    def nowhere(
        self: ReadingTimes, problem: MotionProblem, fitted: Fitted, size: float
    ) -> tuple[MotionProblem, Fitted, Read]:
        del size
        return problem, fitted, Read(self, np.zeros(2 * _TREE.n_joints - 1))

    monkeypatch.setattr(type(SMOOTHED), "followed", nowhere)
    assert "smoothed" not in _fit.__wrapped__("means").causes


def test_what_makes_up_most_of_the_motion_is_not_undone() -> None:
    """Of a swing of w that is further by c of its acceleration, c w^2 of 1 + c w^2 is made up."""
    w, size = 25.0, np.array([0.0, 0.0, -1e-3, -1e-3, -4e-3])
    q = np.sin(w * np.arange(2000) / RATE)[:, None] * [1.0, 0.5, 0.0]
    read = sampled_trajectory(q, np.zeros((2000, 1, 3)), still_below=1e-3)
    right = SMOOTHED.set_right(read, size)
    made_up = 1e-3 * w**2
    assert SMOOTHED.unreached([right], size) == pytest.approx(made_up / (1 + made_up), rel=0.01)


@pytest.mark.parametrize(("how", "numbers"), [("", 0), ("in turn", 2), ("means", 5)])
def test_what_they_may_still_be_off_by_is_in_what_is_stated(how: str, numbers: int) -> None:
    problem = _fit(how).problem
    assert problem.free_joint[problem.layout.unseen].sum() == numbers


def test_play_is_neither() -> None:
    assert not {"lags", "smoothed"} & set(_fit("play").causes)
