from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from skin2urdf.recording.numbering import median_of, medians_of
from skin2urdf.recording.regular import regular_times
from skin2urdf.recording.smoothness import weigh_stamps
from skin2urdf.recording.timing import SampleTimes, Stamped, sample_times, sample_times_of

F64 = NDArray[np.float64]
EPOCH = 1_700_000_000
RATE = 200.0
PERIOD = 1.0 / RATE
N = 6000


def moving(time: F64, noise: float, rng: np.random.Generator) -> F64:
    """Three axes that swing at 2 Hz for 8 of every 12 seconds and rest between."""
    swing = np.where(time % 12 < 8, np.sin(np.pi * (time % 12) / 8) ** 2, 0.0)
    clean = [9.81 * np.sin(c) + 4 * swing * np.sin(4 * np.pi * time + c) for c in range(3)]
    return np.stack(clean, axis=1) + noise * rng.standard_normal((time.size, 3))


def ns(time: F64) -> NDArray[np.int64]:
    return EPOCH * 10**9 + np.rint(time * 1e9).astype(np.int64)


def timed(stamp: F64, signal: F64) -> tuple[SampleTimes, F64]:
    times = sample_times(ns(stamp), ns(stamp), signal)
    assert (np.diff(times.time) > 0).all()
    assert times.time.size == times.kept.size
    return times, (times.time - EPOCH * 10**9) / 1e9


def error(got: F64, true: F64) -> F64:
    """Timing errors but for a constant, which no one can tell from a latency."""
    return np.abs(got - true - np.median(got - true))


@pytest.mark.parametrize("noise", [0.01, 0.08])
@pytest.mark.parametrize("jitter", [0.1, 0.4, 1.5])
def test_noisy_stamps_of_a_regular_sensor_are_made_regular(jitter: float, noise: float) -> None:
    rng = np.random.default_rng(1)
    true = np.arange(N) * PERIOD
    stamp = true + jitter * PERIOD * rng.exponential(size=N)
    times, got = timed(stamp, moving(true, noise, rng))
    assert times.chosen == "regular"
    assert times.kept.size == N
    assert error(got, true).max() < 0.25 * jitter * PERIOD


@pytest.mark.parametrize("noise", [0.01, 0.03])
@pytest.mark.parametrize("jitter", [0.2, 0.4])
def test_exact_stamps_of_an_irregular_sensor_are_kept(jitter: float, noise: float) -> None:
    rng = np.random.default_rng(2)
    true = (np.arange(N) + jitter * rng.uniform(-1, 1, N)) * PERIOD
    times, got = timed(true, moving(true, noise, rng))
    assert times.chosen == "stamps"
    np.testing.assert_allclose(got, true, rtol=0, atol=1e-9)


def test_samples_at_random_times_keep_their_stamps() -> None:
    rng = np.random.default_rng(3)
    true = np.cumsum(PERIOD * rng.exponential(size=N) + 1e-6)
    _, got = timed(true, moving(true, 0.01, rng))
    np.testing.assert_allclose(got, true, rtol=0, atol=1e-9)


@pytest.mark.parametrize("jitter", [0.03, 0.8])
def test_at_rest_a_stream_that_has_a_rate_counts_as_regular(jitter: float) -> None:
    rng = np.random.default_rng(4)
    true = np.arange(N) * PERIOD
    still = 0.01 * rng.standard_normal((N, 3))
    stamp = np.maximum.accumulate(true + jitter * PERIOD * rng.standard_normal(N))
    times, _ = timed(stamp + 1e-6 * true, still)
    assert times.chosen == "regular"


def test_clean_stamps_stay_to_the_nanosecond() -> None:
    rng = np.random.default_rng(5)
    true = np.arange(N) / 300.0
    times, _ = timed(true, moving(true, 0.01, rng))
    assert times.chosen == "stamps"
    assert np.array_equal(times.time, ns(true))


def test_lost_messages_and_pauses_stay() -> None:
    rng = np.random.default_rng(6)
    grid = np.arange(N) * PERIOD
    heard = rng.random(N) > 0.01
    heard &= ~((grid > 7.0) & (grid < 7.043))
    true = grid[heard] + np.where(grid[heard] > 18.0, 2.0013, 0.0)
    stamp = true + 0.2 * PERIOD * rng.random(true.size)
    times, got = timed(stamp, moving(true, 0.01, rng))
    assert times.chosen == "regular"
    assert error(got, true).max() < 0.1 * PERIOD


@pytest.mark.parametrize("share", [0.0, 0.01])
@pytest.mark.parametrize("drains", [0.01, 0.2])
def test_messages_that_queue_behind_a_stall_are_where_they_were_taken(
    drains: float, share: float
) -> None:
    rng = np.random.default_rng(18)
    true = np.arange(N) * PERIOD
    stamp = true + 0.05 * PERIOD * rng.random(N)
    for begin in np.cumsum(rng.exponential(3.0, 12)):
        end = begin + rng.uniform(0.05, 0.3)
        waiting = np.flatnonzero((stamp > begin) & (stamp < end))
        sent = end + drains * PERIOD * np.arange(waiting.size)
        stamp[waiting] = np.maximum(stamp[waiting], sent)
    stamp = np.maximum.accumulate(stamp) + 1e-9 * np.arange(N)
    heard = rng.random(N) > share
    times, got = timed(stamp[heard], moving(true, 0.01, rng)[heard])
    assert times.chosen == "regular"
    off = error(got, true[heard][times.kept])
    assert np.std(off) < 0.2 * PERIOD
    assert off.max() < 4 * PERIOD


@pytest.mark.parametrize("share", [0.005, 0.05])
@pytest.mark.parametrize("jitter", [0.1, 0.2, 0.3])
def test_lost_messages_are_counted_between_stamps_that_jitter(jitter: float, share: float) -> None:
    """The clock's phase shows how many, and all but a few of the places."""
    rng = np.random.default_rng(16)
    true = (np.arange(N) * PERIOD * (1 + 50e-6))[rng.random(N) > share]
    true = np.where(np.arange(true.size) < 0.6 * N, true, true + 0.5013)
    stamp = np.maximum.accumulate(true + jitter * PERIOD * rng.standard_normal(true.size))
    times, got = timed(stamp + 1e-6 * true, moving(true, 0.01, rng))
    assert times.chosen == "regular"
    assert np.quantile(error(got, true), 0.95) < 0.25 * jitter * PERIOD
    assert error(got, true).max() < 1.2 * PERIOD


def test_a_clock_without_drift_gets_no_bends() -> None:
    """Noise of 100 us over 90 s: a line through all of it is off by 2 us at most, bends by 20."""
    worst = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        true = np.arange(45_000) / 500.0
        fitted = regular_times(true + 1e-4 * rng.standard_normal(true.size))
        assert fitted is not None
        worst.append(np.abs(fitted - true).max())
    assert np.median(worst) < 2e-6
    assert np.quantile(worst, 0.9) < 4e-6


def test_a_clock_that_is_slewed_bends_there() -> None:
    rng = np.random.default_rng(12)
    true = np.arange(45_000) / 500.0
    true = true + 2e-5 * np.maximum(true - 50.0, 0.0)
    fitted = regular_times(true + 1e-4 * rng.standard_normal(true.size))
    assert fitted is not None
    assert np.abs(fitted - true).max() < 2.5e-5


def test_the_drift_of_a_clock_stays() -> None:
    rng = np.random.default_rng(7)
    grid = np.arange(N) * PERIOD
    true = grid * (1 + 2e-4) + 3e-3 * np.sin(2 * np.pi * grid / 30)
    stamp = true + 0.3 * PERIOD * rng.random(N)
    times, got = timed(stamp, moving(true, 0.01, rng))
    assert times.chosen == "regular"
    assert error(got, true).max() < 0.06 * PERIOD
    assert np.abs(grid - true).max() > PERIOD


@pytest.mark.parametrize("burst", [4, 16])
def test_samples_that_arrive_in_bursts_are_spread(burst: int) -> None:
    rng = np.random.default_rng(8)
    true = np.arange(N) * PERIOD
    arrival = true[np.minimum((np.arange(N) // burst + 1) * burst - 1, N - 1)]
    _, got = timed(arrival + 1e-6 * (np.arange(N) % burst), moving(true, 0.01, rng))
    assert error(got, true).max() < 0.25 * PERIOD


def test_a_coarse_clock_repeats_stamps_and_loses_no_sample() -> None:
    rng = np.random.default_rng(9)
    true = np.arange(N) * PERIOD
    times, got = timed(np.floor(true / 0.02) * 0.02, moving(true, 0.01, rng))
    assert times.kept.size == N
    assert error(got, true).max() < 0.25 * PERIOD


def test_messages_delivered_twice_count_once() -> None:
    rng = np.random.default_rng(10)
    true = np.arange(N) * PERIOD
    twice = np.sort(np.concatenate([np.arange(N), np.arange(0, N, 7)]))
    times, got = timed(true[twice], moving(true, 0.01, rng)[twice])
    np.testing.assert_allclose(got, true, rtol=0, atol=1e-9)
    assert times.kept.size == N


@pytest.mark.parametrize("offset", [-0.05, 0.05])
@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_stamps_that_jump_for_a_moment_are_mended(offset: float, jitter: float) -> None:
    rng = np.random.default_rng(11)
    true = np.arange(N) * PERIOD
    stamp = true + jitter * PERIOD * rng.random(N)
    stamp[rng.choice(N, 20, replace=False)] += offset
    times, got = timed(stamp, moving(true, 0.01, rng))
    assert times.kept.size == N
    assert error(got, true).max() < 0.1 * PERIOD


def test_only_wrong_stamps_of_an_irregular_stream_are_dropped() -> None:
    rng = np.random.default_rng(12)
    true = np.cumsum(PERIOD * (0.1 + rng.exponential(size=N)))
    stamp = true.copy()
    wrong = np.arange(50, N, 97)
    stamp[wrong] -= 0.2
    times, got = timed(stamp, moving(true, 0.01, rng))
    np.testing.assert_allclose(got, true[times.kept], rtol=0, atol=1e-9)
    assert times.kept.size == N - wrong.size


def test_messages_that_overtook_each_other_are_put_in_order() -> None:
    rng = np.random.default_rng(13)
    true = np.arange(N) * PERIOD
    order = np.arange(N)
    swapped = np.arange(20, N - 1, 31)
    order[swapped], order[swapped + 1] = swapped + 1, swapped
    times, got = timed(true[order], moving(true, 0.01, rng)[order])
    assert np.array_equal(order[times.kept], np.arange(N))
    np.testing.assert_allclose(got, true, rtol=0, atol=1e-9)


def test_a_clock_set_back_costs_only_the_samples_it_repeats() -> None:
    rng = np.random.default_rng(14)
    true = np.arange(N) * PERIOD
    stamp = true + 0.1 * PERIOD * rng.random(N)
    stamp[N // 2 :] -= 0.3
    times, got = timed(stamp, moving(true, 0.01, rng))
    dropped = N - times.kept.size
    assert 0 < dropped <= 0.3 * RATE + 2
    on_the_clock = true - np.where(np.arange(N) >= N // 2, 0.3, 0.0)
    assert error(got, on_the_clock[times.kept]).max() < 0.1 * PERIOD


def test_joints_with_gaps_in_one_channel_are_timed_by_the_others() -> None:
    rng = np.random.default_rng(15)
    true = np.arange(N) * PERIOD
    signal = moving(true, 1e-3, rng)
    signal[:, 1] = np.nan
    signal[::5, 2] = np.nan
    times, got = timed(true + 0.3 * PERIOD * rng.random(N), signal)
    assert times.chosen == "regular"
    assert error(got, true).max() < 0.1 * PERIOD


@settings(max_examples=150, deadline=None)
@given(
    stamps=st.lists(st.integers(-(2**60), 2**60) | st.integers(0, 5), max_size=60),
    seed=st.integers(0, 9),
)
def test_times_rise_strictly_whatever_the_stamps(stamps: list[int], seed: int) -> None:
    stamp = np.array(stamps, dtype=np.int64)
    rng = np.random.default_rng(seed)
    log_time = rng.integers(0, 2**60, stamp.size)
    times = sample_times(stamp, log_time, rng.standard_normal((stamp.size, 3)))
    assert (np.diff(times.time) > 0).all()
    assert times.time.size == times.kept.size
    assert np.unique(times.kept).size == times.kept.size
    assert times.time.size > 0 or stamp.size == 0


def test_a_single_sample_that_moves_says_little_of_stamps() -> None:
    """A share that is fitted to one sample leaves none of it over, whatever noise did to it."""
    rng = np.random.default_rng(6)
    regular = 0.01 * np.arange(N)
    stamp = regular.copy()
    stamp[700] += 0.02
    signal = 0.1 * rng.standard_normal((N, 1))
    signal[701:] += 1.0
    told = weigh_stamps(stamp[None], regular[None], [signal])
    assert told.uncertainty[0] > 0.25


@pytest.mark.parametrize("burst", [3, 7, 40, 64])
@pytest.mark.parametrize("lost", [False, True])
def test_samples_that_arrive_in_bursts_lie_on_a_line(burst: int, lost: bool) -> None:
    rng = np.random.default_rng(burst)
    true = np.arange(N) / 493.7  # a rate that no data sheet knows
    signal = moving(true, 0.01, rng)
    last = np.minimum((np.arange(N) // burst + 1) * burst - 1, N - 1)
    late = (2e-3 + 5e-4 * rng.random(N))[last]
    arrival = true[last] + late + 2e-5 * (np.arange(N) % burst)
    kept = np.ones(N, np.bool_)
    if lost:
        for k in rng.choice(N // burst - 2, 4, replace=False) + 1:
            kept[k * burst : (k + 1) * burst] = False
    found = sample_times(
        np.rint(1e9 * (1 + arrival[kept])).astype(np.int64),
        np.rint(1e9 * (1 + arrival[kept])).astype(np.int64),
        signal[kept],
    )
    assert found.chosen == "regular"
    off = found.time / 1e9 - 1 - true[kept][found.kept]
    # All alike late is a latency, found later on; each for itself is an error.
    assert np.std(off) < 2e-4
    assert abs(off.mean() - 2.25e-3) < 2e-3
    assert found.noise < 1e-3


@pytest.mark.parametrize("burst", [2, 4, 16])
@pytest.mark.parametrize("share", [0.005, 0.05])
@pytest.mark.parametrize("reads", ["full", "regular", "irregular"])
def test_bursts_that_lack_messages_are_told_by_when_they_end(
    reads: str, share: float, burst: int
) -> None:
    """Counting goes astray by several periods; what is lost within a burst leaves a part of one."""
    rng = np.random.default_rng(17)
    true = np.arange(N) / 493.7
    if reads == "full":
        last = np.minimum((np.arange(N) // burst + 1) * burst - 1, N - 1)
        arrival = true[last] + 2e-4 * rng.random(N)[last]
    else:
        every = (burst + 0.37) / 493.7
        steps = every * (rng.uniform(0.5, 1.5, N) if reads == "irregular" else np.ones(N))
        read = np.cumsum(steps)
        arrival = read[np.searchsorted(read, true)]
    first = np.searchsorted(arrival, arrival)
    kept = rng.random(N) > share
    stamp = (arrival + 2e-6 * (np.arange(N) - first))[kept]
    signal = moving(true, 0.01, rng)[kept]
    times, got = timed(stamp, signal)
    off = got - true[kept][times.kept]
    assert np.std(off) * 493.7 < 0.6


def many_kinds_of_streams(samples: int) -> list[Stamped]:
    """Streams of as many samples: jittering, exact, in bursts, with losses, without stamps."""
    rng = np.random.default_rng(7)
    out = []
    for kind in range(18):
        true = np.arange(samples) * PERIOD
        if kind % 6 == 1:
            true = true + 0.3 * PERIOD * rng.uniform(-1, 1, samples)
        elif kind % 6 == 2:
            true = true + 0.1 * (np.arange(samples) > samples // 3)
        stamp = true if kind % 6 == 1 else true + 0.2 * PERIOD * rng.exponential(size=samples)
        if kind % 6 == 3:
            stamp = PERIOD * (np.arange(samples) // 8 * 8) + 1e-5 * np.arange(samples)
        elif kind % 6 == 4:
            stamp[5::97] += 20.0
        signal = moving(true, 0.03, rng)
        stamps = ns(stamp)
        out.append(Stamped(np.zeros_like(stamps) if kind % 6 == 5 else stamps, ns(true), signal))
    return out


def test_streams_timed_together_get_the_times_that_they_get_alone() -> None:
    for samples in (9, 130, 800, 2400):
        streams = many_kinds_of_streams(samples) + many_kinds_of_streams(samples - 1)
        for stream, found in zip(streams, sample_times_of(streams), strict=True):
            alone = sample_times(*stream)
            assert found.chosen == alone.chosen
            assert found.stamped == alone.stamped
            np.testing.assert_array_equal(found.kept, alone.kept)
            assert np.abs(found.time - alone.time).max() <= 1
            assert found.noise == pytest.approx(alone.noise, abs=1e-9)


def test_many_short_streams_are_timed_in_less_time_together() -> None:
    rng = np.random.default_rng(8)
    true = np.arange(300) * PERIOD
    jittered = true + 0.1 * PERIOD * rng.random((100, 300))
    streams = [Stamped(ns(each), ns(true), moving(true, 0.01, rng)) for each in jittered]

    def seconds(batches: list[list[Stamped]]) -> float:
        begin = time.process_time()
        for batch in batches:
            sample_times_of(batch)
        return time.process_time() - begin

    seconds([streams])
    together = min(seconds([streams]) for _ in range(3))
    alone = min(seconds([[stream] for stream in streams]) for _ in range(3))
    assert together < 0.5 * alone


@pytest.mark.parametrize("count", [1, 2, 5, 64, 2047])
def test_medians_of_rows_are_their_medians(count: int) -> None:
    rows = np.random.default_rng(count).standard_normal((4, count))
    rows[2, count // 2] = np.nan
    expected = [*np.median(rows[:2], axis=1), np.nan, np.median(rows[3])]
    np.testing.assert_allclose(medians_of(rows), expected)
    np.testing.assert_allclose([median_of(row) for row in rows], expected)
