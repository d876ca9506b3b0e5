"""SUs and poses unlike the rest: named when they are, and hardly ever when they are not."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.uncertainty.goodness import Share
from skin2urdf.estimation.uncertainty.outliers import (
    Unlike,
    poses_unlike_the_rest,
    sus_unlike_the_rest,
)

P, U = 14, 8
PATTERNED: Bool = np.arange(P) >= 6
"""Six rests after single moves, then eight poses with patterns."""


def blocks(rng: np.random.Generator, spread: float = 0.2) -> Share:
    """Noise, whose level is judged a little differently for every SU and every block."""
    dof = np.where(PATTERNED[:, None], 3.0 + 6.0 * np.arange(1, U + 1), 3.0)
    level = np.exp(spread * rng.standard_normal(U) + spread * rng.standard_normal((P, U)))
    return Share(level * rng.chisquare(dof), dof)


def scaled(share: Share, factors: F64) -> Share:
    return Share(share.chi2 * factors, share.dof)


def by(value: float, pose: int | slice = slice(None), su: int | slice = slice(None)) -> F64:
    """(P, U) factors that are 1 but for one pose, SU or block."""
    factors = np.ones((P, U))
    factors[pose, su] = value
    return factors


def poses(share: Share) -> Unlike:
    return poses_unlike_the_rest(share, PATTERNED)


@pytest.mark.parametrize("spread", [0.0, 0.2, 0.4])
def test_noise_alone_is_hardly_ever_named(spread: float) -> None:
    """At 1 in 10,000 recordings for SUs and for poses, 1,000 name 0.2 on average."""
    rng = np.random.default_rng(0)
    alarms = 0
    for _ in range(1000):
        share = blocks(rng, spread)
        alarms += int(sus_unlike_the_rest(share).odd.any()) + int(poses(share).odd.any())
    assert alarms <= 2


@pytest.mark.parametrize("seed", range(5))
def test_an_su_or_a_pose_that_is_off_is_named_alone(seed: int) -> None:
    share = blocks(np.random.default_rng(seed))
    found = sus_unlike_the_rest(scaled(share, by(30.0, su=2)))
    assert np.flatnonzero(found.odd).tolist() == [2]
    assert 15 < found.times[2] < 60
    assert np.flatnonzero(poses(scaled(share, by(30.0, pose=9))).odd).tolist() == [9]
    assert np.flatnonzero(poses(scaled(share, by(100.0, pose=3))).odd).tolist() == [3]


def test_an_su_that_comes_loose_half_way_is_named() -> None:
    share = scaled(blocks(np.random.default_rng(1)), by(1000.0, pose=slice(9, P), su=5))
    assert np.flatnonzero(sus_unlike_the_rest(share).odd).tolist() == [5]


def test_what_fits_as_well_as_its_noise_is_never_named() -> None:
    """Rests between moves may fit a thousand times better than windows of moves let expect."""
    share = scaled(blocks(np.random.default_rng(1)), np.full((P, U), 1e-3))
    assert not poses(scaled(share, by(300.0, pose=3))).odd.any()
    assert np.flatnonzero(poses(scaled(share, by(1e5, pose=3))).odd).tolist() == [3]


def test_two_bad_sus_do_not_hide_each_other() -> None:
    factors = by(200.0, su=1) * by(50.0, su=6)
    found = sus_unlike_the_rest(scaled(blocks(np.random.default_rng(2)), factors))
    assert np.flatnonzero(found.odd).tolist() == [1, 6]


def test_one_wild_block_is_neither_a_bad_su_nor_a_bad_pose() -> None:
    share = scaled(blocks(np.random.default_rng(3)), by(1e4, pose=8, su=4))
    assert not sus_unlike_the_rest(share).odd.any()
    assert not poses(share).odd.any()


def test_a_misfit_shared_by_all_is_no_outlier() -> None:
    share = blocks(np.random.default_rng(4))
    plain, raised = sus_unlike_the_rest(share), sus_unlike_the_rest(scaled(share, by(15.0)))
    np.testing.assert_allclose(raised.times, plain.times)
    assert not raised.odd.any()


def test_poses_with_patterns_are_not_held_against_rests() -> None:
    """Encoders round away what moves: the patterns may all fit 20 times worse than the rests."""
    share = scaled(blocks(np.random.default_rng(5)), by(20.0, pose=slice(6, P)))
    assert not poses(share).odd.any()


def test_what_was_not_measured_is_not_judged() -> None:
    share = blocks(np.random.default_rng(6))
    empty = Share(share.chi2 * by(0.0, su=3), share.dof * by(0.0, su=3))
    found = sus_unlike_the_rest(empty)
    assert np.isnan(found.times[3])
    assert not found.odd.any()
    two = Share(1000.0 ** np.arange(2.0)[None], np.full((1, 2), 30.0))
    assert not sus_unlike_the_rest(two).odd.any()
