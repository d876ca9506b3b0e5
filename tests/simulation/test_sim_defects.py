"""Defects of sensors, clocks and messages, each by itself."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.errors import UsageError
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.records import JointStream, SuStream
from skin2urdf.simulation import Simulation, SimulationSettings, load_robot, simulate
from skin2urdf.simulation.defects import (
    BiasWalk,
    Bursts,
    CoarseDigits,
    Defect,
    Glitches,
    Held,
    HeldPositions,
    LocalGravity,
    Lost,
    LowPass,
    Nonlinearity,
    OnArrival,
    OnChange,
    OwnRates,
    ReadInTurn,
    SecondPublisher,
    SlippingCoupling,
    SmoothedPositions,
    Spikes,
    Stalls,
    SuClock,
    UnsteadyClock,
    Vibration,
    WarmUp,
)
from skin2urdf.simulation.defects.records import Felt

RNG = np.random.default_rng(0)


def felt(force: F64, rate: float = 500.0, speed: F64 | None = None) -> Felt:
    still = np.zeros(len(force)) if speed is None else speed
    return Felt("su", np.arange(len(force)) / rate, force, still)


def recorded(*defects: Defect) -> Simulation:
    settings = SimulationSettings(
        excite="none", minutes=0.1, imu_rate=200.0, joint_rate=50.0, seed=3, defects=defects
    )
    return simulate(load_robot("so101"), settings)


@pytest.mark.parametrize("frequency", [2.0, 15.0])
@pytest.mark.parametrize(("cutoff", "order"), [(21.0, 1), (10.0, 1), (21.0, 2)])
def test_a_low_pass_droops_and_lags_as_its_transfer_function_says(
    cutoff: float, order: int, frequency: float
) -> None:
    w = 2 * pi * frequency
    time = np.arange(2000) / 500.0
    wave = np.sin(w * time)[:, None] * np.ones(3)
    out = LowPass(cutoff, order).sense(felt(wave), RNG)
    settled = time > 2.0
    basis = np.column_stack([np.sin(w * time), np.cos(w * time)])[settled]
    real, imaginary = np.linalg.lstsq(basis, out[settled, 0], rcond=None)[0]
    s = 1j * frequency / cutoff
    expected = 1 / (1 + s) if order == 1 else 1 / (1 + 2**0.5 * s + s**2)
    assert real + 1j * imaginary == pytest.approx(expected, abs=5e-4)


def test_a_low_pass_leaves_what_does_not_change() -> None:
    force = np.tile([1.0, -2.0, 9.0], (500, 1))
    np.testing.assert_allclose(LowPass(5.0, 2).sense(felt(force), RNG), force, atol=1e-12)
    with pytest.raises(UsageError):
        LowPass(10.0, 3)


def test_warming_up_ends_at_its_size() -> None:
    force = np.zeros((1000, 3))
    out = WarmUp(2e-3).sense(felt(force), np.random.default_rng(1))
    np.testing.assert_allclose(np.abs(out[-1]), 2e-3 * 9.81, rtol=1e-9)
    np.testing.assert_allclose(out[0], 0.0)
    steps = np.abs(np.diff(out, axis=0))
    # Fast at first, slow at the end.
    assert (steps[0] > 3 * steps[-1]).all()


def test_biases_walk_as_far_as_set_in_a_minute() -> None:
    rng = np.random.default_rng(2)
    ends = np.array(
        [BiasWalk(1e-3).sense(felt(np.zeros((61, 3)), 1.0), rng)[-1] for _ in range(300)]
    )
    assert ends.std() == pytest.approx(1e-3 * 9.81, rel=0.1)


def test_nonlinearity_is_largest_at_full_scale() -> None:
    force = np.outer([0.0, 0.5, 1.0, -1.0], 4 * 9.81 * np.ones(3))
    off = Nonlinearity(5e-3).sense(felt(force), np.random.default_rng(0)) - force
    full = 5e-3 * 4 * 9.81
    part = np.outer([0.0, 0.25, 1.0, 1.0], np.ones(3))
    np.testing.assert_allclose(np.abs(off), full * part)
    np.testing.assert_allclose(off[2], off[3])


def test_vibration_hums_at_its_frequency_while_joints_move() -> None:
    speed = np.repeat([0.0, 2.0], 5000)
    out = Vibration(0.5, frequency=40.0).shake(
        felt(np.zeros((10_000, 3)), speed=speed), np.random.default_rng(0)
    )
    assert np.abs(out[:5000]).max() == 0.0
    assert out[5000:].std() == pytest.approx(1.0, rel=0.15)
    spectrum = np.abs(np.fft.rfft(out[5000:, 0])) ** 2
    frequency = np.fft.rfftfreq(5000, 1 / 500)
    near = (frequency > 30) & (frequency < 50)
    assert spectrum[near].sum() > 0.5 * spectrum.sum()
    # It has no mean that a pose would show.
    assert abs(out[5000:].mean()) < 0.02


def test_clocks_are_late_and_run_fast() -> None:
    time = np.array([1.0, 11.0, 101.0])
    shown = SuClock(offset=0.08, drift=1e-3).clock(time, RNG)
    np.testing.assert_allclose(shown - time, [0.08, 0.09, 0.18])
    own = [
        SuClock(offset=0.1, common=False).clock(time, np.random.default_rng(i)) for i in range(20)
    ]
    offsets = np.array([clock[0] - time[0] for clock in own])
    assert np.abs(offsets).max() <= 0.1
    assert np.ptp(offsets) > 0.1


def test_an_unsteady_clock_is_slewed_and_stepped_alike_for_all() -> None:
    time = np.linspace(10.0, 70.0, 601)
    defect = UnsteadyClock(slewed=5e-3, period=40.0, stepped=0.06)
    late = defect.clock(time, np.random.default_rng(0)) - time
    np.testing.assert_allclose(late[:400].max(), 5e-3, rtol=1e-3)
    assert late[401:].min() > 0.05
    np.testing.assert_array_equal(late, defect.clock(time, np.random.default_rng(1)) - time)


def stream(n: int = 20_000) -> SuStream:
    rng = np.random.default_rng(3)
    return SuStream("su", np.arange(n) / 500.0, rng.standard_normal((n, 3)))


def test_held_values_repeat() -> None:
    sound = stream(103)
    held = Held(5).send(sound, RNG)
    for i in range(103):
        np.testing.assert_array_equal(held.specific_force[i], sound.specific_force[i - i % 5])


def test_positions_are_held_until_they_are_read_again() -> None:
    position = np.arange(60.0)
    (held,) = HeldPositions(3).publish((JointStream("j", position / 100.0, position),), RNG)
    np.testing.assert_array_equal(held.position[:8], [0, 0, 0, 3, 3, 3, 6, 6])
    np.testing.assert_array_equal(held.time, position / 100.0)


def test_servos_that_are_read_in_turn_are_where_they_were() -> None:
    time = np.arange(500) / 100.0
    joints = tuple(JointStream(name, time, np.sin(3 * time)) for name in "abc")
    read = ReadInTurn(0.013).publish(joints, RNG)
    for joint, by in zip(read, (0.026, 0.013, 0.0), strict=True):
        np.testing.assert_array_equal(joint.time, time)
        np.testing.assert_allclose(joint.position[3:], np.sin(3 * (time[3:] - by)), atol=1e-5)


def test_servos_that_are_read_in_turn_count_steps() -> None:
    time, step = np.arange(500) / 100.0, 2 * np.pi / 2**14
    counted = step * np.rint(np.sin(3 * time) / step)
    joints = tuple(JointStream(name, time, counted) for name in ("a", "b"))
    for joint in ReadInTurn(0.004).publish(joints, RNG):
        np.testing.assert_allclose(joint.position / step, np.rint(joint.position / step), atol=1e-9)


def test_means_of_positions_lag_by_half_their_time_and_lack_of_fast_motion() -> None:
    time = np.arange(2000) / 200.0
    (joint,) = SmoothedPositions(0.2).publish((JointStream("j", time, np.cos(9 * time)),), RNG)
    lacking = np.sin(0.9) / 0.9
    there = time > 0.2
    expected = lacking * np.cos(9 * (time - 0.1))
    np.testing.assert_allclose(joint.position[there], expected[there], atol=1e-3)
    assert joint.position[0] == pytest.approx(1.0)


def test_what_is_sent_on_change_is_silent_at_rest_but_for_a_timer() -> None:
    time = np.arange(1000) / 100.0
    moving = JointStream("j", time, np.clip(time - 4.0, 0.0, 2.0))
    still = JointStream("k", time, np.full(1000, 0.3))
    sent = OnChange(1.0).publish((moving, still), RNG)
    for joint, whole in zip(sent, (moving, still), strict=True):
        at = np.rint(100 * joint.time).astype(int)
        np.testing.assert_array_equal(joint.position, whole.position[at])
        assert np.isin(np.arange(401, 601), at).all()
        assert np.diff(joint.time).max() == pytest.approx(1.0)
        assert len(at) < 220


def test_glitches_are_single_positions() -> None:
    time = np.arange(20_000) / 100.0
    sound = JointStream("j", time, np.sin(time))
    (struck,) = Glitches(1e-3).publish((sound,), np.random.default_rng(0))
    wrong = struck.position != sound.position
    assert 8 <= wrong.sum() <= 36
    assert (struck.position[wrong] == 0).mean() > 0.2
    assert np.abs(struck.position).max() <= np.abs(sound.position).max()


def test_a_coupling_slips_in_proportion_to_the_way_that_its_joint_goes() -> None:
    time = np.arange(1001) / 100.0
    sound = tuple(JointStream(name, time, np.sin(2 * np.pi * 0.1 * time)) for name in "ab")
    sent = SlippingCoupling(1e-3).publish(sound, np.random.default_rng(0))
    off = [s.position - w.position for s, w in zip(sent, sound, strict=True)]
    (slips,) = (o for o in off if o.any())
    # One period there and back, which a sine goes four times its amplitude.
    np.testing.assert_allclose(np.abs(slips[[0, 250, 500, 1000]]), [0, 1e-3, 2e-3, 4e-3], atol=1e-9)


def test_a_sensor_that_warms_up_reads_more_or_less_per_push() -> None:
    force = np.tile([0.0, 5.0, 10.0], (1000, 1))
    read = WarmUp(0.0, scale=4e-3).sense(felt(force), np.random.default_rng(3))
    np.testing.assert_allclose(read[0], force[0])
    np.testing.assert_allclose(np.abs(read[-1] - force[-1]), 4e-3 * force[-1], rtol=1e-9)


def test_digits_are_the_nearest() -> None:
    sound = stream()
    rounded = CoarseDigits(16e-3).send(sound, RNG).specific_force
    digit = 16e-3 * GRAVITY
    np.testing.assert_allclose(rounded / digit, np.round(rounded / digit), atol=1e-9)
    assert np.abs(rounded - sound.specific_force).max() <= digit / 2


def test_spikes_strike_their_share() -> None:
    sound = stream()
    off = Spikes(1e-3, 2.0).send(sound, np.random.default_rng(0)).specific_force
    off = off - sound.specific_force
    struck = np.abs(off).max(axis=1) > 0
    assert 8 <= struck.sum() <= 36
    assert ((off != 0).sum(axis=1) <= 1).all()
    assert np.abs(off).max() <= 2 * 9.81


def test_lost_messages_are_missing() -> None:
    sound = stream()
    left = Lost(0.02).send(sound, np.random.default_rng(0))
    assert len(left.time) == pytest.approx(0.98 * len(sound.time), rel=0.005)
    kept = np.isin(sound.time, left.time)
    np.testing.assert_array_equal(sound.specific_force[kept], left.specific_force)


def test_bursts_are_stamped_when_their_last_reading_is_there() -> None:
    sound, late = stream(4001), 2e-4
    sent = Bursts(4, late, 0.0).send(sound, np.random.default_rng(0)).time
    waited = sent - sound.time
    assert waited.min() >= 0
    ends = np.flatnonzero(np.diff(sent) > 4e-3)[1:]
    assert set(np.diff(ends)) == {4}
    assert waited[ends].mean() == pytest.approx(late + 3 * 2e-5, rel=0.1)
    assert waited[ends - 3] == pytest.approx(3 / 500 + waited[ends] - 3 * 2e-5, abs=1e-9)
    left = Bursts(4, late, 0.1).send(sound, np.random.default_rng(0))
    assert len(left.time) == pytest.approx(0.9 * 4001, rel=0.03)


def test_what_is_sent_in_a_stall_comes_at_its_end() -> None:
    sound = stream(50_000)
    sent = Stalls(5.0, 0.25).send(sound, np.random.default_rng(0)).time
    waited = sent - sound.time
    assert waited.min() > -1e-12
    assert 0.2 < waited.max() < 0.26
    pauses = np.flatnonzero(np.diff(sent) > 5e-3)
    assert 8 <= len(pauses) <= 35
    assert (np.diff(sent)[pauses + 1] < 1e-4).mean() > 0.9
    assert np.mean(waited > 1e-3) < 0.06


def test_sus_of_rates_of_their_own_send_samples_as_they_were() -> None:
    plain, slow = recorded().recording.sus, recorded(OwnRates(4)).recording.sus
    steps = {round(len(a.time) / len(b.time)) for a, b in zip(plain, slow, strict=True)}
    assert steps <= {1, 2, 3, 4}
    assert len(steps) > 1
    for a, b in zip(plain, slow, strict=True):
        np.testing.assert_array_equal(
            a.at(np.isin(a.time, b.time)).specific_force, b.specific_force
        )


def test_stamps_made_on_arrival_are_late_and_in_order() -> None:
    plain, late = recorded().recording, recorded(OnArrival(5e-3)).recording
    assert len({id(joint.time) for joint in late.joints}) == 1
    for a, b in zip((*plain.sus, *plain.joints), (*late.sus, *late.joints), strict=True):
        # Each recording begins with its own first stamp.
        delay = b.time - a.time
        assert (np.diff(b.time) > 0).all()
        assert 4e-3 < delay.mean() - delay.min() < 9e-3


def test_an_su_at_rest_feels_the_gravity_of_the_place() -> None:
    simulation = recorded(LocalGravity(9.781))
    assert np.linalg.norm(simulation.truth.gravity_base) == pytest.approx(9.781)
    base = next(su.name for su in simulation.truth.sus if su.joint < 0)
    u = [su.name for su in simulation.truth.sus].index(base)
    reading = simulation.recording.sus[u].specific_force.mean(axis=0)
    assert np.linalg.norm(reading - simulation.truth.bias[u]) == pytest.approx(9.781, abs=1e-3)


def test_one_defect_does_not_change_what_another_draws() -> None:
    alone = recorded(WarmUp())
    both = recorded(Lost(), WarmUp())
    plain = recorded()
    for one, two, none in zip(
        alone.recording.sus, both.recording.sus, plain.recording.sus, strict=True
    ):
        kept = np.isin(one.time, two.time)
        assert 0.9 < kept.mean() < 1.0
        np.testing.assert_array_equal(one.specific_force[kept], two.specific_force)
        np.testing.assert_array_equal(one.time, none.time)
    assert alone.truth.urdf == both.truth.urdf == plain.truth.urdf


def test_a_second_publisher_stamps_its_joints_by_a_clock_of_its_own() -> None:
    plain = recorded().recording
    names = ("wrist_flex", "wrist_roll")
    for chosen in (names, None):
        # By default it has the second half of the names.
        apart = recorded(SecondPublisher(0.1, 1e-3, chosen)).recording
        assert [j.name for j in apart.joints] == [j.name for j in plain.joints]
        for before, after in zip(plain.joints, apart.joints, strict=True):
            own = after.name in names
            first = before.time[own::2]
            middle = (before.time[0] + before.time[-1]) / 2
            late = 0.1 + 1e-3 * (first - middle) if own else 0.0
            np.testing.assert_allclose(after.time, first + late, atol=1e-9)
            np.testing.assert_array_equal(after.position, before.position[own::2])
