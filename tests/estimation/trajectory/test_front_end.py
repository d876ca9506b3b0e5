"""What a sensor's low-pass makes of readings, wherever a fit may look for it."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from skin2urdf.estimation.trajectory.front_end import (
    Spectrum,
    front_end,
    front_end_slopes,
    transfer,
)

GRID = 2 * np.pi * np.linspace(0.5, 62.0, 200)
"""Angular frequencies of a log's grid [rad/s]."""
SQUARES = st.floats(-1e-4, 1e-4)
"""Coordinates as far as a step may lead [s^2]: those of a low-pass of 16 Hz, and of what rises."""


@given(SQUARES, SQUARES)
def test_no_front_end_rings(p: float, r: float) -> None:
    """A pole on the axis would make any reading out of none, and no step of a fit leads past it."""
    H, _ = transfer(GRID, np.array([[p, r]]))
    # The most that a factor of second order can rise to at the highest frequency, and some.
    assert np.abs(H).max() < 2 * (1 + 2e-4 * GRID[-1] ** 2)


@given(SQUARES, SQUARES)
def test_its_droop_is_that_of_its_coordinates(p: float, r: float) -> None:
    low = GRID[:1] / 5
    H, _ = transfer(low, np.array([[p, r]]))
    np.testing.assert_allclose(np.abs(H[0, 0]), 1 - (0.5 * p - r) * low[0] ** 2, atol=2e-6)


@given(st.floats(1e-6, 1e-4), st.floats(-1e-4, 1e-4))
def test_slopes_are_those_of_differences(p: float, r: float) -> None:
    front, h = np.array([[p, r]]), 1e-10
    if abs(r - p) < 2 * h:  # where poles would begin to ring the slope changes at once
        return
    _, slopes = transfer(GRID, front)
    for k in range(2):
        step = h * np.eye(2)[k]
        ahead, behind = transfer(GRID, front + step)[0], transfer(GRID, front - step)[0]
        numeric = (ahead - behind) / (2 * h)
        assert np.abs(slopes[k] - numeric).max() < 1e-3 * np.abs(numeric).max()


def test_nothing_steps_where_a_log_begins_and_ends() -> None:
    """A reading that only grows goes through, from the first sample to the last."""
    line = 9.8 - 0.1 * np.arange(400.0).reshape(1, 1, -1)
    front = np.array([[5e-5, 2e-5]])
    np.testing.assert_allclose(front_end(Spectrum.of(line, 30.0, 20), front), line, atol=1e-9)
    by_front = front_end_slopes(*[Spectrum.of(line, 30.0, 20)] * 2, front)[1]
    np.testing.assert_allclose(by_front, 0.0, atol=1e-5)


def test_what_swings_is_as_the_transfer_function_says() -> None:
    rate, f = 30.0, 3.0
    t = np.arange(600) / rate
    front = np.array([[5e-5, 2e-5]])
    H = transfer(np.array([2 * np.pi * f]), front)[0][0, 0]
    swing = np.exp(2j * np.pi * f * t)
    found = front_end(Spectrum.of(np.stack([swing.real, swing.imag])[None], rate, 20), front)[0]
    inside = slice(100, -100)
    np.testing.assert_allclose(found[0, inside], (H * swing).real[inside], atol=1e-4)
    np.testing.assert_allclose(found[1, inside], (H * swing).imag[inside], atol=1e-4)
