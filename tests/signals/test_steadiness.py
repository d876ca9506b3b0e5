"""Noise of many short rests: drawn together where it is one, left apart where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.signals.steadiness import allowance, moderated

P, U = 16, 6


def estimates(true: np.ndarray, freedom: float, seed: int) -> np.ndarray:
    """(P, U, 3) variances as samples with some degrees of freedom show them."""
    rng = np.random.default_rng(seed)
    return np.asarray(true * rng.chisquare(freedom, size=(P, U, 3)) / freedom)


def every(freedom: float) -> np.ndarray:
    return np.full((P, U), freedom)


@pytest.mark.parametrize("freedom", [4.0, 12.0, 60.0])
@pytest.mark.parametrize("seed", range(3))
def test_steady_noise_becomes_one_figure(freedom: float, seed: int) -> None:
    true = np.linspace(1.0, 9.0, U * 3).reshape(U, 3)
    variance, drawn = moderated(
        estimates(true, freedom, seed), every(freedom), np.ones((P, U), dtype=bool)
    )
    error = np.log(variance / true)
    # Chance alone leaves sqrt(2 / freedom) in each, and a quarter of that in the mean of 16.
    assert error.std() < 0.55 * np.sqrt(2 / freedom)
    assert abs(error.mean()) < 0.5 * np.sqrt(2 / freedom)
    assert (drawn > 2 * freedom).all()


def test_weights_keep_what_they_promise() -> None:
    """The mean of rests, weighted by their own variances, has the variance that it states."""
    rng, freedom, z = np.random.default_rng(0), 6.0, []
    for seed in range(300):
        first = estimates(np.ones((U, 3)), freedom, seed)
        variance, drawn = moderated(first, every(freedom), np.ones((P, U), dtype=bool))
        for v, nu in ((first, every(freedom)), (variance, drawn)):
            stated = v * (nu / (nu - 2))[..., None]
            x = rng.standard_normal(v.shape)
            z.append((x / stated).sum(axis=0) / np.sqrt((1 / stated).sum(axis=0)))
    alone, together = (float(np.mean(np.square(z[k::2]))) for k in (0, 1))
    assert alone > 1.3
    assert abs(together - 1) < 0.08


@pytest.mark.parametrize("freedom", [15.0, 60.0])
def test_means_weighted_by_estimates_keep_what_they_promise(freedom: float) -> None:
    """Without the allowance their errors squared are 4 / freedom too large."""
    rng = np.random.default_rng(3)
    variance = rng.chisquare(freedom, size=(20, 100_000)) / freedom
    weight = 1 / (variance * allowance(np.asarray(freedom)))
    z = (rng.standard_normal(variance.shape) * weight).sum(axis=0) / np.sqrt(weight.sum(axis=0))
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.3 * 4 / freedom)


def test_the_allowance_is_finite() -> None:
    values = allowance(np.array([0.0, 1.0, 2.0, 3.0, 1e4]))
    assert (values >= 1).all()
    assert values.max() < 10
    assert values[-1] < 1.001


def test_rests_that_differ_keep_their_own() -> None:
    rng, freedom = np.random.default_rng(1), 12.0
    true = np.exp(rng.normal(0.0, 2.0, size=(P, 1, 1))) * np.ones((P, U, 3))
    first = estimates(true, freedom, 2)
    variance, drawn = moderated(first, every(freedom), np.ones((P, U), dtype=bool))
    ratio = variance / first
    assert np.abs(np.log(ratio)).mean() < 0.2
    # What is noisier than most must not be trusted like most.
    assert ratio[first > np.median(first)].min() > 0.75
    assert (drawn < 1.2 * freedom).all()


def test_what_is_not_alike_is_left_alone() -> None:
    first = estimates(np.ones((U, 3)), 12.0, 3)
    alike = np.ones((P, U), dtype=bool)
    alike[4:, 0] = False
    alike[2:, 1] = False
    variance, drawn = moderated(first, every(12.0), alike)
    np.testing.assert_array_equal(variance[4:, 0], first[4:, 0])
    np.testing.assert_array_equal(variance[:, 1], first[:, 1])
    assert (drawn[:, 1] == 12.0).all()
    assert (variance[:4, 0] != first[:4, 0]).all()
    same, _ = moderated(first, every(12.0), np.zeros((P, U), dtype=bool))
    np.testing.assert_array_equal(same, first)
