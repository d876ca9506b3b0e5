"""Readings that no accelerometer gave: absurd ones, spikes, several publishers under one name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skin2urdf.arrays import F64
from skin2urdf.errors import UnreadableInputError
from skin2urdf.notes import of_reading
from skin2urdf.recording.credibility import FORCES_APART, absurd, several_publishers, spikes
from skin2urdf.recording.reading import read

EPOCH = 1_700_000_000 * 10**9
MS = 10**6


def moving(n: int, rng: np.random.Generator, noise: float = 0.02, digit: float = 0.0) -> F64:
    """Rests, patterns and a large move at 200 samples a second."""
    t = np.arange(n)[:, None] / 200.0
    swing = np.where(t % 6 < 3, np.sin(4 * np.pi * t), 0.0) * [3.0, 2.0, 1.0]
    turn = 9.81 * np.stack([np.cos(0.1 * t), np.sin(0.1 * t), 0 * t], axis=1)[:, :, 0]
    values = turn + swing + noise * rng.standard_normal((n, 3))
    return np.round(values / digit) * digit if digit else values


@pytest.mark.parametrize("size", [3.0, 30.0, 400.0])
@pytest.mark.parametrize("digit", [0.0, 0.077])
def test_single_samples_far_from_all_around_them_are_found(size: float, digit: float) -> None:
    rng = np.random.default_rng(1)
    values = moving(20_000, rng, digit=digit)
    assert not spikes(values).any()
    at = np.arange(37, 20_000, 501)
    at = np.sort(np.concatenate([at, at[:10] + 2]))
    values[at] += size * rng.choice([-1.0, 1.0], (at.size, 3))
    assert np.array_equal(np.flatnonzero(spikes(values)), at)


def test_a_spike_on_the_way_from_one_turn_to_the_next_is_found() -> None:
    rng = np.random.default_rng(3)
    ramp = np.arange(2000)[:, None] * [0.17, 0.01, 0.17]
    values = np.abs(ramp % 40 - 20) + 0.01 * rng.standard_normal((2000, 3))
    assert not spikes(values).any()
    at = np.arange(30, 1990, 61)
    values[at, 1] += 2.7
    assert np.array_equal(np.flatnonzero(spikes(values)), at)


def test_a_shock_that_lasts_is_a_reading() -> None:
    rng = np.random.default_rng(2)
    values = moving(8000, rng)
    ringing = 40 * np.exp(-np.arange(40) / 8) * np.cos(np.arange(40) * 1.3)
    values[4000:4040, 1] += ringing
    values[6000:, 0] += 2.0
    assert not spikes(values).any()


def test_without_noise_a_digit_is_no_spike() -> None:
    values = np.round(np.stack([np.sin(np.arange(5000) / 300)] * 3, axis=1), 2)
    values[100, 0] += 0.01
    assert not spikes(values).any()
    assert not spikes(np.zeros((100, 3))).any()


def test_values_beyond_any_range_are_absurd_unless_the_unit_is() -> None:
    force = np.tile([0.0, 0.0, 9.81], (50, 1))
    force[3, 0], force[4, 1], force[5, 2] = 1e5, np.nan, -600.0
    assert np.flatnonzero(absurd(force)).tolist() == [3, 4, 5]
    counts = np.tile([0.0, 0.0, 16384.0], (50, 1))
    assert not absurd(counts).any()


def test_a_log_with_spikes_says_how_many(ros_log: Any) -> None:
    rng = np.random.default_rng(3)
    values = moving(400, rng)
    values[[50, 150]] = 1e5
    values[[70, 250, 300], 1] += 90.0
    for k in range(400):
        ros_log.joints(EPOCH + 5 * MS * k, {"j": 0.01 * k})
        ros_log.imu(EPOCH + 5 * MS * k, values[k])
    recording = read(ros_log.close())
    (su,) = recording.sus
    kept = np.delete(np.arange(400), [50, 70, 150, 250, 300])
    assert np.array_equal(su.specific_force, values[kept])
    assert [note.number for note in of_reading(recording.notes, "absurd values")] == [2]
    assert [note.number for note in of_reading(recording.notes, "spikes")] == [3]


@pytest.mark.parametrize("publishers", [2, 5])
@pytest.mark.parametrize("shuffled", [False, True])
def test_several_sensors_under_one_name_are_seen(publishers: int, shuffled: bool) -> None:
    rng = np.random.default_rng(4)
    turns = np.linalg.qr(rng.standard_normal((publishers, 3, 3)))[0]
    single = moving(3000, rng)
    mixed = np.einsum("pij,nj->npi", turns, single) + 0.02 * rng.standard_normal(
        (3000, publishers, 3)
    )
    if shuffled:
        mixed = np.stack([each[rng.permutation(publishers)] for each in mixed])
    assert several_publishers(mixed.reshape(-1, 3), FORCES_APART, of_forces=True)
    assert not several_publishers(single, FORCES_APART, of_forces=True)


def test_one_sensor_that_shakes_or_is_coarse_is_one() -> None:
    rng = np.random.default_rng(5)
    shaking = moving(5000, rng, noise=3.0)
    coarse = moving(5000, rng, noise=0.05, digit=0.3)
    assert not several_publishers(shaking, FORCES_APART, of_forces=True)
    assert not several_publishers(coarse, FORCES_APART, of_forces=True)
    assert not several_publishers(
        np.tile([0.0, 0.0, 9.81], (5000, 1)), FORCES_APART, of_forces=True
    )


@given(st.floats(0.1, 0.45), st.floats(3.0, 8.0))
@settings(max_examples=20, deadline=None)
def test_what_sampling_makes_slow_of_a_vibration_is_one_sensor(folded: float, size: float) -> None:
    # So many turns from each sample to the next: 0.3 of a spindle of 230 Hz in samples of 100 Hz.
    rng = np.random.default_rng(6)
    count = 6000
    turns = 2 * np.pi * folded * np.arange(count)[:, None] + rng.uniform(0, 6, 3)
    runs = (np.arange(count) // 1000 % 3 > 0)[:, None]
    shaken = moving(count, rng) + size * runs * np.sin(turns) * np.array([0.6, 1.0, 0.8])
    assert not several_publishers(shaken, FORCES_APART, of_forces=True)


def test_publishers_that_share_a_name_are_refused_by_it(ros_log: Any) -> None:
    rng = np.random.default_rng(6)
    values = moving(200, rng)
    for k in range(200):
        ros_log.joints(EPOCH + 5 * MS * k, {"j": 0.01 * k})
        ros_log.imu(EPOCH + 5 * MS * k, values[k], "one", "/skin")
        for turned in (values[k], values[k][::-1], -values[k]):
            ros_log.imu(EPOCH + 5 * MS * k + MS, turned, "imu_link", "/skin")
    recording = read(ros_log.close())
    assert [su.name for su in recording.sus] == ["one"]
    (note,) = of_reading(recording.notes, "several publishers")
    assert note.sources == ("/skin", "imu_link")


def test_joint_states_that_contradict_each_other_are_refused(make_log: Any) -> None:
    log = make_log()
    for k in range(200):
        log.joints(EPOCH + 5 * MS * k, {"a": 0.01 * k, "b": 0.0})
        log.joints(EPOCH + 5 * MS * k + MS, {"a": 0.5, "b": 0.3})
        log.imu(EPOCH + 5 * MS * k, [0, 0, 9.81])
    with pytest.raises(UnreadableInputError) as caught:
        read(log.close())
    assert caught.value.why == "nothing usable"
