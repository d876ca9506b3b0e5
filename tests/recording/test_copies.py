"""Readings that another stream holds as well are left out; sensors that read alike are not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from skin2urdf.notes import of_reading
from skin2urdf.recording.copies import without_copies
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import Recording, SuStream


def sensor(name: str, seed: int, digit: float = 0.0) -> SuStream:
    """A minute at 100 Hz on a robot that moves now and then."""
    time = np.arange(6000) / 100.0
    moved = np.where(time % 8 < 3, np.sin(3 * time), 0.0)[:, None] * [2.0, 1.0, 3.0]
    noise = np.random.default_rng(seed).normal(scale=0.01, size=(6000, 3))
    values = moved + np.array([0.1, 0.2, 9.8]) + noise
    return SuStream(name, time, np.round(values / digit) * digit if digit else values)


@pytest.mark.parametrize("digit", [0.0, 1e-3, 0.02])
def test_sensors_that_move_alike_are_no_copies(digit: float) -> None:
    whole = Recording((), tuple(sensor(f"su_{k}", k, digit) for k in range(20)))
    assert without_copies(whole) is whole


def test_sensors_that_stand_still_within_a_digit_are_no_copies() -> None:
    whole = Recording((), tuple(sensor(f"su_{k}", k, 40.0) for k in range(3)))
    assert without_copies(whole) is whole


@pytest.mark.parametrize("digit", [0.0, 1e-3, 0.02])
def test_a_relay_that_loses_and_delays_some_is_left_out(digit: float) -> None:
    first, other = sensor("first", 1, digit), sensor("other", 2, digit)
    rng = np.random.default_rng(0)
    kept = rng.random(6000) > 2e-3
    kept[:30] = False
    relay = replace(
        first.at(kept),
        name="a_relay",
        time=first.time[kept] + 0.013 + 1e-4 * rng.random(kept.sum()),
    )
    found = without_copies(Recording((), (relay, first, other)))
    assert [su.name for su in found.sus] == ["first", "other"]
    (note,) = of_reading(found.notes, "copied readings")
    assert note.sources == ("first", "a_relay")


def test_a_log_tells_of_copies(ros_log: Any) -> None:
    rng = np.random.default_rng(0)
    for k in range(1500):
        at = 10**9 * 1_700_000_000 + 10**7 * k
        ros_log.joints(at, {"j": np.sin(k / 100.0)})
        reading = rng.standard_normal(3)
        ros_log.imu(at, reading, topic="/imu", frame="one")
        ros_log.imu(at, rng.standard_normal(3), topic="/imu", frame="two")
        ros_log.imu(at, reading, topic="/relay", frame="three")
    recording = read(ros_log.close())
    assert len(recording.sus) == 2
    assert len(of_reading(recording.notes, "copied readings")) == 1
