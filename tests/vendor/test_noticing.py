"""Slips: how sure, and how small."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.vendor.noticing import differing

LEVEL = 1e-4


@pytest.fixture
def covariance() -> F64:
    """Of places and turns that go together."""
    root = np.random.default_rng(3).standard_normal((6, 6))
    size = np.diag([1e-4, 2e-4, 3e-4, 5e-4, 5e-4, 2e-3])
    return np.asarray(size @ (root @ root.T / 6 + 0.3 * np.eye(6)) @ size)


@pytest.mark.parametrize("which", [slice(0, 3), slice(3, 6)])
def test_slips_of_the_size_that_is_told_are_found_in_99_of_100(
    which: slice, covariance: F64
) -> None:
    rng = np.random.default_rng(0)
    told = differing(np.zeros(6), covariance, LEVEL)
    size = told.shift if which.start == 0 else told.turn
    # The direction that shows least.
    weakest = np.linalg.eigh(np.linalg.inv(covariance)[which, which])[1][:, 0]
    slip = np.zeros(6)
    slip[which] = size * weakest
    noise = rng.multivariate_normal(np.zeros(6), covariance, 1000)
    found = [differing(slip + x, covariance, LEVEL).probability < LEVEL for x in noise]
    assert 0.98 < np.mean(found) <= 1.0
    half = [differing(0.5 * slip + x, covariance, LEVEL).probability < LEVEL for x in noise]
    assert np.mean(half) < 0.5


def test_slips_that_no_robot_can_make_are_not_told_as_found(covariance: F64) -> None:
    vague = np.diag([0.25] * 3 + [0.0] * 3) + covariance
    told = differing(np.zeros(6), vague, LEVEL)
    assert np.isnan(told.shift)
    assert told.turn < 0.1


def test_chance_is_told_as_often_as_stated(covariance: F64) -> None:
    noise = np.random.default_rng(1).multivariate_normal(np.zeros(6), covariance, 2000)
    alarms = np.mean([differing(x, covariance, LEVEL).probability < 0.05 for x in noise])
    # Three tests that share what they look at are never more often wrong than stated.
    assert 0.02 < alarms < 0.06


def test_directions_that_nobody_knows_count_for_nothing(covariance: F64) -> None:
    along = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    far = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0])
    off = differing(far, covariance, LEVEL, along)
    assert (off.dof, off.chi2, off.probability) == (5, pytest.approx(0.0), 1.0)
    assert np.isfinite([off.shift, off.turn]).all()
    nothing = differing(far, covariance, LEVEL, np.eye(6))
    assert (nothing.dof, nothing.probability) == (0, 1.0)
    assert np.isnan([nothing.shift, nothing.turn]).all()
