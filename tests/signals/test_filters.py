"""Streams of any rate come out on the grid as if they had been sampled there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skin2urdf.arrays import F64
from skin2urdf.signals.filters import (
    Grid,
    eroded,
    filtered,
    first_derivative,
    low_pass,
    noise_bandwidth,
    passed,
    sample,
    second_derivative,
    shifted,
)

GRID = Grid(0.5, 125.0, 1400)
TONES = np.array([0.5, 2.0, 3.1, 4.0])
"""Frequencies of patterns [Hz]."""


def tones(time: F64, frequencies: F64 = TONES) -> F64:
    """(N, C) one sine per column."""
    return np.sin(2 * np.pi * frequencies * time[:, None] + 0.3)


def stamps(rate: float, irregularity: float, rng: np.random.Generator) -> F64:
    """Increasing times that cover the grid, each off its place by a share of the period."""
    t = np.arange(0.0, 12.5, 1 / rate)
    return t + irregularity / rate * rng.uniform(-0.5, 0.5, t.size)


def gain(values: F64, time: F64) -> F64:
    """(C,) complex gain of every column's tone."""
    out = []
    for f, column in zip(TONES, values.T, strict=True):
        phase = 2 * np.pi * f * time + 0.3
        basis = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        a, b = np.linalg.lstsq(basis, column, rcond=None)[0]
        out.append(complex(a, b))
    return np.array(out)


@given(
    rate=st.one_of(st.floats(200.0, 650.0), st.floats(950.0, 2500.0)),
    irregularity=st.floats(0.0, 0.2),
    seed=st.integers(0, 99),
)
@settings(max_examples=40, deadline=None)
def test_a_band_limited_signal_is_restored(rate: float, irregularity: float, seed: int) -> None:
    time = stamps(rate, irregularity, np.random.default_rng(seed))
    values, ok = sample(time, tones(time), GRID)
    assert ok.all()
    np.testing.assert_allclose(values, tones(GRID.time), atol=1.2e-4)


@pytest.mark.parametrize("rate", [100.0, 125.0])
def test_slow_streams_keep_the_patterns(rate: float) -> None:
    time = stamps(rate, 0.1, np.random.default_rng(0))
    values, ok = sample(time, tones(time), GRID)
    assert ok.all()
    np.testing.assert_allclose(values, tones(GRID.time), atol=1e-4)


@pytest.mark.parametrize("rate", [200.0, 250.0, 333.0, 500.0, 1000.0, 2000.0])
def test_every_rate_has_the_same_gain(rate: float) -> None:
    """Encoders and SUs go through different rates; their ratio is the lever arm."""
    time = np.arange(0.0, 12.5, 1 / rate)
    values, _ = sample(time, tones(time), GRID)
    np.testing.assert_allclose(gain(values, GRID.time), 1.0, atol=1.2e-5)


@pytest.mark.parametrize("rate", [100.0, 250.0, 480.0, 1000.0])
def test_even_and_uneven_streams_come_out_alike(rate: float) -> None:
    """They take different ways; a drift of the clock keeps a stream even."""
    t = np.arange(0.0, 12.5, 1 / rate)
    even = t + 1e-4 * np.sin(0.5 * t)
    uneven = stamps(rate, 0.01, np.random.default_rng(2))
    one, other = (sample(time, tones(time), GRID)[0] for time in (even, uneven))
    np.testing.assert_allclose(one, other, atol=3e-5)


def test_what_a_grid_can_not_hold_is_filtered_out() -> None:
    time = stamps(500.0, 0.0, np.random.default_rng(0))
    alias = np.array([90.0, 118.0, 150.0, 220.0])
    values, _ = sample(time, tones(time, alias), GRID)
    assert abs(values).max() < 2e-3


@pytest.mark.parametrize(("rate", "length"), [(250.0, 0.1), (500.0, 0.05), (1000.0, 0.5)])
def test_gaps_are_marked_and_do_no_harm_around_them(rate: float, length: float) -> None:
    time = stamps(rate, 0.05, np.random.default_rng(1))
    time = time[(time < 5.0) | (time > 5.0 + length)]
    values, ok = sample(time, tones(time), GRID)
    t = GRID.time
    assert not ok[(t > 5.0) & (t < 5.0 + length)].any()
    assert ok[(t < 4.9) | (t > 5.1 + length)].all()
    np.testing.assert_allclose(values[ok], tones(t)[ok], atol=3e-4)


@pytest.mark.parametrize("rate", [50.0, 200.0, 500.0])
def test_stamps_that_lie_on_each_other_leave_noise_what_it_is(rate: float) -> None:
    """Stamps that scatter by more than half a period, in order, as drivers make them on arrival."""
    rng = np.random.default_rng(3)
    time = np.arange(int(20 * rate)) / rate
    stamps = np.maximum.accumulate(time + 0.6 / rate * rng.standard_normal(len(time)))
    stamps += 1e-6 * np.arange(len(time))
    noise = rng.standard_normal((len(time), 1))
    grid = Grid(0.0, 100.0, 2000)
    found, whole = sample(stamps, noise, grid)
    assert whole.mean() > 0.9
    assert np.abs(found[whole]).max() < 10.0


def test_beyond_a_stream_nothing_is_valid() -> None:
    time = np.arange(2.0, 8.0, 0.004)
    values, ok = sample(time, tones(time), GRID)
    t = GRID.time
    assert not ok[(t < 2.0) | (t > 8.0)].any()
    assert ok[(t > 2.1) & (t < 7.9)].all()
    np.testing.assert_allclose(values[ok], tones(t)[ok], atol=1e-4)


def test_a_handful_of_samples_is_no_stream() -> None:
    values, ok = sample(np.arange(5) / 100, np.ones((5, 2)), GRID)
    assert values.shape == (GRID.size, 2)
    assert not ok.any()


def test_derivatives_are_those_of_the_signal() -> None:
    t, w = GRID.time, 2 * np.pi * TONES
    inside = slice(10, -10)
    phase = w * t[:, None] + 0.3
    first = first_derivative(tones(t), GRID.rate)[inside]
    second = second_derivative(tones(t), GRID.rate)[inside]
    np.testing.assert_allclose(first, (w * np.cos(phase))[inside], atol=1e-7 * w.max())
    np.testing.assert_allclose(second, (-(w**2) * np.sin(phase))[inside], atol=1e-7 * w.max() ** 2)


@given(delay=st.floats(-0.03, 0.03))
@settings(max_examples=25, deadline=None)
def test_a_shift_reads_the_stream_later(delay: float) -> None:
    t = GRID.time
    values = shifted(tones(t), GRID.rate, delay)
    inside = slice(10, -10)
    np.testing.assert_allclose(values[inside], tones(t + delay)[inside], atol=2e-5)


def test_no_shift_is_no_change() -> None:
    values = tones(GRID.time)
    assert shifted(values, GRID.rate, 0.0) is values


@pytest.mark.parametrize("cutoff", [5.0, 10.0, 20.0])
def test_the_low_pass_has_its_corner_and_its_stopband(cutoff: float) -> None:
    taps = low_pass(cutoff, 125.0)
    k = np.arange(taps.size) - taps.size // 2

    def response(f: float) -> float:
        return float(taps @ np.cos(2 * np.pi * f * k / 125.0))

    assert taps.size % 2 == 1
    assert response(0.0) == pytest.approx(1.0, abs=1e-12)
    assert response(cutoff) == pytest.approx(0.5, abs=0.01)
    assert response(0.5 * cutoff) == pytest.approx(1.0, abs=2e-5)
    assert all(abs(response(f)) < 2e-5 for f in np.arange(1.5 * cutoff, 62.0, 0.7))


@pytest.mark.parametrize("n", [30, 2000])
def test_filtering_leaves_the_pass_band_in_phase(n: int) -> None:
    """Short and long signals take different ways to the same result."""
    taps, t = low_pass(12.0, 125.0), np.arange(n) / 125.0
    constant = filtered(np.full((n, 2), 3.0), taps)
    np.testing.assert_allclose(constant, 3.0, rtol=1e-12)
    if n > 4 * taps.size:
        inside = slice(taps.size, -taps.size)
        np.testing.assert_allclose(filtered(tones(t), taps)[inside], tones(t)[inside], atol=3e-5)


def test_filtering_a_long_signal_is_the_plain_sum() -> None:
    x = np.random.default_rng(0).standard_normal((400, 3))
    taps = low_pass(15.0, 125.0)
    half = taps.size // 2
    padded = np.pad(x, [(half, half), (0, 0)], mode="edge")
    plain = np.stack([np.convolve(column, taps, mode="valid") for column in padded.T], axis=1)
    np.testing.assert_allclose(filtered(x, taps), plain, atol=1e-12)


def test_noise_bandwidth_is_what_white_noise_keeps() -> None:
    taps = low_pass(12.0, 125.0)
    noise = np.random.default_rng(0).standard_normal((100_000, 1))
    kept = filtered(noise, taps)[200:-200].var()
    assert kept == pytest.approx(2 * noise_bandwidth(taps, 125.0) / 125.0, rel=0.03)


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.integers(0, 7))
def test_erosion_keeps_what_is_whole_all_around(bits: list[bool], reach: int) -> None:
    kept = eroded(np.array(bits), reach)
    for i in range(len(bits)):
        assert kept[i] == all(bits[max(0, i - reach) : i + reach + 1])


@pytest.mark.parametrize(("every", "size"), [(1, 200), (5, 1003), (5, 118)])
def test_what_is_low_passed_where_it_is_wanted_is_what_is_low_passed_everywhere(
    every: int, size: int
) -> None:
    taps = low_pass(10.0, 125.0)
    values = np.random.default_rng(0).standard_normal((3, size))
    found = passed(values, np.stack([taps, 2 * taps]), every)
    half = len(taps) // 2
    whole = filtered(values.T, taps)[half : size - half : every].T
    np.testing.assert_allclose(found, np.stack([whole, 2 * whole], axis=1), rtol=0, atol=1e-12)
