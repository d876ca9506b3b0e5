from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skin2urdf.errors import UsageError
from skin2urdf.simulation import Simulation, SimulationSettings, load_robot, robot_names, simulate
from skin2urdf.simulation.settings import Excitation

SHORT = SimulationSettings(n_poses=1, imu_rate=50.0, joint_rate=25.0)


@pytest.mark.parametrize("excite", ["one", "all"])
@pytest.mark.parametrize("name", robot_names())
def test_every_robot_can_be_recorded(name: str, excite: Excitation) -> None:
    simulation = simulate(load_robot(name), replace(SHORT, excite=excite, grade="bma150"))
    recording, truth = simulation.recording, simulation.truth
    assert [j.name for j in recording.joints] == sorted(truth.joint_names)
    assert len(recording.sus) == len(truth.sus) >= 2
    for stream in recording.sus:
        assert np.isfinite(stream.specific_force).all()
        assert (np.diff(stream.time) > 0).all()
        # A pattern that drives sensors into saturation would spoil the recording.
        assert np.abs(stream.specific_force).max() < 2 * 9.81
    for joint in recording.joints:
        assert np.isfinite(joint.position).all()


@pytest.mark.parametrize("name", ["panda", "ur5", "g1"])
def test_every_robot_can_be_recorded_without_patterns(name: str) -> None:
    settings = replace(SHORT, excite="none", minutes=0.25)
    recording = simulate(load_robot(name), settings).recording
    assert 15.0 < recording.duration < 24.0
    for stream in recording.sus:
        # Arms that hurry in all joints at once stay within what a sensor of 4 g takes.
        assert np.abs(stream.specific_force).max() < 4 * 9.81


def test_minutes_are_for_motion_without_patterns() -> None:
    assert SimulationSettings(excite="none").duration == 180.0
    with pytest.raises(UsageError, match="minutes"):
        SimulationSettings(excite="one", minutes=2.0)


def test_a_bare_urdf_can_be_recorded(gantry: Path) -> None:
    simulation = simulate(load_robot(gantry), replace(SHORT, grade="ideal"))
    truth = simulation.truth
    assert len(simulation.recording.sus) == 4
    moved = {joint.name: np.ptp(joint.position) for joint in simulation.recording.joints}
    assert moved["swing"] > 0.5
    assert moved["slide"] > 0.05
    assert moved["grip_left"] > 0.005
    for su, stream in zip(truth.sus, simulation.recording.sus, strict=True):
        spread = np.ptp(stream.specific_force, axis=0).max()
        assert spread > 1.0 if su.joint >= 0 else spread < 1e-12


def test_the_same_seed_gives_the_same_recording() -> None:
    first, again, other = (
        simulate(load_robot("so101"), replace(SHORT, seed=seed)) for seed in (1, 1, 2)
    )
    assert first.truth.urdf == again.truth.urdf != other.truth.urdf
    assert first.joint_order == again.joint_order
    for a, b in zip(first.recording.sus, again.recording.sus, strict=True):
        assert (a.name, a.topic) == (b.name, b.topic)
        np.testing.assert_array_equal(a.time, b.time)
        np.testing.assert_array_equal(a.specific_force, b.specific_force)
    for a, b in zip(first.recording.joints, again.recording.joints, strict=True):
        np.testing.assert_array_equal(a.position, b.position)


def test_sensors_do_not_change_the_motion() -> None:
    robot = load_robot("so101")
    cheap, perfect = (simulate(robot, replace(SHORT, grade=g)) for g in ("bma150", "ideal"))
    assert cheap.truth.urdf == perfect.truth.urdf
    np.testing.assert_array_equal(cheap.truth.motion.position, perfect.truth.motion.position)
    np.testing.assert_array_equal(perfect.truth.bias, 0.0)
    assert np.abs(cheap.truth.bias).max() > 0.1


def test_names_and_order_give_nothing_away() -> None:
    robot = load_robot("panda")
    orders, places = set(), set()
    for seed in range(4):
        simulation = simulate(robot, replace(SHORT, imu_rate=20.0, seed=seed))
        names = [su.name for su in simulation.recording.sus]
        assert names == sorted(names)
        assert all(re.fullmatch(r"su_[0-9a-f]{4}", name) for name in names)
        assert all(su.topic == f"/skin/{su.name}/imu" for su in simulation.recording.sus)
        places.add(tuple(su.joint for su in simulation.truth.sus))
        orders.add(simulation.joint_order)
        assert Counter(simulation.joint_order) == Counter(simulation.truth.joint_names)
    assert len(places) == 4
    assert len(orders) == 4


def test_the_clock_starts_with_the_first_sample(panda_one: Simulation) -> None:
    recording = panda_one.recording
    streams = [s.time for s in recording.joints] + [s.time for s in recording.sus]
    assert min(time[0] for time in streams) == 0.0
    assert recording.duration == pytest.approx(panda_one.truth.motion.time[-1], abs=0.01)
    assert len({id(joint.time) for joint in recording.joints}) == 1


def test_rates(panda_one: Simulation) -> None:
    for su in panda_one.recording.sus:
        assert np.median(np.diff(su.time)) == pytest.approx(1 / 500, rel=0.01)
    time = panda_one.recording.joints[0].time
    assert np.median(np.diff(time)) == pytest.approx(1 / 250, rel=0.01)


def test_encoders_report_what_moved(panda_one: Simulation) -> None:
    truth = panda_one.truth
    time = panda_one.recording.joints[0].time + truth.start
    position, velocity, _ = truth.motion.at(time)
    for joint in panda_one.recording.joints:
        d = truth.joint_names.index(joint.name)
        count = 2 * np.pi / 2**17
        # Half a count of rounding, and what the joint moves during the stamp's jitter.
        allowed = 0.5 * count + 6e-4 * np.abs(velocity[:, d]) + 1e-7
        assert (np.abs(joint.position - position[:, d]) <= allowed).all()
        np.testing.assert_allclose(
            joint.position / count, np.round(joint.position / count), atol=1e-6
        )


def test_clock_lag_is_in_the_stamps() -> None:
    robot = load_robot("so101")
    base = replace(SHORT, jitter=0.0, grade="ideal", stagger=False)
    late = simulate(robot, replace(base, lag=0.02))
    prompt = simulate(robot, base)
    assert (late.truth.lag >= 0).all()
    assert (late.truth.lag <= 0.02).all()
    assert np.ptp(late.truth.lag) > 0.002
    for lag, a, b in zip(late.truth.lag, late.recording.sus, prompt.recording.sus, strict=True):
        np.testing.assert_allclose(a.time - b.time, lag, atol=1e-9)
        np.testing.assert_array_equal(a.specific_force, b.specific_force)


def test_bias_and_sensor_matrix_are_the_truth() -> None:
    robot = load_robot("so101")
    cheap, perfect = (
        simulate(robot, replace(SHORT, jitter=0.0, grade=grade)) for grade in ("bma150", "ideal")
    )
    for u, (a, b) in enumerate(zip(cheap.recording.sus, perfect.recording.sus, strict=True)):
        expected = b.specific_force @ cheap.truth.sensor_matrix[u].T + cheap.truth.bias[u]
        residual = a.specific_force - expected
        assert np.abs(residual.mean(axis=0)).max() < 5 * 0.08 / np.sqrt(len(residual))
        assert residual.std() == pytest.approx(8e-3 * 9.81, rel=0.05)


def test_numbers_of_sus_can_be_chosen() -> None:
    settings = replace(SHORT, imu_rate=20.0, sus_per_segment=3, sus_on_base=2)
    truth = simulate(load_robot("so101"), settings).truth
    assert Counter(su.joint for su in truth.sus) == {-1: 2, 0: 3, 1: 3, 2: 3, 3: 3, 4: 3}


def test_records_are_read_only(panda_one: Simulation) -> None:
    for array in (
        panda_one.truth.poses,
        panda_one.truth.motion.position,
        panda_one.recording.sus[0].specific_force,
        panda_one.truth.sus[0].T_link_su,
    ):
        with pytest.raises(ValueError):
            array[0] = 0.0
