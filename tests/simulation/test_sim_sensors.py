from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skin2urdf.geometry.units import GRAVITY
from skin2urdf.simulation import GRADES
from skin2urdf.simulation.sensors import (
    MIN_STAMP_STEP,
    Sensor,
    draw_sensor,
    encode,
    stamp,
)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_ideal_sensor_reads_the_truth() -> None:
    sensor = draw_sensor(GRADES["ideal"], rng())
    force = rng().uniform(-100, 100, (50, 3))
    np.testing.assert_array_equal(sensor.read(force, rng()), force)


@pytest.mark.parametrize(("name", "rms", "bits"), [("mems", 1e-3, 16), ("bma150", 8e-3, 10)])
def test_noise_and_resolution(name: str, rms: float, bits: int) -> None:
    grade = GRADES[name]
    sensor = Sensor(grade, np.eye(3), np.zeros(3))
    readings = sensor.read(np.tile([0.3, -5.0, 9.0], (40_000, 1)), rng())
    # Rounding adds the variance of a uniform distribution of one digit.
    expected = np.hypot(rms * GRAVITY, grade.step / np.sqrt(12))
    np.testing.assert_allclose(readings.std(axis=0), expected, rtol=0.03)
    np.testing.assert_allclose(readings.mean(axis=0), [0.3, -5.0, 9.0], atol=2e-3)
    counts = readings / grade.step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert grade.full_scale is not None
    assert grade.step == pytest.approx(2 * grade.full_scale * GRAVITY / 2**bits)


def test_saturation_uses_every_count_and_no_more() -> None:
    sensor = Sensor(GRADES["bma150"], np.eye(3), np.zeros(3))
    readings = sensor.read(np.array([[-1e3, 1e3, 0.0]]), rng())
    step = GRADES["bma150"].step
    np.testing.assert_allclose(readings[0, :2], [-512 * step, 511 * step])


def test_clipping_without_rounding() -> None:
    grade = replace(GRADES["ideal"], full_scale=1.0)
    readings = Sensor(grade, np.eye(3), np.zeros(3)).read(np.array([[-20.0, 3.0, 20.0]]), rng())
    np.testing.assert_allclose(readings, [[-GRAVITY, 3.0, GRAVITY]])


def test_sensor_matrix_and_bias_are_what_is_read() -> None:
    grade = replace(GRADES["bma150"], noise_rms=0.0, bits=None, full_scale=None)
    sensor = draw_sensor(grade, rng(5))
    readings = sensor.read(np.vstack([np.zeros(3), np.eye(3)]), rng())
    np.testing.assert_allclose(readings[0], sensor.bias)
    np.testing.assert_allclose((readings[1:] - readings[0]).T, sensor.matrix, atol=1e-12)


def test_production_spread() -> None:
    grade = GRADES["bma150"]
    sensors = [draw_sensor(grade, r) for r in rng().spawn(400)]
    errors = np.array([s.matrix for s in sensors]) - np.eye(3)
    diagonal = np.einsum("nii->ni", errors)
    off = errors[:, ~np.eye(3, dtype=bool)]
    bias = np.array([s.bias for s in sensors]) / GRAVITY
    for values, limit in ((diagonal, 0.03), (off, 0.01), (bias, 0.06)):
        assert np.abs(values).max() <= limit
        assert np.abs(values).max() > 0.97 * limit
        assert values.std() == pytest.approx(limit / np.sqrt(3), rel=0.05)


@given(
    position=st.floats(-10, 10),
    resolution=st.sampled_from([1e-6, 2 * np.pi / 2**12, 2 * np.pi / 2**17]),
)
def test_encoder_is_within_half_a_count(position: float, resolution: float) -> None:
    measured = encode(np.array([[position, position]]), np.array([resolution, 0.0]))
    assert measured[0, 1] == position
    assert abs(measured[0, 0] - position) <= 0.5 * resolution * (1 + 1e-6)
    assert measured[0, 0] / resolution == pytest.approx(
        round(measured[0, 0] / resolution), abs=1e-6
    )


def test_stamps_have_jitter_and_lag() -> None:
    time = np.arange(50_000) / 500.0
    stamps = stamp(time, 1e-4, 5e-3, rng())
    error = stamps - time - 5e-3
    assert error.std() == pytest.approx(1e-4, rel=0.03)
    assert abs(error.mean()) < 5e-6


@given(jitter=st.sampled_from([0.0, 1e-4, 1e-2]), seed=st.integers(0, 100))
def test_stamps_increase_whatever_the_jitter(jitter: float, seed: int) -> None:
    time = np.arange(2_000) / 500.0
    stamps = stamp(time, jitter, 0.0, rng(seed))
    assert np.diff(stamps).min() >= MIN_STAMP_STEP * 0.999
    # No drift: the order is kept without pushing later stamps away.
    assert abs(stamps[-1] - time[-1]) <= 10 * jitter + 1e-9
