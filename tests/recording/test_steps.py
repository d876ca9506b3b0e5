"""Stamps of a clock that is set in mid-log by some milliseconds are put back on one clock."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skin2urdf.arrays import Int
from skin2urdf.notes import of_reading
from skin2urdf.recording.reading import read
from skin2urdf.recording.steps import without_steps
from skin2urdf.recording.streams import Samples

EPOCH = 1_700_000_000 * 10**9
MS = 10**6


def stream(
    seed: int, period: float = 5.0, jitter: float = 0.1, late: float = 1.0, count: int = 4000
) -> tuple[Int, Int]:
    """Stamps with jitter, and times of the log later by an exponential delay [ns]."""
    rng = np.random.default_rng(seed)
    true = EPOCH + MS * period * np.arange(count)
    stamp = true + MS * jitter * rng.standard_normal(count)
    arrival = np.maximum.accumulate(stamp + MS * late * rng.exponential(size=count))
    return stamp.astype(np.int64), arrival.astype(np.int64)


def samples(stamp: Int, log_time: Int) -> Samples:
    return Samples(stamp, log_time, np.zeros((len(stamp), 3)))


@given(
    st.sampled_from([-300.0, -80.0, -25.0, -6.0, 6.0, 25.0, 80.0, 300.0]),
    st.integers(0, 50),
    st.sampled_from([2.0, 5.0, 10.0]),
)
@settings(max_examples=30, deadline=None)
def test_what_a_clock_was_set_by_is_taken_off(size: float, seed: int, period: float) -> None:
    stamp, log_time = stream(seed, period, late=0.2)
    at = 1500 + 7 * seed
    step = np.where(np.arange(len(stamp)) >= at, round(size * MS), 0)
    (mended, same), notes = without_steps(
        [samples(stamp + step, log_time), samples(stamp, log_time)], ["/imu (su)", "/other (su)"]
    )
    assert np.abs(mended.stamp - stamp).max() < 0.2 * MS
    assert np.array_equal(same.stamp, stamp)
    (note,) = notes
    assert note.sources == ("/imu (su)",)
    assert note.number == pytest.approx(size * 1e-3, abs=2e-4)


def test_messages_that_overtake_each_other_at_a_step_show_it_once() -> None:
    stamp, log_time = stream(7, late=0.2)
    step = np.where(np.arange(len(stamp)) >= 2000, 80 * MS, 0)
    order = np.arange(len(stamp))
    order[1999:2001] = 2000, 1999
    overtaken = samples((stamp + step)[order], log_time)
    (found,), (note,) = without_steps([overtaken], ["/imu (su)"])
    assert note.number == pytest.approx(0.08, abs=2e-4)
    apart = np.abs(found.stamp - stamp[order])
    assert np.count_nonzero(apart > 0.5 * MS) <= 1


@pytest.mark.parametrize("seed", range(5))
def test_lost_messages_and_slower_ways_are_no_steps(seed: int) -> None:
    stamp, log_time = stream(seed)
    kept = np.delete(np.arange(len(stamp)), np.arange(2000, 2016))
    lost = samples(stamp[kept], log_time[kept])
    slower = samples(stamp, log_time + np.where(np.arange(len(stamp)) >= 2000, 80 * MS, 0))
    held_back = log_time.copy()
    held_back[1990:2000] = log_time[2000]
    streams = [lost, slower, samples(stamp, held_back), samples(stamp, stamp)]
    found, notes = without_steps(streams, ["a", "b", "c", "d"])
    assert not notes
    assert all(np.array_equal(a.stamp, b.stamp) for a, b in zip(found, streams, strict=True))


def test_stamps_that_scatter_as_much_tell_no_step() -> None:
    stamp, log_time = stream(3, jitter=8.0)
    step = np.where(np.arange(len(stamp)) >= 1500, 30 * MS, 0)
    noisy = samples(stamp + step, log_time)
    (found,), notes = without_steps([noisy], ["/imu (su)"])
    assert not notes
    assert np.array_equal(found.stamp, noisy.stamp)


def test_a_log_with_a_host_that_is_set_reads_on_one_clock(ros_log: Any) -> None:
    for k in range(600):
        stamp = EPOCH + 4 * MS * k
        ros_log.joints(stamp, {"a": np.sin(0.02 * k)})
        late = 40 * MS if k >= 300 else 0
        ros_log.imu(stamp + late, [np.sin(0.02 * k), 0, 9.81], log_time=stamp + MS)
    recording = read(ros_log.close())
    (note,) = of_reading(recording.notes, "clock step")
    assert note.number == pytest.approx(0.04, abs=1e-4)
    (su,) = recording.sus
    assert np.diff(su.time) == pytest.approx(0.004, abs=1e-4)
