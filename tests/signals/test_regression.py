"""The regression gives the coefficients that made the readings, and says how well."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skin2urdf.arrays import F64
from skin2urdf.signals.coloured import Coloured
from skin2urdf.signals.filters import (
    filtered,
    low_pass,
    noise_bandwidth,
    second_derivative,
)
from skin2urdf.signals.regression import (
    Design,
    Fit,
    enough,
    excited,
    fit,
    informative,
    orthonormal,
    regressors,
)

RATE, CUTOFF = 125.0, 10.0
TAPS = low_pass(CUTOFF, RATE)
INDEPENDENCE = 2 * noise_bandwidth(TAPS, RATE) / RATE
FREQUENCIES = ((1.0, 2.6), (1.4, 3.2), (1.9, 3.9))
"""Two tones for each DoF [Hz]."""


def swings(n: int, size: float = 0.08, n_dofs: int = 3) -> tuple[F64, F64, F64]:
    """(n, D) position, velocity and acceleration of DoFs that swing all at once."""
    t = np.arange(n)[:, None] / RATE
    parts = [np.zeros((n, n_dofs)) for _ in range(3)]
    for d, tones in enumerate(FREQUENCIES[:n_dofs]):
        for i, f in enumerate(tones):
            w, a = 2 * np.pi * f, size / (1 + i)
            phase = w * t[:, 0] + d + 2 * i
            parts[0][:, d] += a * np.sin(phase)
            parts[1][:, d] += a * w * np.cos(phase)
            parts[2][:, d] -= a * w**2 * np.sin(phase)
    return parts[0], parts[1], parts[2]


def fitted(X: F64, Z: F64, y: F64, noise: F64 | None = None, noise_cross: F64 | None = None) -> Fit:
    noise = np.zeros(X.shape[1]) if noise is None else noise
    noise_cross = np.zeros((X.shape[1] - 1) // 2) if noise_cross is None else noise_cross
    return fit(Design(X, Z, noise, noise_cross), y, INDEPENDENCE)


@given(linear=st.booleans(), seed=st.integers(0, 999))
@settings(max_examples=30, deadline=None)
def test_exact_readings_give_exact_coefficients(linear: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    X, Z = regressors(*swings(900), linear)
    c = rng.standard_normal((2, X.shape[1], 3))
    y = np.einsum("nm,umi->nui", X, c)
    y = y + np.einsum("nk,uki->nui", Z, rng.standard_normal((2, Z.shape[1], 3)))
    result = fitted(X, Z, y)
    np.testing.assert_allclose(result.coefficients, c, atol=1e-7)
    assert abs(result.residual).max() < 1e-8
    assert result.deviation.max() < 1e-8


def test_the_exact_form_of_one_dof_needs_no_small_angle() -> None:
    """A + b cos + c sin + tau qdd + e qd^2 holds for swings of any size."""
    n = 1200
    t = np.arange(n) / RATE
    w = 2 * np.pi * 0.8
    # An SU at distance r from a horizontal axis, gravity g: exact planar mechanics.
    r, g = 0.35, 9.81
    q = 0.9 * np.sin(w * t) + 0.2 * np.sin(2.3 * w * t)
    qd = 0.9 * w * np.cos(w * t) + 0.46 * w * np.cos(2.3 * w * t)
    qdd = -0.9 * w**2 * np.sin(w * t) - 0.2 * (2.3 * w) ** 2 * np.sin(2.3 * w * t)
    y = np.stack([-r * qd**2 + g * np.sin(q + 0.4), r * qdd + g * np.cos(q + 0.4), 0 * q], axis=1)
    X, Z = regressors(q[:, None], qd[:, None], qdd[:, None], linear=False)
    result = fitted(X, Z, y[:, None])
    f0, s, tau = result.coefficients[0]
    np.testing.assert_allclose(f0, [g * np.sin(0.4), g * np.cos(0.4), 0], atol=1e-6)
    np.testing.assert_allclose(s, [g * np.cos(0.4), -g * np.sin(0.4), 0], atol=1e-6)
    np.testing.assert_allclose(tau, [0, r, 0], atol=1e-6)


def test_several_sus_share_one_solution_as_if_alone() -> None:
    rng = np.random.default_rng(1)
    X, Z = regressors(*swings(600), linear=False)
    y = rng.standard_normal((600, 4, 3))
    together = fitted(X, Z, y)
    for u in range(4):
        alone = fitted(X, Z, y[:, u : u + 1])
        np.testing.assert_allclose(together.coefficients[u], alone.coefficients[0], atol=1e-9)
        np.testing.assert_allclose(together.deviation[u], alone.deviation[0], rtol=1e-9)


def test_filtering_both_sides_alike_changes_no_coefficient() -> None:
    rng = np.random.default_rng(2)
    X, _ = regressors(*swings(1500), linear=True)
    c = rng.standard_normal((1, X.shape[1], 3))
    y = filtered(np.einsum("nm,umi->nui", X, c), TAPS)[100:-100]
    X = filtered(X, TAPS)[100:-100]
    np.testing.assert_allclose(fitted(X, np.zeros((1300, 0)), y).coefficients, c, atol=1e-7)


def test_noise_in_the_regressors_is_allowed_for() -> None:
    """Monte Carlo: plain least squares shrinks coefficients, the corrected one does not."""
    n, runs = 500, 300
    dq, qd, qdd = swings(n, n_dofs=1)
    X, Z = regressors(dq, qd, qdd, linear=True)
    c = np.array([[9.0, 1.0, 3.0], [2.0, -9.0, 1.0], [0.4, 0.1, -0.3]])
    variance = np.array([0.0, 0.2 * dq.var(), 0.2 * qdd.var()])
    rng = np.random.default_rng(3)
    plain, corrected = np.zeros((runs, 3, 3)), np.zeros((runs, 3, 3))
    for run in range(runs):
        seen = X + np.sqrt(variance) * rng.standard_normal(X.shape)
        y = (X @ c)[:, None]
        plain[run] = fitted(seen, Z, y).coefficients[0]
        corrected[run] = fitted(seen, Z, y, variance).coefficients[0]
    error = corrected.mean(axis=0) - c
    sd = corrected.std(axis=0) / np.sqrt(runs)
    assert (abs(error) < 5 * sd + 0.02 * abs(c)).all()
    shrunk = plain.mean(axis=0)
    assert abs(shrunk[2, 0]) < 0.9 * abs(c[2, 0])
    assert abs(error[2, 0]) < 0.2 * abs(shrunk[2, 0] - c[2, 0])


def test_noise_that_position_and_acceleration_share_is_allowed_for() -> None:
    """One encoder makes both regressors; a swing of one frequency keeps them almost collinear."""
    n, pad, runs, sd = 600, 200, 200, 2e-3
    t = (np.arange(n + 2 * pad) - pad) / RATE
    q = 0.1 * np.sin(2 * np.pi * 2.0 * t) * (1 + 0.5 * np.sin(2 * np.pi * 0.35 * t))
    inside = slice(pad, -pad)

    def seen(position: F64) -> F64:
        p = filtered(position[:, None], TAPS)
        columns = [np.ones_like(p), p, second_derivative(p, RATE)]
        return np.concatenate(columns, axis=1)[inside]

    c = np.array([[9.0, 1.0, 3.0], [2.0, -9.0, 1.0], [0.4, 0.1, -0.3]])
    y = (seen(q) @ c)[:, None]
    rng = np.random.default_rng(11)
    noise = seen(sd * rng.standard_normal(200_000)) - [1.0, 0.0, 0.0]
    covariance = noise.T @ noise / len(noise)
    diagonal, cross = np.diag(covariance), covariance[1:2, 2]
    assert cross[0] < -0.6 * np.sqrt(diagonal[1] * diagonal[2])
    error = {True: np.zeros((3, 3)), False: np.zeros((3, 3))}
    for _ in range(runs):
        X = seen(q + sd * rng.standard_normal(q.size))
        for shared in error:
            known = cross if shared else None
            found = fitted(X, np.zeros((n, 0)), y, diagonal, known).coefficients[0]
            error[shared] += (found - c) / runs
    assert abs(error[True][2]).max() < 0.35 * abs(error[False][2]).max()


@pytest.mark.parametrize("quiet", [0, 1, 2])
def test_a_dof_that_keeps_still_carries_no_information(quiet: int) -> None:
    dq, qd, qdd = swings(700)
    for part in (dq, qd, qdd):
        part[:, quiet] = 0.0
    rng = np.random.default_rng(4)
    noise = np.r_[0.0, np.full(3, 1e-9), np.full(3, 1e-4)]
    X, Z = regressors(dq, qd, qdd, linear=True)
    X[:, 1:] += np.sqrt(noise[1:]) * rng.standard_normal((700, 6))
    X = excited(X, noise)
    silent = [1 + quiet, 4 + quiet]
    assert not X[:, silent].any()
    c = rng.standard_normal((1, 7, 3))
    result = fitted(X, Z, np.einsum("nm,umi->nui", X, c), noise)
    assert not result.information[silent].any()
    assert not result.coefficients[0, silent].any()
    others = [i for i in range(7) if i not in silent]
    assert (np.diag(result.information)[others] > 0).all()
    np.testing.assert_allclose(result.coefficients[0, others], c[0, others], rtol=0.02, atol=0.02)


def test_an_acceleration_lost_in_noise_takes_its_position_along() -> None:
    """A position left on its own would stand for both, and be wrong by lever times omega^2."""
    X, _ = regressors(*swings(700), linear=True)
    noise = np.zeros(7)
    noise[5] = X[:, 5].var()
    kept = excited(X, noise)
    assert not kept[:, [2, 5]].any()
    others = [0, 1, 3, 4, 6]
    np.testing.assert_array_equal(kept[:, others], X[:, others])


def test_the_constant_is_never_taken_for_quiet() -> None:
    X = np.ones((100, 3))
    kept = excited(X, np.zeros(3))
    np.testing.assert_array_equal(kept[:, 0], 1.0)
    assert not kept[:, 1:].any()


def test_two_dofs_that_move_as_one_share_what_they_do() -> None:
    """What can not be told apart gets no information in the difference."""
    dq, qd, qdd = (part[:, [0, 0]] for part in swings(700))
    X, Z = regressors(dq, qd, qdd, linear=True)
    y = (X @ np.array([[9.0], [2.0], [4.0], [0.3], [0.5]]))[:, None] * np.ones(3)
    result = fitted(X, Z, y)
    np.testing.assert_allclose(result.coefficients[0, :, 0], [9, 3, 3, 0.4, 0.4], atol=1e-6)
    apart = np.array([0, 1, -1, 0, 0.0])
    scale = np.diag(result.information)[1]
    assert apart @ result.information @ apart < 1e-6 * scale


def z_scores(kind: str, runs: int, seed: int, linear: bool, by_row: bool = True) -> F64:
    """(runs, m, 3) errors of the coefficients over their standard deviations.

    Args:
        kind: ``white`` noise of the accelerometer, or ``encoder``: noise that grows with the
            square of frequency and is there while the joint moves.
        runs: number of noise draws.
        seed: of the draws.
        linear: whether the nuisances are left out.
        by_row: whether each regressor's own noise is allowed for.
    """
    pad, n = 200, 1100
    dq, qd, qdd = swings(n + 2 * pad, n_dofs=2)
    t = (np.arange(n + 2 * pad) - pad) / RATE
    at_work = np.stack([(t > 0.5) & (t < 3.8), (t > 4.8) & (t < 8.0)], axis=1) * 1.0
    window = filtered(at_work, low_pass(3.0, RATE))
    X, Z = regressors(dq * window, qd * window, qdd * window, linear)
    X, Z = (filtered(x, TAPS) if x.shape[1] else x for x in (X, Z))
    rng = np.random.default_rng(seed)
    inside = slice(pad, -pad)
    Xi, Zi = X[inside], Z[inside]
    out = []
    for _ in range(runs):
        noise = 0.02 * rng.standard_normal((n + 2 * pad, 1, 3))
        if kind == "encoder":
            raw = rng.standard_normal((n + 2 * pad, 1, 3))
            bent = np.diff(raw, n=2, axis=0, prepend=0.0, append=0.0)
            busy = np.maximum(window[:, 0], window[:, 1])[:, None, None]
            noise = 0.1 * noise + 1.5 * bent * busy
        y = filtered(noise, TAPS)[inside]
        result = fitted(Xi, Zi, y)
        basis = orthonormal(np.concatenate([Xi, Zi], axis=1))
        colour = Coloured.of(result.residual, basis, RATE, CUTOFF, INDEPENDENCE)
        own = Xi - orthonormal(Zi) @ (orthonormal(Zi).T @ Xi)
        G, gain = colour.factored(result.information, own * np.sqrt(INDEPENDENCE))
        G = G / np.sqrt(colour.by_time(Xi))[0, :, None]
        coloured = (G * gain[0]) @ G.T
        covariance = np.linalg.inv(coloured if by_row else result.information)
        sd = np.sqrt(np.diag(covariance))[:, None] * result.deviation[0]
        out.append(result.coefficients[0] / sd)
    return np.array(out)


@pytest.mark.parametrize("linear", [True, False])
def test_white_noise_gives_the_covariance_that_is_stated(linear: bool) -> None:
    z = z_scores("white", 250, 5, linear)
    rms = np.sqrt((z**2).mean(axis=(0, 2)))
    np.testing.assert_allclose(rms, 1.0, atol=0.16)
    assert abs(z.mean(axis=(0, 2))).max() < 0.15


def test_noise_of_encoders_gives_nearly_the_covariance_that_is_stated() -> None:
    """Coloured and unsteady noise, which ordinary least squares would misjudge by factors."""

    def rms(by_row: bool) -> F64:
        z = z_scores("encoder", 250, 6, linear=True, by_row=by_row)
        return np.sqrt((z**2).mean(axis=(0, 2)))

    ordinary, found = rms(False), rms(True)
    f0, s, tau = found[:1], found[1:3], found[3:]
    assert ordinary.min() < 0.35
    # Lever arms matter most; little is lost where f0 and s are taken for less certain than true.
    assert ((tau > 0.75) & (tau < 1.25)).all()
    assert ((s > 0.75) & (s < 1.25)).all()
    assert ((f0 > 0.55) & (f0 < 1.25)).all()


def test_noise_without_shape_is_the_same_for_all_regressors() -> None:
    rng = np.random.default_rng(7)
    X, _ = regressors(*swings(3000), linear=True)
    X = filtered(X, TAPS)
    residual = filtered(rng.standard_normal((3000, 2, 3)), TAPS)
    colour = Coloured.of(residual, orthonormal(X), RATE, CUTOFF, INDEPENDENCE)
    assert colour.by_time(X).shape == (2, 7)
    np.testing.assert_allclose(colour.by_time(X), 1.0, atol=0.25)
    information = X.T @ X
    G, gain = colour.factored(information, X)
    np.testing.assert_allclose(G @ G.T, information, rtol=1e-6, atol=1e-6 * information.max())
    # The pass band holds a little more than its share of the noise: the filter's skirt takes some.
    np.testing.assert_allclose(gain, 1.0, atol=0.25)


def test_many_regressors_leave_the_noise_of_encoders_as_it_is() -> None:
    """They take low frequencies, of which such noise has little."""
    rng = np.random.default_rng(8)
    n, t = 1100, np.arange(1100) / RATE
    raw = rng.standard_normal((n + 400, 40, 3))
    noise = filtered(np.diff(raw, n=2, axis=0, prepend=0.0, append=0.0), TAPS)[200:-200]

    def density(n_tones: int) -> F64:
        """Level of the steep part in units of the readings, as a fit with some tones finds it."""
        f = 0.3 + np.arange(n_tones) / 9.0
        phase = 2 * np.pi * f * t[:, None]
        basis = orthonormal(np.concatenate([np.sin(phase), np.cos(phase)], axis=1))
        residual = noise - np.tensordot(basis, np.tensordot(basis.T, noise, 1), 1)
        freedom = n * INDEPENDENCE - basis.shape[1]
        variance = (residual**2).mean(axis=2).sum(axis=0) * INDEPENDENCE / freedom
        level = Coloured.of(residual, basis, RATE, CUTOFF, INDEPENDENCE).level
        return level[:, 1] * variance

    assert np.mean(density(20)) == pytest.approx(np.mean(density(1)), rel=0.1)


@pytest.mark.parametrize(("n", "is_enough"), [(0, False), (31, False), (32, True), (500, True)])
def test_a_quarter_of_a_second_is_enough(n: int, is_enough: bool) -> None:
    samples = np.zeros(600, dtype=bool)
    samples[:n] = True
    assert enough(samples, RATE) is is_enough


def test_what_a_fit_tells_nothing_of_is_not_fitted() -> None:
    """A joint that differs by a milliradian from rest to rest, beside one that has a pattern."""
    rng = np.random.default_rng(8)
    t = np.arange(2000) / RATE
    dq = np.stack([0.04 * np.sin(12 * t), np.repeat([0.0, 1e-3, 5e-4, 2e-4], 500)], axis=1)
    qdd = np.stack([-144 * dq[:, 0], 1e-3 * rng.standard_normal(2000)], axis=1)
    X = np.concatenate([np.ones((2000, 1)), np.sin(dq), qdd], axis=1)
    X[:, 1] *= np.hanning(2000)
    y = X @ rng.standard_normal((5, 3)) + 0.1 * rng.standard_normal((2000, 3))
    nothing = Design(X, np.zeros((2000, 0)), np.zeros(5), np.zeros(2))
    known = informative(X, fit(nothing, y[:, None], INDEPENDENCE))
    assert known.any(axis=0).tolist() == [True, True, False, True, False]
    np.testing.assert_array_equal(known[:, [0, 1, 3]], X[:, [0, 1, 3]])


def test_a_window_too_short_for_the_band_has_white_noise() -> None:
    rng = np.random.default_rng(5)
    basis = np.linalg.qr(rng.standard_normal((12, 3)))[0]
    noise = Coloured.of(rng.standard_normal((12, 2, 3)), basis, 125.0, 5.0, 0.5)
    _, gain = noise.factored(np.eye(3), basis)
    np.testing.assert_array_equal(noise.level, [[1.0, 0.0], [1.0, 0.0]])
    np.testing.assert_allclose(gain, 1.0)
