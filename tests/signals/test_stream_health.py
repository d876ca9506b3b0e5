"""Faults of streams as they stand in a log: each is named, and sound ones have none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from simulated import sampled_of, simulation

from skin2urdf.notes import ReadingNote
from skin2urdf.recording.records import SuStream
from skin2urdf.signals.health import checked, clipping, rest_noise


def stream(samples: np.ndarray, name: str = "su") -> SuStream:
    return SuStream(name, np.arange(len(samples)) / 250.0, samples)


def noise(n: int = 5000, sd: float = 0.01, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, sd, (n, 3))


def kinds(*streams: SuStream) -> list[list[str]]:
    spans = [(0.0, 20.0)]
    return [[f.kind for f in c.faults] for c in checked(streams, spans, (0.0, 20.0))]


def test_sensors_without_noise_are_not_frozen_while_the_robot_rests() -> None:
    still = stream(np.ones((5000, 3)))
    assert kinds(still, still, still) == [[], [], []]


def test_an_su_that_ends_early_is_dead_unless_a_part_of_it_was_left_out() -> None:
    ends = stream(noise(3000), "ends")
    others = [stream(noise(seed=1), "b"), stream(noise(seed=2), "c")]

    def faults_of(cut: tuple[str, ...]) -> list[tuple[str, str]]:
        found = checked([ends, *others], [(0.0, 20.0)], (0.0, 20.0), cut=cut)
        return [(f.kind, f.subject) for c in found for f in c.faults]

    assert faults_of(()) == [("dead", "ends")]
    assert faults_of(("b",)) == [("dead", "ends")]
    assert faults_of(("ends",)) == []


def test_an_su_whose_clock_jumped_is_not_dead_where_it_was_cut() -> None:
    whole = simulation("so101").recording
    first, *others = whole.sus
    half = first.at(slice(len(first.time) // 2, None))
    begins_late = replace(whole, sus=(half, *others))
    jumped = ReadingNote("own clock jump", "", (first.topic,), 1)
    assert [fault.kind for fault in sampled_of(begins_late).faults] == ["dead"]
    assert not sampled_of(replace(begins_late, notes=(jumped,))).faults


def test_a_constant_stream_among_noisy_ones_is_frozen() -> None:
    constant = np.full((5000, 3), 5.7)  # gravity may be in it
    assert kinds(stream(constant), stream(noise()), stream(noise(seed=1))) == [["frozen"], [], []]
    assert kinds(stream(0 * constant), stream(noise()), stream(noise(seed=1)))[0] == ["dead"]


def turning(about: np.ndarray) -> np.ndarray:
    """(5000, 3) gravity in a frame that turns about one direction from rest to rest."""
    angle = np.repeat(np.linspace(0.0, 5.0, 20), 250)
    return Rotation.from_rotvec(angle[:, None] * about).apply([3.0, 5.0, 7.9])


@pytest.mark.parametrize(("digit", "value"), [(0.0, 0.0), (1e-3, 9.1), (0.2, 0.0), (0.04, -4.0)])
def test_an_axis_of_one_value_costs_an_su(digit: float, value: float) -> None:
    samples = turning(np.array([0.6, 0.8, 0.0])) + noise()
    samples = np.round(samples / digit) * digit if digit else samples
    sound = samples.copy()
    samples[:, 2] = value
    rests = [(0.0, 20.0)]
    (broken, other) = checked([stream(samples, "a"), stream(sound, "b")], rests, (0.0, 20.0))
    assert [(fault.kind, fault.detail) for fault in broken.faults] == [("frozen", "z axis")]
    assert not len(broken.stream.time)
    assert not other.faults


def test_the_axis_that_a_joint_turns_about_may_have_one_value() -> None:
    digit = 0.2
    samples = turning(np.array([0.0, 0.0, 1.0])) + np.array([0.8, -0.9, 0.1]) + noise()
    coarse = np.round(samples / digit) * digit
    assert len(np.unique(coarse[:, 2])) == 1
    assert not any(map(len, kinds(stream(coarse, "a"), stream(coarse, "b"))))


def test_values_that_every_sensor_repeats_are_no_fault() -> None:
    """A driver that publishes each sample five times."""
    slow = [stream(np.repeat(noise(1000, seed=s), 5, axis=0)) for s in range(3)]
    assert kinds(*slow) == [[], [], []]


def coarse(sd: float, seed: int) -> np.ndarray:
    """Readings (5000, 3) in digits of 0.04 m/s^2: five places of 1 s, then three of 5 s."""
    rng = np.random.default_rng(seed)
    seconds = [1, 1, 1, 1, 1, 5, 5, 5]
    places = np.repeat(rng.uniform(-5.0, 5.0, (len(seconds), 3)), 250 * np.array(seconds), axis=0)
    return np.asarray(np.round((places + rng.normal(0.0, sd, places.shape)) / 0.04) * 0.04)


@pytest.mark.parametrize("seed", range(10))
def test_a_quiet_sensor_that_rests_within_a_digit_is_not_frozen(seed: int) -> None:
    streams = [stream(coarse(0.004, 100 * seed + i)) for i in range(6)]
    assert kinds(*streams) == [[]] * 6


@pytest.mark.parametrize("seed", range(10))
def test_a_sensor_whose_noise_spreads_over_digits_is_frozen_where_it_repeats(seed: int) -> None:
    streams = [stream(coarse(0.03, 100 * seed + i)) for i in range(3)]
    held = streams[0].specific_force.copy()
    held[2000:2600] = held[2000]
    assert kinds(stream(held), *streams[1:]) == [["frozen"], [], []]


def test_a_spread_of_noise_is_no_fault() -> None:
    alike = [stream(noise(sd=0.01 * f, seed=i)) for i, f in enumerate((0.5, 0.8, 1.0, 1.3, 2.0))]
    assert kinds(*alike) == [[]] * 5
    assert kinds(*alike, stream(noise(sd=0.1, seed=9)))[-1] == ["noisy"]


def test_no_su_is_noisy_whose_readings_lie_at_the_edge_of_a_digit() -> None:
    """With digits of twice the noise most steps are none within one, and a digit at its edge."""
    within = [stream(np.round(noise(sd=0.0047, seed=i) / 0.01) * 0.01) for i in range(3)]
    edge = stream(np.round((noise(sd=0.0047, seed=3) + 0.005) / 0.01) * 0.01)
    assert kinds(*within, edge) == [[]] * 4
    loud = stream(np.round(noise(sd=0.08, seed=4) / 0.01) * 0.01)
    assert kinds(*within, loud) == [[], [], [], ["noisy"]]


def test_values_that_no_motion_made_cost_an_su_and_a_hit_does_not() -> None:
    rests = [(2.0 * k, 2.0 * k + 1.5) for k in range(10)]
    rng = np.random.default_rng(3)
    filled = noise() + np.array([0.0, 4.4, 8.8])
    filled[rng.random(len(filled)) < 0.1, 2] = 0.0
    hit = noise(seed=1) + np.array([0.0, 4.4, 8.8])
    hit[1100:1150] += 5.0 * rng.normal(size=(50, 3))
    coarse = np.round(noise(sd=0.01, seed=2) / 0.04) * 0.04 + np.array([0.0, 0.0, 9.8])
    found = checked([stream(filled), stream(hit), stream(coarse)], rests, (0.0, 20.0))
    assert [[f.kind for f in c.faults] for c in found] == [["noisy"], [], []]
    assert [len(c.stream.time) for c in found] == [0, 5000, 5000]


def test_what_shakes_while_joints_creep_is_no_fault() -> None:
    """A motor that sounds now and then: as large as zeros in place of readings, but to both sides.

    Zeros make the mean another, and so does what bounces on a stop.
    """
    rests = [(2.0 * k, 2.0 * k + 1.5) for k in range(10)]
    time = np.arange(5000) / 250.0
    sounds = np.sin(2 * np.pi * 1.7 * time) > 0.6
    shaking = noise() + np.array([0.0, 4.4, 8.8])
    shaking += np.outer(sounds * np.sin(2 * np.pi * 61.3 * time), (0.3, 0.9, 0.5))
    bouncing = shaking + np.outer(sounds * (np.sin(2 * np.pi * 61.3 * time) > 0.8), (0, 0, 2.0))
    found = checked([stream(shaking), stream(bouncing)], rests, (0.0, 20.0))
    assert [[f.kind for f in c.faults] for c in found] == [[], ["noisy"]]
    assert [len(c.stream.time) for c in found] == [5000, 0]


def test_what_swings_on_when_a_rest_begins_is_no_fault() -> None:
    """Of sensors without noise that is all there is at rest."""
    rests = [(2.0 * k, 2.0 * k + 1.5) for k in range(10)]
    since = np.arange(5000) / 250.0 % 2.0
    swing = 3.0 * np.exp(-since / 0.08) * np.sin(2 * np.pi * 4.0 * since)
    swinging = stream(np.outer(swing, (0.6, 0.8, 0.0)) + np.array([0.0, 4.4, 8.8]))
    found = checked([swinging] * 3, rests, (0.0, 20.0))
    assert [c.faults for c in found] == [()] * 3


def test_noise_is_measured_at_rest() -> None:
    samples = noise(sd=0.02)
    assert rest_noise(samples, np.ones(len(samples), dtype=bool)) == pytest.approx(0.02, rel=0.05)


def test_a_few_lost_samples_are_no_fault_and_many_are() -> None:
    rng = np.random.default_rng(0)
    whole = stream(noise())

    def losing(share: float) -> SuStream:
        kept = rng.random(5000) > share
        return replace(whole, time=whole.time[kept], specific_force=whole.specific_force[kept])

    assert kinds(losing(0.02), losing(0.3)) == [[], ["intermittent"]]


@pytest.mark.parametrize("scatter", [0.2, 0.4, 0.6])
def test_stamps_that_scatter_tell_of_no_loss(scatter: float) -> None:
    whole = stream(noise())
    late = scatter / 250.0 * np.random.default_rng(0).standard_normal(len(whole.time))
    stamps = np.maximum.accumulate(whole.time + late) + 1e-6 * np.arange(len(late))
    assert kinds(replace(whole, time=stamps)) == [[]]


def test_a_pause_of_the_whole_recording_is_no_loss() -> None:
    whole = stream(noise())
    kept = (whole.time % 4.0) < 2.5
    torn = replace(whole, time=whole.time[kept], specific_force=whole.specific_force[kept])
    pauses = [(4.0 * k + 2.5, 4.0 * k + 4.0) for k in range(5)]
    spans = [(0.0, 1.0)]
    (with_pauses,) = checked([torn], spans, (0.0, 10.0), pauses)
    assert not with_pauses.faults
    (without_pauses,) = checked([torn], spans, (0.0, 10.0))
    assert [fault.kind for fault in without_pauses.faults] == ["intermittent"]


def test_a_stream_that_ends_early_is_dead_from_then_on() -> None:
    whole = stream(noise())
    short = replace(whole, time=whole.time[:3000], specific_force=whole.specific_force[:3000])
    assert kinds(short, whole) == [["dead"], []]


def test_only_samples_at_the_end_of_the_range_are_clipped() -> None:
    wave = 10 * np.sin(np.arange(5000) / 20.0)[:, None] + noise()
    cut = np.clip(wave, -9.0, 9.0)
    moving = np.zeros(5000, dtype=bool)
    found = clipping(cut, moving)
    assert found[(np.abs(cut) == 9.0).any(axis=1)].all()
    assert not found[(np.abs(cut) < 0.997 * 9.0).all(axis=1)].any()
    assert not clipping(wave, moving).any()


def test_noise_that_ends_too_early_tells_at_rest_as_well() -> None:
    """A range that ends within gravity is met in the poses where gravity is along an axis."""
    rng, time = np.random.default_rng(5), np.arange(4000) / 200
    wave = 4.0 * np.sin(0.5 * time[:, None] + [0.0, 1.5, 3.0])
    still = np.zeros(4000, dtype=bool)
    still[1000:1400] = True
    wave[still] = [9.0, 1.0, 0.0]
    resting = wave + rng.normal(scale=0.02, size=wave.shape)
    assert not clipping(resting, still).any()
    np.testing.assert_array_equal(clipping(np.minimum(resting, 8.9), still), still)
    # Without noise a value at rest may well be the largest.
    assert not clipping(np.minimum(wave, 8.9), still).any()


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.3, 1.2), st.floats(1.0, 3.0))
def test_a_coarse_noisy_sensor_is_clipped_where_its_noise_ends_too_early(
    seed: int, depth: float, digits: float
) -> None:
    """A motion of one amplitude whose peaks the range cuts within their own noise."""
    rng, digit = np.random.default_rng(seed), 0.04
    time = np.arange(60000) / 500
    wave = 6 * np.sin(2 * np.pi * np.array([0.9, 1.3, 1.7]) * time[:, None])
    wave[:5000] = wave[5000]
    wave += rng.normal(scale=digits * digit, size=wave.shape)
    still = time < 10.0
    whole = np.round(wave / digit) * digit
    assert not clipping(whole, still).any()
    end = digit * np.round((6 - depth * digits * digit) / digit)
    found = clipping(np.clip(whole, -end, end), still)
    np.testing.assert_array_equal(found, (np.abs(whole) > end * (1 - 2.5e-3)).any(axis=1))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(2.5, 20.0), st.floats(0.1, 0.5))
@example(666, 3.0, 0.1015625)
@example(2049427296, 3.876, 0.1402)
@example(949177654, 14.03247, 0.121315)
def test_what_shakes_within_edges_is_not_cut_off(seed: int, digits: float, noise: float) -> None:
    """A motor's vibration is a wave of one amplitude, which coarse digits show some times each."""
    rng, digit = np.random.default_rng(seed), 0.01
    time = np.arange(12000) / 50
    shaking = digits * digit * np.sin(2 * np.pi * (rng.uniform(5, 20) * time + rng.uniform()))
    wave = shaking[:, None] * rng.uniform(0.3, 1.0, 3) + [-4.2, 7.6, -4.1]
    wave += rng.normal(scale=noise * digit, size=wave.shape)
    still = time % 4 < 1
    assert not clipping(np.round(wave / digit) * digit, still).any()


def test_one_peak_that_is_cut_off_is_clipped_and_a_flat_one_is_not() -> None:
    moving = np.zeros(4000, dtype=bool)
    time = np.arange(4000) / 500
    wave = 10 * np.sin(2 * np.pi * 0.3 * time) + 6 * np.exp(-(((time - 0.9) / 0.05) ** 2))
    peaks = np.stack([wave, 0.5 * wave, 0.2 * wave], axis=1)
    digital = np.round(peaks / 0.04) * 0.04
    assert not clipping(digital, moving).any()
    cut = np.minimum(digital, 13.0)
    np.testing.assert_array_equal(clipping(cut, moving), (cut[:, 0] >= 13.0))
    slow = np.round(10 * np.sin(2 * np.pi * 0.3 * time[:, None] + [0.0, 1.0, 2.0]) / 0.04) * 0.04
    assert not clipping(slow, moving).any()


def test_values_that_are_sent_again_are_no_plateau() -> None:
    """Boards that are polled faster than they measure repeat all axes, at an extreme as well."""
    time = np.arange(800) / 20
    rng = np.random.default_rng(3)
    wave = 9.8 * np.sin(0.7 * time[:, None] + [0.0, 1.0, 2.0])
    wave += rng.normal(scale=0.03, size=wave.shape)
    wave[400] = [11.5, -2.0, 3.0]
    held = np.repeat(np.round(wave / 0.01) * 0.01, 7, axis=0)
    assert not clipping(held, np.zeros(len(held), dtype=bool)).any()


def test_no_axis_ends_where_another_reads_on() -> None:
    """An axis along the joint's hardly moves, and stays at its extreme for long."""
    time = np.arange(6000) / 500
    wave = 9.8 * np.sin(np.pi * time[:, None] + [0.0, 1.5, 0.0])
    wave[:, 2] = np.minimum(0.5 * np.sin(1.5 * time), 0.45)
    digital = np.round(wave / 0.01) * 0.01
    assert not clipping(digital, np.zeros(len(digital), dtype=bool)).any()


@pytest.mark.parametrize(("value", "kind"), [(0.0, "dead"), (-6e-4, "dead"), (5.7, "frozen")])
def test_one_value_throughout_is_dead_unless_gravity_may_be_in_it(value: float, kind: str) -> None:
    whole = stream(noise())
    same = replace(whole, specific_force=np.full_like(whole.specific_force, value))
    assert kinds(same, whole, whole)[0] == [kind]


def test_slow_motion_is_no_noise() -> None:
    """Where a robot never rests, its slowest moments stand for rests."""
    rng = np.random.default_rng(5)
    t = np.arange(4000)[:, None] / 100.0
    swing = 4.0 * np.sin(2 * np.pi * np.array([0.5, 0.9, 0.3]) * t)
    samples = swing + 0.02 * rng.standard_normal((4000, 3))
    everywhere = np.ones(4000, dtype=bool)
    assert rest_noise(samples, everywhere, 3) == pytest.approx(0.02, rel=0.05)
    assert rest_noise(samples, everywhere) > 0.1
