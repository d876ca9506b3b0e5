"""Logs whose stamps jump, step back or come in the wrong order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skin2urdf.notes import of_reading
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import Recording
from skin2urdf.recording.timing import sample_times

EPOCH = 1_700_000_000 * 10**9
MS = 10**6
N = 600


def value(k: int, phase: float) -> list[float]:
    """A motion of 2 Hz at 100 samples a second."""
    return [float(np.sin(0.126 * k + phase + axis)) for axis in range(3)]


def recorded(log: Any, stamp: Any, log_time: Any, sus: tuple[str, ...] = ("a", "b")) -> Recording:
    """Joints and SUs whose stamps and log times are functions of source and message number."""
    for k in range(N):
        at = log_time("joints", k)
        log.joints(stamp("joints", k), {"j": value(k, 0)[0], "k": float(k)}, log_time=at)
        for phase, su in enumerate(sus):
            at = log_time(su, k)
            log.imu(stamp(su, k), value(k, phase), su, f"/{su}", log_time=at)
    return read(log.close())


def at(_: str, k: int) -> int:
    return EPOCH + 10 * MS * k


@pytest.mark.parametrize("log_steps", [False, True], ids=["stamps", "stamps and log"])
@pytest.mark.parametrize("seconds", [-2.0, 3600.0, 86400.0])
def test_a_clock_that_is_set_leaves_two_whole_stretches(
    seconds: float, log_steps: bool, ros_log: Any
) -> None:
    def stepped(source: str, k: int) -> int:
        return at(source, k) + (round(seconds * 1e9) if k >= N // 2 else 0)

    recording = recorded(ros_log, stepped, stepped if log_steps else at)
    joint = recording.joints[1]
    assert np.array_equal(joint.position, np.arange(N))
    assert recording.duration < 0.01 * N + 2.0
    pause = np.diff(joint.time)
    assert pause[N // 2 - 1] > 0.5
    np.testing.assert_allclose(np.delete(pause, N // 2 - 1), 0.01, atol=1e-6)
    for su in recording.sus:
        np.testing.assert_allclose(su.time, joint.time, atol=1e-6)
    assert len(of_reading(recording.notes, "clock jump")) == 1


def test_an_su_whose_clock_jumps_by_itself_counts_up_to_there(ros_log: Any) -> None:
    def stepped(source: str, k: int) -> int:
        return at(source, k) + (3600 * 10**9 if source == "b" and k >= 400 else 0)

    recording = recorded(ros_log, stepped, at)
    a, b = recording.sus
    assert a.time.size == N
    np.testing.assert_allclose(b.time, recording.joints[0].time[:400], atol=1e-6)
    (note,) = of_reading(recording.notes, "own clock jump")
    assert (note.sources, note.number) == (("/b",), 1)


@pytest.mark.parametrize("own", [0.0, 7.0])
def test_a_pause_of_all_does_not_last_whatever_one_clock_does(own: float, ros_log: Any) -> None:
    def late(source: str, k: int) -> int:
        return at(source, k) + (3600 * 10**9 if k >= N // 2 else 0)

    def stepped(source: str, k: int) -> int:
        mine = source == "joints" and k >= N // 2 - 3
        return late(source, k) + (round(own * 1e9) if mine else 0)

    recording = recorded(ros_log, stepped, late)
    assert recording.duration < 0.01 * N + 20.0
    assert of_reading(recording.notes, "clock jump")
    for su in recording.sus:
        assert su.time.size == N
        assert np.diff(su.time).max() < 20.0


def test_times_that_scatter_by_years_are_no_pauses(ros_log: Any) -> None:
    scatter = np.random.default_rng(1).integers(0, 10**17, N)

    def scattered(source: str, k: int) -> int:
        return at(source, k) + (int(scatter[k]) if k >= N // 2 else 0)

    recording = recorded(ros_log, scattered, scattered)
    assert not of_reading(recording.notes, "clock jump")


def test_stamps_that_scatter_by_minutes_give_way_to_log_times(ros_log: Any) -> None:
    scatter = np.random.default_rng(0).integers(-400 * 10**9, 400 * 10**9, N)

    def scattered(source: str, k: int) -> int:
        return at(source, k) + (int(scatter[k]) if source == "b" and k >= 200 else 0)

    for su in recorded(ros_log, scattered, at).sus:
        np.testing.assert_allclose(su.time, 0.01 * np.arange(N), atol=1e-3)


def test_a_pause_of_one_su_is_no_jump_of_its_clock(ros_log: Any) -> None:
    for k in range(3 * N):
        ros_log.joints(at("", k), {"j": float(k)})
        if not 100 <= k < 1300:
            ros_log.imu(at("", k), value(k, 0.0))
    (su,) = read(ros_log.close()).sus
    assert su.time.size == 3 * N - 1200
    assert np.diff(su.time).max() == pytest.approx(12.01)


@pytest.mark.parametrize("jitter", [0.0, 0.2])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_messages_reordered_within_a_window_are_sorted(jitter: float, noise: float) -> None:
    rng = np.random.default_rng(0)
    true = 0.01 * np.arange(4000)
    stamp = EPOCH + np.rint((true + 0.01 * jitter * rng.random(true.size)) * 1e9).astype(np.int64)
    swing = np.where(true % 4 < 2, np.sin(4 * np.pi * true), 0.0)
    signal = np.stack([swing, 0.5 * swing, -swing], axis=1)
    signal = signal + noise * rng.standard_normal(signal.shape)
    order = np.argsort(np.arange(true.size) + 40 * rng.random(true.size))
    times = sample_times(stamp[order], stamp[order], signal[order])
    assert np.array_equal(order[times.kept], np.arange(true.size))


@pytest.mark.parametrize("late", [0.1, 3.0])
def test_messages_that_are_late_by_more_than_a_period_are_told(late: float, ros_log: Any) -> None:
    delay = 10 * MS * late * np.random.default_rng(1).exponential(size=N)
    arrival = np.maximum.accumulate(10 * MS * np.arange(N) + delay).astype(np.int64)

    def delayed(source: str, k: int) -> int:
        return EPOCH + int(arrival[k]) + 100 * k if source == "b" else at(source, k)

    recording = recorded(ros_log, delayed, delayed)
    told = [note.sources for note in of_reading(recording.notes, "late messages")]
    assert told == ([("/b",)] if late > 1 else [])
