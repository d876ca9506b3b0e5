"""What gives way under load: held against statics, frequencies and energies worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from random_robots import chain, robot_of

from skin2urdf.arrays import F64
from skin2urdf.recording.reading import read
from skin2urdf.recording.writing import write
from skin2urdf.simulation import Simulation, SimulationSettings, load_robot, simulate
from skin2urdf.simulation.defects import (
    Backlash,
    Defect,
    ElasticGears,
    GearHarmonics,
    LinkFlex,
    YieldingBase,
)
from skin2urdf.simulation.defects.flexible import with_hinges
from skin2urdf.simulation.defects.records import Flexibility
from skin2urdf.simulation.defects.two_masses import Springs, Swing, swing
from skin2urdf.simulation.mechanism import load_mechanism
from skin2urdf.simulation.pattern import smooth_step
from skin2urdf.simulation.trajectory import JointMotion

MASS, LEVER, G = 3.0, 0.4, 9.81


def pendulums(n: int = 1) -> pin.Model:
    """Points of 3 kg on arms of 0.4 m, one hanging on the other, axes horizontal."""
    model = pin.Model()
    parent, placement = 0, pin.SE3.Identity()
    for i in range(n):
        parent = model.addJoint(parent, pin.JointModelRY(), placement, f"joint{i}")
        arm = np.array([LEVER, 0.0, 0.0])
        model.appendBodyToJoint(
            parent, pin.Inertia(MASS, arm, np.zeros((3, 3))), pin.SE3.Identity()
        )
        placement = pin.SE3(np.eye(3), arm)
    return model


def held_at(position: F64, seconds: float) -> JointMotion:
    time = np.arange(int(seconds / 4e-3) + 1) * 4e-3
    return JointMotion(time, np.tile(position, (time.size, 1)))


def stepped(n: int, size: float, seconds: float, rise: float = 0.05) -> JointMotion:
    """A smooth step of all drives."""
    time = np.arange(int(seconds / 4e-3) + 1) * 4e-3
    return JointMotion(time, size * smooth_step(time / rise)[:, None] * np.ones(n))


def springs(n: int, stiffness: float, damping: float = 0.0, play: float = 0.0) -> Springs:
    return Springs(np.full(n, stiffness), np.full(n, damping), np.full(n, play))


def energy(model: pin.Model, spring: Springs, drive: JointMotion, swung: Swing) -> F64:
    """(K,) kinetic, potential and elastic energy [J]."""
    data = model.createData()
    u, _, _ = drive.at(swung.motion.time)
    stored = 0.5 * spring.stiffness * (u - swung.motion.position) ** 2
    moving = [
        pin.computeKineticEnergy(model, data, x, v) + pin.computePotentialEnergy(model, data, x)
        for x, v in zip(swung.motion.position, swung.velocity, strict=True)
    ]
    return np.asarray(np.array(moving) + stored.sum(axis=1))


def test_a_resting_link_twists_its_gear_by_torque_over_stiffness() -> None:
    drive = held_at(np.array([0.3]), 0.2)
    swung = swing(pendulums(), springs(1, 2000.0, 1.0), drive)
    x = swung.motion.position
    # Gravity pulls the arm to larger angles about y.
    torque = -MASS * G * LEVER * np.cos(x)
    np.testing.assert_allclose(2000.0 * (0.3 - x), torque, atol=1e-6)
    np.testing.assert_allclose(swung.torque, torque, atol=1e-6)
    assert np.ptp(x) < 1e-10


def test_a_link_swings_at_the_frequency_of_its_spring() -> None:
    model = pendulums()
    model.gravity = pin.Motion.Zero()
    k = 1500.0
    swung = swing(model, springs(1, k), stepped(1, 1e-2, 2.0, 0.03))
    time = swung.motion.time
    free = swung.motion.position[time > 0.1, 0] - 1e-2
    crossings = np.flatnonzero(np.diff(np.sign(free)))
    frequency = (len(crossings) - 1) / 2 / (time[crossings[-1]] - time[crossings[0]])
    assert frequency == pytest.approx((k / (MASS * LEVER**2)) ** 0.5 / (2 * pi), rel=0.01)


def test_damping_lets_the_swing_die_as_it_should() -> None:
    model = pendulums()
    model.gravity = pin.Motion.Zero()
    k, inertia, ratio = 1500.0, MASS * LEVER**2, 0.05
    damped = springs(1, k, 2 * ratio * (k * inertia) ** 0.5)
    swung = swing(model, damped, stepped(1, 1e-2, 1.0, 0.03))
    time, off = swung.motion.time, np.abs(swung.motion.position[:, 0] - 1e-2)
    early, late = (off[(time > t) & (time < t + 0.2)].max() for t in (0.1, 0.5))
    decay = np.exp(-ratio * (k / inertia) ** 0.5 * 0.4)
    assert late / early == pytest.approx(decay, rel=0.25)


def test_energy_stays_without_dampers_and_grows_by_the_drives_work() -> None:
    model = pendulums(3)
    drive = stepped(3, 0.4, 1.5, 0.6)
    spring = springs(3, 800.0)
    swung = swing(model, spring, drive, 1e-3)
    stored = energy(model, spring, drive, swung)
    u, u_dot, _ = drive.at(swung.motion.time)
    power = (spring.stiffness * (u - swung.motion.position) * u_dot).sum(axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1])) * 1e-3])
    gained = stored - stored[0]
    assert np.abs(gained).max() > 5.0
    np.testing.assert_allclose(gained, work, atol=2e-3 * np.abs(gained).max())


def test_angular_momentum_of_a_free_pair_is_kept() -> None:
    """Two rotors on one axis with a spring between: what one gains the other loses."""
    model = pin.Model()
    parent = 0
    for i, inertia in enumerate((0.5, 0.2)):
        parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3.Identity(), f"rotor{i}")
        body = pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    # The first rotor floats on a spring of next to nothing, the second is pushed by its drive.
    pair = Springs(np.array([1e-9, 300.0]), np.zeros(2), np.zeros(2))
    drive = stepped(2, 0.2, 1.0)
    swung = swing(model, pair, JointMotion(drive.time, drive.position * [0.0, 1.0]))
    v = swung.velocity
    momentum = 0.5 * v[:, 0] + 0.2 * (v[:, 0] + v[:, 1])
    assert np.abs(v).max() > 0.5
    assert np.abs(momentum).max() < 1e-6


def test_a_rigid_gear_follows_its_motor_exactly() -> None:
    drive = stepped(2, 0.5, 1.0, 0.8)
    mixed = Springs(np.array([np.inf, 900.0]), np.array([0.0, 1.0]), np.zeros(2))
    swung = swing(pendulums(2), mixed, drive)
    u, _, _ = drive.at(swung.motion.time)
    np.testing.assert_allclose(swung.motion.position[:, 0], u[:, 0], atol=1e-12)
    assert np.abs(swung.motion.position[:, 1] - u[:, 1]).max() > 1e-3


def test_play_lets_the_link_lie_on_the_side_of_its_load_and_fall_to_the_other() -> None:
    # From 0.3 rad above the vertical to as much below it on the other side.
    time = np.arange(501) * 4e-3
    up = -pi / 2
    angle = up - 0.3 + 0.6 * smooth_step((time - 0.3) / 1.0)
    width, k = 2e-3, 5e5
    loose = springs(1, k, 60.0, width)
    drive = JointMotion(time, angle[:, None])
    swung = swing(pendulums(), loose, drive)
    off = (swung.motion.position - drive.at(swung.motion.time)[0])[:, 0]
    load = MASS * G * LEVER * np.sin(0.3) / k
    assert off[0] == pytest.approx(-width / 2 - load, abs=1e-7)
    assert off[-1] == pytest.approx(width / 2 + load, abs=2e-6)


def recorded(defect: Defect) -> Simulation:
    settings = SimulationSettings(
        n_poses=1, structural=False, excite="all", seed=2, imu_rate=100.0, joint_rate=100.0,
        grade="ideal", jitter=0.0, stagger=False, encoder_bits=None, defects=(defect,),
    )  # fmt: skip
    return simulate(load_robot("ur5"), settings)


@pytest.fixture(scope="module")
def elastic() -> Simulation:
    return recorded(ElasticGears(near=9000.0, far=4000.0))


def rest_of(simulation: Simulation) -> float:
    """Late in the longest rest in a pose, on the motion's clock [s]."""
    rests = [p for p in simulation.truth.phases if p.kind == "rest" and p.pose >= 0]
    longest = max(rests, key=lambda p: p.end - p.start)
    return longest.end - 0.02


def gravity_torque(q: F64) -> F64:
    """(D,) torque that holds the rigid robot against gravity [N m]."""
    spec = load_robot("ur5")
    model = load_mechanism(spec, spec.base_rpy).model
    return np.array(pin.computeGeneralizedGravity(model, model.createData(), q))


def test_elastic_gears_twist_by_the_weight_that_they_carry(elastic: Simulation) -> None:
    at = np.array([rest_of(elastic)])
    link = elastic.truth.motion.at(at)[0][0]
    motor = elastic.moved.motor.at(at)[0][0]
    k = np.array([9000.0] * 3 + [4000.0] * 3)
    expected = gravity_torque(link) / k
    np.testing.assert_allclose(motor - link, expected, atol=2e-5)
    assert np.abs(motor - link).max() > 1e-3


def test_the_log_of_elastic_gears_holds_the_motors_positions(elastic: Simulation) -> None:
    for d, name in enumerate(elastic.truth.joint_names):
        stream = next(j for j in elastic.recording.joints if j.name == name)
        seen = elastic.moved.motor.at(stream.time + elastic.truth.start)[0][:, d]
        np.testing.assert_allclose(stream.position, seen, atol=1e-9)


def test_gears_tell_the_torque_that_they_carry(elastic: Simulation) -> None:
    moved = elastic.moved
    k = np.array([9000.0] * 3 + [4000.0] * 3)
    motor, _, _ = moved.motor.at(moved.motion.time)
    twist = motor - moved.motion.position
    n = int(np.searchsorted(moved.motion.time, rest_of(elastic)))
    torque = moved.torque(moved.motion.time[n : n + 1])[0]
    np.testing.assert_allclose(torque, k * twist[n], atol=0.1)
    weight = gravity_torque(moved.motion.position[n])
    np.testing.assert_allclose(torque, weight, atol=0.3)


def test_a_base_tilts_by_the_moment_of_the_weight() -> None:
    simulation = recorded(YieldingBase(stiffness=20_000.0, depth=0.2))
    at = np.array([rest_of(simulation)])
    moved = simulation.moved
    tilt = np.delete(moved.motion.at(at)[0][0], moved.rows)
    q = simulation.truth.motion.at(at)[0][0]
    spec = load_robot("ur5")
    model = load_mechanism(spec, spec.base_rpy).model
    data = model.createData()
    pin.centerOfMass(model, data, q)
    mass = pin.computeTotalMass(model)
    g = np.array(model.gravity.linear)
    foot = model.inertias[0]
    assert foot.mass > 1.0
    depth = np.array([0.0, 0.0, 0.2])
    moment = np.cross(data.com[0] + depth, mass * g)
    moment += np.cross(foot.lever + depth, foot.mass * g)
    np.testing.assert_allclose(tilt, moment[:2] / 20_000.0, rtol=0.05, atol=2e-5)
    # The SU on the base feels it.
    base = next(su for su in simulation.truth.sus if su.joint < 0)
    felt = next(s for s in simulation.recording.sus if s.name == base.name).specific_force
    assert np.ptp(felt, axis=0).max() > 1e-3 * 9.81


def test_links_bend_by_the_moment_beyond_their_middle() -> None:
    simulation = recorded(LinkFlex(stiffness=20_000.0))
    moved = simulation.moved
    names = moved.mechanism.joint_names
    assert len(names) > 6
    at = np.array([rest_of(simulation)])
    x = moved.motion.at(at)[0][0]
    model = moved.mechanism.model
    load = pin.computeGeneralizedGravity(model, model.createData(), x)
    bent = np.setdiff1d(np.arange(len(names)), moved.rows)
    np.testing.assert_allclose(x[bent], -load[bent] / 20_000.0, atol=2e-5)
    assert np.abs(x[bent]).max() > 2e-4


def test_straight_hinges_leave_the_robot_as_it_is() -> None:
    spec = load_robot("panda")
    mechanism = load_mechanism(spec, spec.base_rpy)
    rng = np.random.default_rng(0)
    flexibility = Flexibility.none(7)
    for defect in (LinkFlex(), YieldingBase()):
        flexibility = defect.loosen(flexibility, mechanism, rng)
    hinges = sorted(flexibility.hinges, key=lambda hinge: hinge.joint)
    bending, rows = with_hinges(mechanism, hinges)
    q, v, a = rng.uniform(-1.0, 1.0, (3, 7))
    full = np.zeros((3, bending.n_joints))
    full[:, rows] = q, v, a
    data = bending.model.createData()
    torque = pin.rnea(bending.model, data, *full)[rows]
    rigid = pin.rnea(mechanism.model, mechanism.model.createData(), q, v, a)
    np.testing.assert_allclose(torque, rigid, atol=1e-9)
    assert tuple(bending.joint_names[r] for r in rows) == mechanism.joint_names


def test_ripples_of_gears_are_functions_of_their_positions() -> None:
    simulation = recorded(GearHarmonics(once=1e-3, twice=5e-4, between=3e-4, stage=7.4))
    moved = simulation.moved
    time = moved.motion.time
    motor = moved.motor.at(time)[0]
    ahead = moved.motion.position - motor
    for d in range(6):
        angles = np.outer(motor[:, d], [1.0, 2.0, 7.4])
        waves = np.hstack([np.sin(angles), np.cos(angles)])
        fit, *_ = np.linalg.lstsq(waves, ahead[:, d], rcond=None)
        np.testing.assert_allclose(waves @ fit, ahead[:, d], atol=1e-9)
        # A joint that turns little tells no sine from its neighbour; one that turns far does.
        if np.ptp(motor[:, d]) > 1.5:
            np.testing.assert_allclose(np.hypot(fit[:3], fit[3:]), [1e-3, 5e-4, 3e-4], rtol=1e-3)


def test_backlash_is_half_a_gap_where_the_load_is_clear() -> None:
    simulation = recorded(Backlash(1e-3))
    at = np.array([rest_of(simulation)])
    link = simulation.truth.motion.at(at)[0][0]
    off = simulation.moved.motor.at(at)[0][0] - link
    load = gravity_torque(link)
    clear = np.abs(load) > 1.0
    assert clear.sum() >= 2
    expected = 0.5e-3 * np.sign(load[clear]) + load[clear] / 1e6
    np.testing.assert_allclose(off[clear], expected, atol=2e-5)


def test_efforts_are_what_holds_the_links(tmp_path: Path) -> None:
    settings = SimulationSettings(
        excite="none", minutes=0.05, imu_rate=50.0, joint_rate=50.0, seed=2, torque_noise=0.0
    )
    simulation = simulate(load_robot("ur5"), settings)
    plain = simulate(load_robot("ur5"), replace(settings, torque_noise=None)).recording
    assert all(joint.effort is None for joint in plain.joints)
    by_name = {joint.name: joint for joint in simulation.recording.joints}
    first = simulation.truth.motion.at(np.array([simulation.truth.start]))[0][0]
    efforts = [by_name[name].effort for name in simulation.truth.joint_names]
    started = np.array([effort[0] for effort in efforts if effort is not None])
    np.testing.assert_allclose(started, gravity_torque(first), atol=0.05)
    # A file with efforts is read as one without: positions stay where they are.
    write(simulation.recording, tmp_path / "log.mcap")
    back = read(tmp_path / "log.mcap")
    assert [joint.name for joint in back.joints] == sorted(by_name)
    for joint in back.joints:
        np.testing.assert_array_equal(joint.position, by_name[joint.name].position)


def test_a_base_gives_way_under_a_single_joint(tmp_path: Path) -> None:
    settings = SimulationSettings(excite="none", minutes=0.05, defects=(YieldingBase(),))
    moved = simulate(robot_of(chain(1), tmp_path), settings).moved
    assert moved.mechanism.n_joints == 3
    np.testing.assert_array_equal(moved.rows, [2])
