"""What the encoders' resolution does is as large as said."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.signals.rounding import hidden_motion, rest_pull, rounded_away, tones, white_noise


@pytest.mark.parametrize("steps", [0.3, 1.0, 5.0, 30.0])
def test_rounding_a_sine_hides_as_much_of_it_as_said(steps: float) -> None:
    """Over all positions of the sine between two steps of the encoder."""
    phase = np.linspace(0.0, 2 * np.pi, 4000, endpoint=False)
    amplitude = steps * np.linspace(0.98, 1.02, 5)[:, None, None]
    value = amplitude * np.sin(phase) + np.linspace(0.0, 1.0, 40, endpoint=False)[:, None]
    error = 2 * ((np.round(value) - value) @ np.sin(phase)) / len(phase)
    assert rounded_away(amplitude[:, 0, 0]).mean() == pytest.approx((error**2).mean(), rel=0.25)


def test_hidden_motion_of_a_joint_that_moves_along() -> None:
    t = np.arange(0.0, 2.0, 0.01)
    omega = 2 * np.pi * 2.0
    amplitude = np.array([0.05, 4e-4])
    dq = amplitude * np.sin(omega * t)[:, None]
    hidden, omega2 = hidden_motion(dq, -(omega**2) * dq, np.array([1e-4, 1e-4]))
    np.testing.assert_allclose(omega2, omega**2, rtol=1e-2)
    wanted = rounded_away(np.array(4.0)) * 1e-8 / (0.05 * omega**2) ** 2
    assert hidden[0, 1] == pytest.approx(wanted, rel=0.3)


def test_two_tones_are_found_as_they_are() -> None:
    t = np.arange(0.0, 12.0, 0.04)
    window = np.clip(np.minimum(t, 12.0 - t) / 0.5, 0.0, 1.0)
    omega = 2 * np.pi * np.array([1.3, 2.9])
    size = np.array([0.06, 0.02])
    waves = size * np.sin(omega * t[:, None] + [0.3, 1.1]) * window[:, None]
    one = -(omega[1] ** 2) * waves[:, 1]
    both = -(waves @ omega**2)
    squares = tones(np.stack([both, one, np.zeros(len(t))], axis=1), 25.0, 10.0)
    np.testing.assert_allclose(squares[0], omega**2, rtol=0.02)
    np.testing.assert_allclose(squares[1], omega[1] ** 2, rtol=0.02)
    assert not squares[2].any()


def test_noise_of_a_joint_that_moves_half_of_the_time_of_a_pattern() -> None:
    t = np.arange(0.0, 10.0, 0.004)
    qdd = np.stack([np.sin(14 * t), np.zeros(len(t))], axis=1)
    moving = np.stack([t >= 0.0, t < 5.0], axis=1)
    said = white_noise(qdd, moving, np.array([1e-10, 4e-10]))
    np.testing.assert_allclose(said[0], [1e-10, 2e-10], rtol=0.01)
    assert not said[1].any()


def test_an_error_at_rest_bends_the_coefficients_of_a_pattern() -> None:
    """A pattern that swings to one side: f0 rests on the samples before it, and s leans on them."""
    t = np.linspace(0.0, 4.0, 800)
    moving = np.stack([t > 0.5, np.zeros(800, dtype=bool)], axis=1)
    swing = np.where(moving[:, 0], 1 - np.cos(12 * (t - 0.5)), 0.0)
    push = np.where(moving[:, 0], 144 * np.cos(12 * (t - 0.5)), 0.0)
    X = np.stack([np.ones(800), 0.05 * swing, np.zeros(800), 0.05 * push, np.zeros(800)], axis=1)
    pull = rest_pull(X, moving)
    error = 1e-3
    bent = np.linalg.lstsq(X, error * ~moving[:, 0], rcond=None)[0]
    np.testing.assert_allclose(pull[0] * error * (~moving[:, 0]).mean(), bent, atol=1e-12)
    assert pull[0, 0] > 3.0
    # The other joint rests all the time: that is gravity's alone.
    np.testing.assert_array_equal(pull[1], np.eye(5)[0])
