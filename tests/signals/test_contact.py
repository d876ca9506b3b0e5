"""Pushes stand out from the noise of SUs and encoders by as much as their likelihood says."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.hypotheses.contact import unexplained
from skin2urdf.signals.contact import felt_by, moments, own_noise, push_strengths, standing_out

RATE, CUTOFF, LIMIT = 125.0, 9.0, 7.0
OWN = np.array([0.02, 0.05, 0.03])
VARIANCE = np.array([4.0, 0.0, 1.0])


def responses() -> F64:
    """(U, D, 3) of three SUs, one joint beyond the other; the last SU feels all of them."""
    tau = np.random.default_rng(1).normal(size=(3, 3, 3))
    return tau * np.tri(3)[..., None]


def noise(N: int, seed: int = 2) -> F64:
    """(N, U, 3) residuals of SUs and encoders."""
    rng = np.random.default_rng(seed)
    encoders = rng.normal(size=(N, 3)) * np.sqrt(VARIANCE)
    own: F64 = rng.normal(size=(N, 3, 3)) * OWN[:, None]
    return own + np.einsum("nd,udk->nuk", encoders, responses())


def covariance(tau: F64, own: F64) -> F64:
    """(3 U, 3 U) of the residuals."""
    columns = tau.swapaxes(1, 2).reshape(-1, tau.shape[1])
    return np.diag(np.repeat(own**2, 3)) + (columns * VARIANCE) @ columns.T


def test_pushes_are_likelihood_ratios() -> None:
    tau, y = responses(), noise(50)
    inverse = np.linalg.inv(covariance(tau, OWN))
    columns = tau.swapaxes(1, 2).reshape(-1, 3)
    score = y.reshape(50, -1) @ inverse @ columns
    expected = score / np.sqrt(np.diagonal(columns.T @ inverse @ columns))
    np.testing.assert_allclose(push_strengths(y, tau, VARIANCE, OWN), expected, rtol=1e-9)


def test_pushes_have_variance_1_where_nothing_is_pushed() -> None:
    spread = push_strengths(noise(40_000), responses(), VARIANCE, OWN).std(axis=0)
    np.testing.assert_allclose(spread, 1.0, rtol=0.02)


def test_the_noise_of_an_encoder_does_not_hide_a_push_that_other_sus_do_not_feel() -> None:
    """The first joint's noise is far larger in the last SU than the last joint's push."""
    tau, y = responses(), noise(1)
    tau[2, 2] /= 30
    push = 3.0 * tau[2, 2]
    pushed = y + np.where(np.arange(3)[:, None] == 2, push, 0.0)
    change = np.abs(
        push_strengths(pushed, tau, VARIANCE, OWN) - push_strengths(y, tau, VARIANCE, OWN)
    )[0, 2]
    alone = np.linalg.norm(push) / np.sqrt(covariance(tau, OWN)[6:, 6:].trace() / 3)
    assert alone < 0.5 < 2.0 < change


def test_sus_that_are_not_there_and_joints_that_no_su_feels_have_no_part() -> None:
    y, tau = noise(5000), responses()
    y[:, 1] = 0.0
    tau[2, 2] = 0.0
    own = own_noise(y, tau, VARIANCE)
    assert np.isposinf(own[1])
    assert np.isfinite(own[[0, 2]]).all()
    some = [0, 2]
    pushes = push_strengths(y, tau, VARIANCE, own)
    assert pushes.shape == (5000, 2)
    expected = push_strengths(y[:, some], tau[some][:, :2], VARIANCE[:2], own[some])
    np.testing.assert_allclose(pushes, expected, rtol=1e-9)


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_pushes_are_finite_whatever_readings_owe_to_the_joints(size: float) -> None:
    tau = responses() * size
    tau[:, 1] = tau[:, 0]
    pushes = push_strengths(noise(20), tau, VARIANCE, np.full(3, 1e-6))
    assert np.isfinite(pushes).all()


def test_own_noise_is_what_encoders_do_not_bring() -> None:
    own = np.array([1.0, 2.0])
    rng = np.random.default_rng(3)
    y = rng.normal(size=(20_000, 2, 3)) * own[:, None]
    tau = np.full((2, 1, 3), 1.0)
    shared = y + 0.7 * rng.normal(size=(20_000, 1, 1)) * tau[None, :, 0]
    none, some = np.array([0.0]), np.array([0.49])
    np.testing.assert_allclose(own_noise(y, tau, none), own, rtol=0.02)
    np.testing.assert_allclose(own_noise(shared, tau, some), own, rtol=0.1)


def test_a_swing_through_zero_is_one_moment() -> None:
    x = np.random.default_rng(4).normal(size=(1000, 2))
    t = np.arange(1000) / RATE
    inside = np.abs(t - 4.0) < 0.15
    x[inside, 1] += 60 * np.sin(2 * np.pi * 6 * (t[inside] - 3.9))
    ((a, b, at, strength),) = moments(standing_out(x, RATE), LIMIT, RATE, CUTOFF)
    assert t[a] < 3.86
    assert t[b] > 4.14
    assert b - a < 0.6 * RATE
    assert inside[at]
    assert 15 < strength < 40


def test_noise_does_not_stand_out_and_what_lasts_is_no_moment() -> None:
    x = np.random.default_rng(5).normal(size=(4000, 30))
    assert not list(moments(standing_out(x, RATE), LIMIT, RATE, CUTOFF))
    x[1000:1200, 0] += 60
    assert not list(moments(standing_out(x, RATE), LIMIT, RATE, CUTOFF))
    assert not list(moments(standing_out(x[:100], RATE), LIMIT, RATE, CUTOFF))
    assert not list(moments(standing_out(x[:, :0], RATE), LIMIT, RATE, CUTOFF))


def test_at_least_one_su_feels_a_push() -> None:
    y = np.random.default_rng(6).normal(size=(500, 4, 3))
    y[:, 2] = 0.0
    assert len(felt_by(y, 200, 210)) == 1
    y[205, [0, 3]] += 20.0
    assert felt_by(y, 200, 210) == (0, 3)


def test_what_effects_leave_is_weighted_least_squares() -> None:
    rng = np.random.default_rng(7)
    y, effects, shared = rng.normal(size=(4, 3, 3)), rng.normal(size=(3, 3, 2)), responses()
    own = rng.uniform(0.5, 2.0, size=(4, 3))
    expected = 0.0
    for residual, sd in zip(y.reshape(4, -1), own, strict=True):
        S = shared.swapaxes(0, 1)
        covariance = np.diag(np.repeat(sd**2, 3)) + sum(
            np.outer(v, v) for v in S.swapaxes(0, 1).reshape(3, -1)
        )
        root = np.linalg.cholesky(np.linalg.inv(covariance)).T
        _, left, *_ = np.linalg.lstsq(root @ effects.reshape(-1, 2), root @ residual, rcond=None)
        expected += float(left[0])
    assert unexplained(y, own, shared, effects) == pytest.approx(expected)
    whole = unexplained(y, own, shared, np.zeros_like(effects))
    assert whole > expected
