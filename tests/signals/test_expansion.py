"""Clocks by functions of the joints over a whole log."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.signals.expansion import Expansion, searched
from skin2urdf.signals.filters import second_derivative

RATE = 30.0
LENGTHS = np.array([0.35, 0.3, 0.05])


def series(rng: np.random.Generator, seconds: float, lowest: float) -> F64:
    """(n, 3) positions of three joints, each a sum of five harmonics of a frequency [Hz]."""
    t = np.arange(int(seconds * RATE)) / RATE
    k = np.arange(1, 6)
    phase = np.outer(2 * np.pi * lowest * k, t)
    a, b = 0.5 * rng.normal(size=(2, 3, 5)) / k
    return np.asarray((a @ np.sin(phase) + b @ np.cos(phase)).T)


def felt_at_the_tip(q: F64, rng: np.random.Generator) -> F64:
    """(n, 3) what an accelerometer reads at the end of three links in a level plane [m/s^2]."""
    angle = np.cumsum(q, axis=1)
    tip = (np.stack([np.cos(angle), np.sin(angle)], axis=2) * LENGTHS[:, None]).sum(axis=1)
    x, y = second_derivative(tip, RATE).T
    c, s = np.cos(angle[:, -1]), np.sin(angle[:, -1])
    felt = np.stack([c * x + s * y, c * y - s * x, np.full(len(q), 9.81)], axis=1)
    return np.asarray(felt + 0.01 * rng.normal(size=felt.shape))


@pytest.mark.parametrize("seed", [0, 1, 5, 7])
def test_a_motion_that_comes_back_tells_no_clock(seed: int) -> None:
    """Few frequencies are few values, however long the log is: terms explain them at any lag."""
    rng = np.random.default_rng(seed)
    q = series(rng, 100.0, 0.1)
    readings = felt_at_the_tip(q, rng)
    whole = np.ones(len(q), dtype=bool)
    assert searched(readings, whole, Expansion(q, RATE), RATE, 2.0, 0.01) is None


def test_what_share_of_a_log_is_new() -> None:
    """A round and a bit of it are one, and what stands still comes back to nothing."""
    rng = np.random.default_rng(3)
    q = series(rng, 100.0, 0.1)
    assert Expansion(q, RATE).new == pytest.approx(0.1, abs=0.001)
    assert Expansion(q[: int(15 * RATE)], RATE).new == 1.0
    assert Expansion(np.cumsum(rng.normal(size=(3000, 3)), axis=0), RATE).new == 1.0
    assert Expansion(np.zeros((3000, 3)), RATE).new == 1.0
