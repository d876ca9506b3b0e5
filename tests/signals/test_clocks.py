"""Clocks of SUs that are late and run too fast, on recordings whose streams are retimed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from joint_paths import JointPath
from simulated import changed_sus, sampled_of, simulation

from skin2urdf.recording.records import Recording, SuStream
from skin2urdf.report.clocks import clock_notes
from skin2urdf.signals.clocks import su_clocks, widening_by_few_moves
from skin2urdf.signals.motion import joint_motion
from skin2urdf.signals.records import SuClock
from skin2urdf.simulation import SimulationSettings, load_robot, simulate


def retimed(recording: Recording, latency: float, drift: float, only: str = "") -> Recording:
    """SUs (or one) with a clock that is late in the middle of the log and too fast."""
    middle = (recording.joints[0].time[0] + recording.joints[0].time[-1]) / 2

    def on_its_clock(su: SuStream) -> SuStream:
        if only not in ("", su.name):
            return su
        return replace(su, time=su.time + latency + drift * (su.time - middle))

    return changed_sus(recording, on_its_clock)


def moving(recording: Recording) -> set[str]:
    """SUs that the base does not carry."""
    carried = {su.name for su in simulation("ur5").truth.sus if su.joint >= 0}
    return carried & {su.name for su in recording.sus}


def test_a_sound_log_has_no_clocks_to_set() -> None:
    recording = simulation("ur5").recording
    assert su_clocks(recording.sus, joint_motion(recording)) == ()


def test_where_little_is_felt_is_no_better_lag() -> None:
    simulated = simulation("ur5")
    joint = {su.name: su.joint for su in simulated.truth.sus}
    shaken = next(su for su in simulated.recording.sus if joint[su.name] == 1)
    noise = 1 + 2.0 * np.random.default_rng(1).standard_normal((len(shaken.time), 1))

    def shakes_as_well(su: SuStream) -> SuStream:
        """The base, while the robot moves, in a way that its motion explains in part."""
        if joint[su.name] >= 0:
            return su
        felt = shaken.specific_force - np.median(shaken.specific_force, axis=0)
        felt = 0.2 * noise * felt
        more = np.stack([np.interp(su.time, shaken.time, f) for f in felt.T], axis=1)
        return replace(su, specific_force=su.specific_force + more)

    recording = changed_sus(simulated.recording, shakes_as_well)
    assert su_clocks(recording.sus, joint_motion(recording)) == ()


@pytest.mark.parametrize(
    ("latency", "drift"),
    [(0.08, 0.0), (0.17, 0.0), (2.0, 0.0), (-0.5, 1e-4), (0.0, 1e-3), (0.3, 3.3e-3), (1.0, -9e-3)],
)
def test_offset_and_drift_are_found_together(latency: float, drift: float) -> None:
    recording = retimed(simulation("ur5").recording, latency, drift)
    clocks = {clock.su: clock for clock in su_clocks(recording.sus, joint_motion(recording))}
    # The SU on the base feels nothing, and runs on the clock that all others share.
    assert set(clocks) == {su.name for su in recording.sus}
    for su in moving(recording):
        assert not clocks[su].shared
        assert clocks[su].latency == pytest.approx(latency, abs=1e-3)
        assert clocks[su].drift == pytest.approx(drift, abs=2e-5)
        assert clocks[su].latency_sd < 1e-3
        assert clocks[su].drift_sd < 2e-5
    assert {su for su, clock in clocks.items() if clock.shared} == set(clocks) - moving(recording)


def test_one_clock_of_many_is_set_alone() -> None:
    plain = simulation("ur5").recording
    odd = sorted(moving(plain))[2]
    recording = retimed(plain, 0.4, 5e-4, only=odd)
    (clock,) = su_clocks(recording.sus, joint_motion(recording))
    assert clock.su == odd
    assert clock.latency == pytest.approx(0.4, abs=1e-3)


def test_readings_come_to_the_joints_time() -> None:
    plain = simulation("ur5").recording
    late = sampled_of(retimed(plain, 0.17, 3.3e-3))
    there = sampled_of(plain)
    both = late.valid & there.valid
    for u, su in enumerate(plain.sus):
        apart = (late.readings - there.readings)[both[:, u], u]
        assert np.sqrt(np.mean(apart**2)) < 0.03, su.name
    assert {clock.su for clock in late.clocks} == {su.name for su in plain.sus}
    assert not there.clocks


def test_lost_samples_and_spikes_do_not_disturb_the_clock() -> None:
    rng = np.random.default_rng(0)

    def torn(su: SuStream) -> SuStream:
        kept = rng.random(len(su.time)) > 0.02
        kept[4000:4600] = False
        values = su.specific_force + 20.0 * (rng.random((len(su.time), 1)) < 1e-3)
        return replace(su, time=su.time[kept], specific_force=values[kept])

    recording = changed_sus(retimed(simulation("ur5").recording, 0.3, 1e-3), torn)
    clocks = su_clocks(recording.sus, joint_motion(recording))
    assert moving(recording) <= {clock.su for clock in clocks}
    for clock in clocks:
        assert clock.latency == pytest.approx(0.3, abs=2e-3)
        assert clock.drift == pytest.approx(1e-3, abs=2e-5)


def test_the_two_ways_between_clocks_are_inverse() -> None:
    clock = SuClock("su", 0.3, 1e-4, -2e-3, 1e-6, 40.0)
    time = np.linspace(0.0, 80.0, 9)
    np.testing.assert_allclose(clock.undone(clock.stamped(time)), time, atol=1e-12)
    np.testing.assert_allclose(clock.stamped(time) - time, 0.3 - 2e-3 * (time - 40.0))


def test_sus_on_one_clock_are_told_together() -> None:
    one = SuClock("su_a", 0.17, 1e-4, 3e-4, 1e-6, 40.0)
    notes = clock_notes([[one, replace(one, su="su_b"), replace(one, su="su_c", latency=0.9)]])
    assert len(notes) == 2
    assert "su_a" in notes[0]
    assert "su_b" in notes[0]
    assert "170" in notes[0]
    assert "300" in notes[0]
    assert "su_c" in notes[1]


@pytest.mark.parametrize(("latency", "drift"), [(0.0, 0.0), (0.17, 3.3e-3), (-1.5, -9e-3)])
def test_moves_of_all_joints_show_the_clock(latency: float, drift: float) -> None:
    """No stretch is linear there; how much is moved when tells the time all the same."""
    sim = simulation("panda", excite="none", minutes=1.5, seed=7)
    recording = retimed(sim.recording, latency, drift)
    clocks = su_clocks(recording.sus, joint_motion(recording))
    if not latency:
        assert not clocks
        return
    assert {clock.su for clock in clocks} == {su.name for su in recording.sus}
    for clock in clocks:
        assert clock.latency == pytest.approx(latency, abs=4e-3)
        assert clock.drift == pytest.approx(drift, abs=2e-4)
        assert abs(clock.latency - latency) < 4 * clock.latency_sd


def about_the_vertical(path: JointPath, joint: int, seed: int) -> SuStream:
    """Readings 0.1 m from a vertical axis: gravity is constant, the lever arm is all they tell."""
    time = np.arange(0.0, path.time[-1], 5e-3)
    qd = np.gradient(path.position[:, joint], path.time)
    qdd = np.interp(time, path.time, np.gradient(qd, path.time))
    felt = np.outer(0.1 * qdd, (0.6, 0.8, 0.0)) + np.array([0.0, 0.0, 9.81])
    noise = 0.02 * np.random.default_rng(seed).standard_normal(felt.shape)
    return SuStream("su", time, felt + noise)


@pytest.mark.parametrize("wait", [0.8, 1.0, 1.3])
def test_patterns_of_one_joint_are_not_those_of_the_next(wait: float) -> None:
    """Later by 2 s, other joints' patterns explain them nearly as well, in more stretches."""
    seed = round(10 * wait)
    path = JointPath(np.zeros(6)).rest(2.0)
    for out in 0.1 * np.eye(6)[5] + 0.8 * np.eye(6) * (np.arange(6) < 5):
        path.move(out, 0.8).rest(0.6).move(np.zeros(6), 0.8).rest(0.4)
    path.rest(wait)
    for pose in np.random.default_rng(seed).uniform(-1.5, 1.5, (3, 6)):
        path.move((*pose[:5], 0.05 * pose[5]), 1.4 + wait).rest(1.5)
        for joint in range(6):
            path.abrupt(joint, 0.07, seconds=1.984, hertz=1 / 0.496)
        path.rest(0.5)
    su = about_the_vertical(path, 5, seed)
    clocks = su_clocks([su], joint_motion(path.recording(100.0, [su])))
    assert all(abs(clock.latency) < 5e-3 for clock in clocks)


@pytest.mark.parametrize("seed", [8, 9])
def test_who_feels_the_first_patterns_of_each_pose_is_not_one_pattern_late(seed: int) -> None:
    """Most stretches are quieter later by 2 s, and every rest is louder."""
    settings = SimulationSettings(seed=seed, n_poses=8)
    recording = simulate(load_robot("z1"), settings).recording
    assert su_clocks(recording.sus, joint_motion(recording)) == ()


def test_a_rest_confirms_no_clock() -> None:
    """Two moves show a line of two numbers, however long the robot rests after them."""
    two = JointPath(np.zeros(2)).rest(2.0).move((0.7, 0.3), 3.0).rest(2.0).move((0.0, 0.0), 3.0)
    assert np.isinf(widening_by_few_moves(two.rest(60.0).motion()))
    for goal in np.random.default_rng(0).uniform(-1.0, 1.0, (20, 2)):
        two.move(goal, 3.0)
    assert 1.0 < widening_by_few_moves(two.motion()) < 3.0


@pytest.mark.parametrize(("late", "told"), [(8e-3, False), (60e-3, True)])
def test_slow_swings_that_are_alike_confirm_each_other_by_little(late: float, told: bool) -> None:
    """A link that hangs back behind its encoder by milliseconds does so in every one of them."""
    path = JointPath(np.zeros(2)).rest(2.0)
    for _ in range(30):
        path.swing({0: 0.2}, 6.0, 0.35).rest(1.0).swing({1: 0.1}).rest(1.0)
    time = np.arange(0.0, path.time[-1], 5e-3)
    q = path.at(time - late)[:, 0]
    felt = 9.81 * np.stack([np.sin(q), np.cos(q), 0 * q], axis=1)
    noise = 0.02 * np.random.default_rng(30).standard_normal(felt.shape)
    su = SuStream("su", time, felt + noise)
    clocks = su_clocks([su], joint_motion(path.recording(100.0, [su])))
    assert [abs(clock.latency - late) < 2e-3 for clock in clocks] == [True] * told


def test_a_clock_that_hardly_shows_makes_no_others_alike() -> None:
    """It may be either of two that differ for certain."""
    vague = SuClock("su_v", 0.018, 2e-3, 0.0, 3e-5, 40.0)
    one = SuClock("su_a", 0.0173, 3e-5, 0.0, 1e-6, 40.0)
    other = replace(one, su="su_b", latency=0.0226)
    groups = [
        {su for su in ("su_v", "su_a", "su_b") if su in x}
        for x in clock_notes([[vague, one, other]])
    ]
    assert {"su_b"} in groups
    assert {"su_v", "su_a"} in groups
