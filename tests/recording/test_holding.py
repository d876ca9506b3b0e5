"""Readings that are sent several times count once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.notes import of_reading
from skin2urdf.recording.holding import joints_as_measured, measurements
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import JointStream, Recording

N = 6000
TIME = np.arange(N) / 500.0


def signal(noise: float, digit: float, seed: int = 0) -> F64:
    """Rests and patterns at 500 samples a second."""
    rng = np.random.default_rng(seed)
    t = np.arange(N)[:, None] / 500.0
    swing = np.where(t % 6 < 3, np.sin(4 * np.pi * t), 0.0) * [5.0, 3.0, 4.0]
    values = swing + [3.0, 2.0, 9.0] + noise * rng.standard_normal((N, 3))
    return np.round(values / digit) * digit if digit else values


@pytest.mark.parametrize(
    ("noise", "digit"), [(0.01, 0.0), (0.01, 1e-3), (0.08, 0.077), (0.0, 0.077), (0.0, 1e-3)]
)
def test_a_sensor_that_sends_each_reading_once_is_left_alone(noise: float, digit: float) -> None:
    assert measurements(signal(noise, digit), TIME).kept.size == N


@pytest.mark.parametrize(("noise", "digit"), [(0.01, 0.0), (0.01, 1e-3), (0.08, 0.02)])
@pytest.mark.parametrize("times", [2, 5])
def test_each_measurement_is_kept_where_it_first_appears(
    times: int, noise: float, digit: float
) -> None:
    values = signal(noise, digit)[np.arange(N) // times * times]
    held = measurements(values, TIME)
    assert held.times == pytest.approx(times, rel=0.02)
    first = np.arange(0, N, times)
    assert np.isin(first, held.kept).mean() > 0.99
    assert np.isin(held.kept, first).mean() > 0.99


def test_where_digits_are_coarse_equal_measurements_stay() -> None:
    """At rest the readings of a coarse sensor repeat; dropping those would shift their mean."""
    values = signal(0.08, 0.077)[np.arange(N) // 5 * 5]
    held = measurements(values, TIME)
    rest = (np.arange(N) % 3000) >= 1500
    kept = values[held.kept[rest[held.kept]]]
    np.testing.assert_allclose(kept.mean(axis=0), values[rest].mean(axis=0), atol=3e-3)
    assert held.kept.size == pytest.approx(N / 5, rel=0.1)


def test_a_sensor_polled_out_of_step_gives_its_own_measurements() -> None:
    at = np.floor(np.arange(N) * 0.37).astype(int)
    held = measurements(signal(0.01, 0.0)[at], TIME)
    assert held.times == pytest.approx(1 / 0.37, rel=0.02)
    assert np.array_equal(held.kept, np.flatnonzero(np.diff(at, prepend=-1)))


def test_a_shaking_at_a_quarter_of_the_rate_is_no_repetition() -> None:
    """It makes pairs of equal values where digits are coarser than noise; all other values pass."""
    t = np.arange(N) / 500.0
    shaking = np.outer(np.sin(2 * np.pi * 125.0 * t + 0.8) * (t % 6 < 3), [0.35, 0.1, -0.2])
    values = np.round((signal(0.0, 0.0) + shaking) / 0.038) * 0.038
    assert measurements(values, TIME).kept.size == N


def test_a_sensor_that_freezes_for_a_while_is_left_to_others() -> None:
    values = signal(0.01, 0.0)
    values[2000:3000] = values[2000]
    assert measurements(values, TIME).kept.size == N


@pytest.mark.parametrize("burst", [2, 4, 7])
def test_messages_that_come_in_bursts_are_none_that_were_lost(burst: int) -> None:
    arrived = np.arange(N) // burst * burst / 500.0 + np.arange(N) % burst * 2e-4
    q = np.round(signal(0.0, 0.0), 2)
    assert measurements(q, arrived).kept.size == N
    held = measurements(signal(0.01, 1e-3)[np.arange(N) // 5 * 5], arrived)
    assert held.times == pytest.approx(5, rel=0.02)
    assert held.kept.size == pytest.approx(N / 5, rel=0.01)


def test_one_value_for_each_rest_holds_as_long_as_it_was_sent() -> None:
    """A table of rests has a value for each, and no sensor measures every three seconds."""
    values = np.repeat(signal(0.01, 0.0)[:: N // 60], 100, axis=0)
    sent = np.linspace(0.0, 60.0, len(values))
    assert measurements(values, 3.0 * sent).kept.size == len(values)
    assert measurements(values, 0.1 * sent).kept.size == 60


@pytest.mark.parametrize("share", [0.005, 0.02, 0.1])
def test_lost_messages_make_no_measurement_late(share: float) -> None:
    """What comes first of one then is not when it was measured, and counts for nothing."""
    rng = np.random.default_rng(3)
    first = np.arange(N) // 5 * 5
    arrived = np.flatnonzero(rng.random(N) >= share)
    held = measurements(signal(0.01, 1e-3)[first][arrived], TIME[arrived])
    assert held.times == pytest.approx(5, rel=0.02)
    # Nobody knows what came before the log.
    at = arrived[held.kept[1:]]
    assert (at == first[at]).mean() > 0.999
    assert at.size == pytest.approx((1 - share) ** 2 * N / 5, rel=0.05)


def test_the_rate_of_a_log_is_that_of_its_measurements(ros_log: Any) -> None:
    values = signal(0.01, 1e-3)[np.arange(N) // 5 * 5]
    for k in range(800):
        at = 10**9 * 1_700_000_000 + 2 * 10**6 * k
        ros_log.joints(at, {"j": 0.01 * k})
        ros_log.imu(at, values[k])
    recording = read(ros_log.close())
    (su,) = recording.sus
    np.testing.assert_allclose(np.diff(su.time), 0.01, atol=1e-6)
    assert [note.number for note in of_reading(recording.notes, "held values")] == [5]


def positions(bits: int | None) -> F64:
    """Moves and rests of two joints at 100 samples a second, as encoders give them."""
    t = np.arange(6000)[:, None] / 100.0
    q = np.where(t % 8 < 5, np.sin(2 * np.pi * t / 5 * [1.0, 2.0]), 0.0) * [0.8, 0.3]
    step = 2 * np.pi / 2**bits if bits else 0.0
    return np.round(q / step) * step if step else q


@pytest.mark.parametrize("bits", [11, 14, 17, None])
def test_joints_that_are_read_as_often_as_they_are_sent_are_left_alone(bits: int | None) -> None:
    q, time = positions(bits), np.arange(6000) / 100.0
    recording = Recording(
        tuple(JointStream(n, time, x) for n, x in zip("ab", q.T, strict=True)), ()
    )
    assert joints_as_measured(recording) is recording


@pytest.mark.parametrize("bits", [14, 17, None])
@pytest.mark.parametrize("times", [4.0, 2.7])
def test_positions_that_are_sent_several_times_count_once(times: float, bits: int | None) -> None:
    q, time = positions(bits), np.arange(6000) / 100.0
    read_at = np.ceil(np.floor(np.arange(6000) / times) * times).astype(int)
    effort = np.arange(6000.0)
    sent = tuple(
        JointStream(name, time, x[read_at], effort=effort)
        for name, x in zip("ab", q.T, strict=True)
    )
    found = joints_as_measured(Recording(sent, ()))
    (note,) = of_reading(found.notes, "held values")
    assert note.sources == ("a", "b")
    assert note.number == pytest.approx(times, rel=0.02)
    first = np.unique(read_at)
    at = np.rint(100 * found.joints[0].time).astype(int)
    assert at.size == pytest.approx(6000 / times, rel=0.03)
    # At rest nothing tells when each was read; a value that stood as long as two may be two.
    moves = at % 800 < 495
    assert np.isin(at[moves], first).mean() > 0.94
    for joint, x in zip(found.joints, q.T, strict=True):
        np.testing.assert_array_equal(joint.position[np.isin(at, first)], x[at[np.isin(at, first)]])
        assert joint.effort is not None
        assert len(joint.effort) == at.size


def test_a_log_tells_of_held_positions(ros_log: Any) -> None:
    q = positions(17)[np.arange(1600) // 4 * 4]
    rng = np.random.default_rng(0)
    for k in range(1600):
        at = 10**9 * 1_700_000_000 + 10**7 * k
        ros_log.joints(at, {"j": q[k, 0], "k": q[k, 1]})
        ros_log.imu(at, rng.standard_normal(3))
    recording = read(ros_log.close())
    for joint in recording.joints:
        np.testing.assert_allclose(np.diff(joint.time), 0.04, atol=1e-6)
    (note,) = of_reading(recording.notes, "held values")
    assert note.sources == ("j", "k")
