"""What averages of readings with coarse digits are off by, against readings that are drawn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skin2urdf.arrays import F64
from skin2urdf.signals.digits import (
    alike,
    changes_share,
    left_by_averages,
    noise_in_digits,
    rounding,
)

RESTS, LENGTH, DIGIT = 400, 400, 0.04


def at_rest(noise: float, seed: int) -> tuple[F64, F64]:
    """Readings (RESTS, LENGTH, 3) of a sensor with digits in many rests, and what is true."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(-9.0, 9.0, (RESTS, 1, 3))
    felt = true + noise * DIGIT * rng.standard_normal((RESTS, LENGTH, 3))
    return np.round(felt / DIGIT) * DIGIT, true[:, 0]


@pytest.mark.parametrize("noise", [0.03, 0.1, 0.2, 0.3])
def test_averages_are_off_by_what_is_told(noise: float) -> None:
    readings, true = at_rest(noise, 1)
    off = np.sqrt(np.mean((readings.mean(axis=1) - true) ** 2))
    # Of which rounding is a part.
    by_noise = DIGIT * np.sqrt((noise**2 + 1 / 12) / LENGTH)
    samples = readings.reshape(-1, 3)
    digit, left = left_by_averages(samples, np.ones(len(samples), dtype=bool))
    assert digit == pytest.approx(DIGIT)
    assert off == pytest.approx(np.hypot(left, by_noise), rel=0.1)


def test_noise_as_large_as_digits_leaves_nothing() -> None:
    samples = at_rest(0.7, 2)[0].reshape(-1, 3)
    assert left_by_averages(samples, np.ones(len(samples), dtype=bool))[1] == 0.0


def test_a_sensor_without_digits_leaves_nothing() -> None:
    samples = np.random.default_rng(3).standard_normal((2000, 3))
    assert left_by_averages(samples, np.ones(2000, dtype=bool))[1] == 0.0


@given(st.floats(0.02, 3.0))
def test_noise_follows_from_how_often_readings_differ(noise: float) -> None:
    assert noise_in_digits(changes_share(np.array(noise))) == pytest.approx(noise, rel=0.01)


def test_readings_of_a_rest_count_as_one() -> None:
    """However long it is; and those of a fast motion each by itself."""
    still, fast = np.full((500, 1, 3), 0.3), np.linspace(-5.0, 5.0, 500)[:, None, None]
    digits = np.array([[DIGIT, 0.01]])
    readings = np.concatenate([still, np.tile(fast, (1, 1, 3)), -still])
    variance = rounding(readings, digits, 1.0)[:, 0]
    alone = 0.01**2
    for rest in (slice(0, 500), slice(1000, 1500)):
        information = (1 / (alone + variance[rest])).sum()
        assert 0.4 / alone < information < 2 / alone
    moving = (1 / (alone + variance[520:980])).sum()
    assert moving > 200 / alone


def test_what_comes_back_to_few_digits_is_off_alike_each_time() -> None:
    """An SU that gravity does not turn against tells of its bias once, in however many rests."""
    time = np.arange(4000)
    swings = np.where(time // 100 % 2, 0.02 * np.sin(0.7 * time), 0.0)
    readings = np.tile(swings[:, None, None], (1, 1, 3))
    variance = rounding(readings, np.array([[DIGIT, 0.01]]), 1.0)[:, 0]
    rests = time // 100 % 2 == 0
    assert (1 / (0.01**2 + variance[rests])).sum() < 3 / 0.01**2


def test_sensors_of_one_kind_are_as_quiet() -> None:
    one_kind = np.array([[0.04, 0.01], [0.04 + 1e-9, 0.008], [0.04, 0.001], [0.02, 0.001]])
    assert alike(one_kind)[:, 1].tolist() == [0.01, 0.008, 0.008, 0.001]
