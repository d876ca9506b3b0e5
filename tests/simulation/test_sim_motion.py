from __future__ import annotations

from math import pi
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skin2urdf.arrays import F64
from skin2urdf.errors import UsageError
from skin2urdf.simulation import MotionSettings, Simulation, load_robot
from skin2urdf.simulation.mechanism import Mechanism, load_mechanism
from skin2urdf.simulation.motion import Reference, plan_moves, plan_reference, plan_series
from skin2urdf.simulation.pattern import (
    PEAK_SPEED,
    distinct_time,
    smooth_rise,
    smooth_step,
    swing,
    tone_pairs,
    windowed_pattern,
)
from skin2urdf.simulation.plant import actual_motion
from skin2urdf.simulation.robots import example_robot_data
from skin2urdf.simulation.settings import PLANTS, Excitation, PlantSettings
from skin2urdf.simulation.trajectory import GRID, JointMotion


def planned(
    robot: str | Path, excite: Excitation = "one", n_poses: int = 3, seed: int = 0
) -> tuple[Mechanism, Reference]:
    mechanism = load_mechanism(load_robot(robot), (0.4, 0.2, 0.0))
    reach = np.full(mechanism.n_joints, 0.8)
    rng = np.random.default_rng(seed)
    return mechanism, plan_reference(mechanism, reach, MotionSettings(), n_poses, excite, rng)


def during(reference: Reference, kind: str) -> list[tuple[int, F64]]:
    """(joint, positions) of every phase of a kind."""
    time, position = reference.motion.time, reference.motion.position
    return [
        (phase.joint, position[(time >= phase.start - 1e-9) & (time <= phase.end + 1e-9)])
        for phase in reference.phases
        if phase.kind == kind
    ]


@given(
    tones=st.lists(st.tuples(st.floats(0.5, 5.0), st.floats(0.1, 15.0)), min_size=1, max_size=3),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_pattern_returns_and_stays_in_its_swing(
    tones: list[tuple[float, float]], sign: float
) -> None:
    time = np.linspace(0.0, 2.0, 501)
    offset = windowed_pattern(time, 2.0, 0.4, [(f, sign * a) for f, a in tones])
    assert offset[0] == offset[-1] == 0.0
    assert (sign * offset >= 0.0).all()
    assert np.abs(offset).max() <= swing(tones) * (1 + 1e-12)


def test_pattern_is_the_papers_inside_the_window() -> None:
    f, A = 2.0, 0.5
    time = np.linspace(0.4, 1.6, 100)
    expected = A / (2 * pi * f) * (1 - np.cos(2 * pi * f * time))
    offset = windowed_pattern(time, 2.0, 0.4, [(f, 2 * pi * f * A)])
    np.testing.assert_allclose(offset, expected, atol=1e-15)


@given(st.floats(0.0, 1.0))
def test_smooth_step_is_odd_about_its_middle(x: float) -> None:
    ends = smooth_step(np.array([x, 1.0 - x]))
    assert ends.sum() == pytest.approx(1.0)


@settings(max_examples=20)
@given(n=st.integers(1, 12), seed=st.integers(0, 1000))
def test_tone_pairs_differ(n: int, seed: int) -> None:
    pairs = tone_pairs(n, (1.0, 4.0), np.random.default_rng(seed))
    assert pairs.shape == (n, 2)
    assert len(np.unique(pairs)) == 2 * n
    assert pairs[:, 0].max() < pairs[:, 1].min()


@pytest.mark.parametrize("n", [20, 30, 45])
def test_tones_are_told_apart_in_the_time_that_they_get(n: int) -> None:
    def typical_variance(duration: float) -> float:
        """What the other DoFs' motion makes of the variance of a coefficient."""
        time = np.arange(0.0, duration, 0.02)
        pairs = tone_pairs(n, (1.0, 4.0), np.random.default_rng(0))
        X = np.array([windowed_pattern(time, duration, 0.4, [(f, 1.0)]) for f in pairs.ravel()])
        X = np.concatenate([np.ones((1, len(time))), X])
        X /= np.linalg.norm(X, axis=1, keepdims=True)
        return float(np.median(np.diag(np.linalg.pinv(X @ X.T, rcond=1e-14, hermitian=True))))

    enough = distinct_time(n, (1.0, 4.0))
    assert typical_variance(0.4 + enough) < 2 * typical_variance(0.4 + 3 * enough)
    assert typical_variance(0.4 + 0.6 * enough) > 100 * typical_variance(0.4 + enough)


def test_many_dofs_at_once_take_longer(gantry: Path) -> None:
    def seconds(robot: str | Path) -> float:
        pattern = next(p for p in planned(robot, "all")[1].phases if p.kind == "pattern")
        return pattern.end - pattern.start

    assert seconds(gantry) == pytest.approx(12.0)
    assert seconds("panda") == pytest.approx(12.0)
    humanoid = example_robot_data() / "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf"
    assert seconds(humanoid) == pytest.approx(0.4 + 1.2 * 0.5 * 85 / 3.0, abs=2 * GRID)


def test_structural_moves_are_large_and_of_one_dof() -> None:
    _, reference = planned("panda")
    moves = during(reference, "structural")
    assert [joint for joint, _ in moves] == [d for d in range(7) for _ in range(2)]
    for joint, position in moves:
        span = np.ptp(position, axis=0)
        assert 0.55 < span[joint] <= 1.0
        assert np.delete(span, joint).max() < 1e-12
    for (_, there), (_, back) in zip(moves[::2], moves[1::2], strict=True):
        np.testing.assert_allclose(there[0], back[-1], atol=1e-12)


def test_structural_moves_of_a_prismatic_joint(gantry: Path) -> None:
    _, reference = planned(gantry)
    for joint, position in during(reference, "structural"):
        if joint == 0:
            assert 0.1 < np.ptp(position[:, 0]) < 0.4


def test_one_excites_one_after_the_other() -> None:
    _, reference = planned("panda", "one")
    patterns = during(reference, "pattern")
    assert [joint for joint, _ in patterns] == list(range(7)) * 3
    for joint, position in patterns:
        span = np.ptp(position, axis=0)
        assert 0.05 < span[joint] < 0.2
        assert np.delete(span, joint).max() < 1e-12
        assert len(position) * GRID == pytest.approx(2.0, abs=2 * GRID)


def test_all_excites_all_with_independent_motions() -> None:
    _, reference = planned("panda", "all")
    patterns = during(reference, "pattern")
    assert len(patterns) == 3
    for joint, position in patterns:
        assert joint == -1
        offsets = position - position[0]
        accelerations = np.diff(offsets, 2, axis=0) / GRID**2
        regressors = np.column_stack(
            [np.ones(len(accelerations)), offsets[1:-1], accelerations / (4 * pi) ** 2]
        )
        regressors /= np.linalg.norm(regressors, axis=0)
        assert np.linalg.cond(regressors) < 100


def test_rests_rest() -> None:
    _, reference = planned("panda")
    rests = during(reference, "rest")
    assert len(rests) == 1 + 14 + 6
    for _, position in rests:
        assert np.ptp(position, axis=0).max() < 1e-12


def test_poses_are_where_it_rests() -> None:
    _, reference = planned("ur5", n_poses=4)
    for phase in reference.phases:
        if phase.kind == "rest" and phase.pose >= 0:
            q = reference.motion.at(np.array([0.5 * (phase.start + phase.end)]))[0][0]
            np.testing.assert_allclose(q, reference.poses[phase.pose], atol=1e-9)
    assert {p.pose for p in reference.phases} == {-1, 0, 1, 2, 3}


@pytest.mark.parametrize("robot", ["panda", "kinova", "ur10", "z1"])
@pytest.mark.parametrize("excite", ["one", "all"])
def test_limits_are_respected(robot: str, excite: Excitation) -> None:
    mechanism, reference = planned(robot, excite, n_poses=12)
    rng = np.random.default_rng(1)
    for plant in ("servo", "soft"):
        motion = actual_motion(mechanism, reference.motion, PLANTS[plant], rng)
        assert (motion.position >= mechanism.lower).all()
        assert (motion.position <= mechanism.upper).all()
    assert np.abs(reference.poses - reference.poses.mean(axis=0)).max() > 0.5
    limits = np.array([mechanism.lower, mechanism.upper])
    middle = np.where(np.isfinite(limits), limits, 0.0).mean(axis=0)
    assert np.abs(reference.poses - middle).max() <= 2.62
    _, velocity, _ = reference.motion.at(reference.motion.time)
    assert (np.abs(velocity) <= mechanism.speed_limit).all()


def test_narrow_joints_keep_their_limits(gantry: Path) -> None:
    mechanism, reference = planned(gantry, "all", n_poses=12)
    motion = actual_motion(mechanism, reference.motion, PLANTS["servo"], np.random.default_rng(0))
    assert (motion.position >= mechanism.lower).all()
    assert (motion.position <= mechanism.upper).all()
    assert np.ptp(reference.poses[:, 2]) > 0.005


def test_a_recording_of_twelve_poses_lasts_about_four_minutes() -> None:
    _, reference = planned("panda", n_poses=12)
    assert 230 < reference.motion.time[-1] < 260


def test_window_must_fit() -> None:
    with pytest.raises(UsageError):
        MotionSettings(ramp=1.5)


def test_velocity_and_acceleration_belong_to_the_position() -> None:
    _, reference = planned("kinova", n_poses=1)
    h = 1e-4
    time = np.random.default_rng(0).uniform(h, reference.motion.time[-1] - h, 200)
    before, after = reference.motion.at(time - h), reference.motion.at(time + h)
    _, velocity, acceleration = reference.motion.at(time)
    np.testing.assert_allclose((after[0] - before[0]) / (2 * h), velocity, atol=1e-5)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), acceleration, atol=1e-3)


def test_a_plant_without_error_is_the_reference() -> None:
    mechanism, reference = planned("panda", n_poses=1)
    motion = actual_motion(mechanism, reference.motion, PLANTS["none"], np.random.default_rng(0))
    assert motion is reference.motion


def test_servo_lags_by_what_it_should() -> None:
    mechanism, _ = planned("panda", n_poses=1)
    time = np.arange(1000) * GRID
    ramp = 0.3 * np.maximum(time - 1.0, 0.0)[:, None] * np.ones(7)
    lagging = PlantSettings(lag=(0.02, 0.02), sag=0.0, coupling=0.0)
    actual = actual_motion(mechanism, JointMotion(time, ramp), lagging, np.random.default_rng(0))
    np.testing.assert_allclose(ramp[-1] - actual.position[-1], 0.3 * 0.02, rtol=1e-6)


def test_sag_and_coupling_are_as_large_as_set() -> None:
    mechanism, reference = planned("panda", n_poses=3)
    rng = np.random.default_rng(0)
    sag = PlantSettings(lag=(0.0, 0.0), sag=5e-3, coupling=0.0)
    error = actual_motion(mechanism, reference.motion, sag, rng).position
    largest = np.abs(error - reference.motion.position).max(axis=0)
    assert largest.max() <= 5e-3
    assert largest[1] > 2.4e-3
    # A joint that carries the arm sags at rest; it also does so while others move.
    coupled = PlantSettings(lag=(0.0, 0.0), sag=0.0, coupling=5e-3)
    error = actual_motion(mechanism, reference.motion, coupled, rng).position
    error = error - reference.motion.position
    assert np.abs(error).max() <= 5e-3
    phase = next(p for p in reference.phases if p.kind == "pattern" and p.joint == 1)
    time = reference.motion.time
    moving = (time > phase.start) & (time < phase.end)
    assert np.ptp(error[moving, 3]) > 1e-4
    phase = next(p for p in reference.phases if p.kind == "rest" and p.pose == 1)
    resting = (time > phase.start) & (time < phase.end)
    assert np.abs(error[resting]).max() < 1e-6


def test_rests_of_the_plant_settle(panda_one: Simulation) -> None:
    truth = panda_one.truth
    for phase in truth.phases:
        if phase.kind == "rest" and phase.pose >= 0:
            _, velocity, _ = truth.motion.at(np.linspace(phase.start + 0.4, phase.end, 20))
            assert np.abs(velocity).max() < 1e-6


def moved(
    robot: str | Path, seconds: float, structural: bool = False, **chosen: tuple[float, float]
) -> tuple[Mechanism, Reference]:
    mechanism = load_mechanism(load_robot(robot), (0.4, 0.2, 0.0))
    rng = np.random.default_rng(0)
    return mechanism, plan_moves(mechanism, MotionSettings(**chosen), seconds, rng, structural)


def test_a_series_never_rests_inside_the_limits() -> None:
    mechanism = load_mechanism(load_robot("panda"), (0.4, 0.2, 0.0))
    settings = MotionSettings()
    reference = plan_series(mechanism, settings, 40.0, np.random.default_rng(0))
    position, velocity, _ = reference.motion.at(np.linspace(0.0, 40.0, 4001))
    assert (position > mechanism.lower).all()
    assert (position < mechanism.upper).all()
    assert np.abs(velocity).max() < 1.01 * settings.angular_speed
    assert np.ptp(position, axis=0).min() > 0.5
    # At no moment do all joints stand still together.
    assert np.abs(velocity).max(axis=1).min() > 0.02


def test_ordinary_moves_go_from_pose_to_pose_with_all_dofs() -> None:
    _, reference = moved("panda", 60.0)
    assert {phase.kind for phase in reference.phases} == {"rest", "move"}
    assert 60.0 < reference.motion.time[-1] < 68.0
    moves = during(reference, "move")
    assert len(moves) == len(reference.poses) > 10
    for (_, position), pose in zip(moves, reference.poses, strict=True):
        np.testing.assert_allclose(position[-1], pose, atol=1e-12)
        assert np.ptp(position, axis=0).min() > 1e-3
    for phase in reference.phases:
        if phase.kind == "rest":
            assert phase.end - phase.start == pytest.approx(0.5)


def test_ordinary_moves_have_the_speed_and_acceleration_asked_for() -> None:
    chosen = {"ordinary_speed": (1.0, 1.0), "ordinary_acceleration": (2.0, 2.0)}
    _, reference = moved("panda", 60.0, **chosen)
    _, velocity, acceleration = reference.motion.at(reference.motion.time)
    time = reference.motion.time
    for phase in reference.phases:
        if phase.kind != "move":
            continue
        inside = (time >= phase.start) & (time <= phase.end)
        fastest = np.abs(velocity[inside]).max()
        # A way of more than 1.1 rad has room for the whole speed; every way for the acceleration.
        way = np.ptp(reference.motion.position[inside], axis=0).max()
        assert fastest == pytest.approx(min(1.0, (way * 2.0 / PEAK_SPEED) ** 0.5), rel=0.01)
        assert np.abs(acceleration[inside]).max() == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize("robot", ["panda", "kinova", "z1"])
def test_ordinary_moves_respect_the_limits(robot: str) -> None:
    mechanism, reference = moved(robot, 60.0)
    rng = np.random.default_rng(1)
    motion = actual_motion(mechanism, reference.motion, PLANTS["servo"], rng)
    assert (motion.position >= mechanism.lower).all()
    assert (motion.position <= mechanism.upper).all()
    assert (np.abs(motion.at(motion.time)[1]) <= mechanism.speed_limit).all()


def test_a_prismatic_joint_moves_at_its_own_speed(gantry: Path) -> None:
    _, reference = moved(gantry, 30.0)
    _, velocity, _ = reference.motion.at(reference.motion.time)
    assert 0.05 < np.abs(velocity[:, 0]).max() <= 0.301


def test_single_moves_precede_ordinary_ones_on_request() -> None:
    _, reference = moved("panda", 60.0, structural=True)
    assert [joint for joint, _ in during(reference, "structural")] == [
        d for d in range(7) for _ in range(2)
    ]
    assert during(reference, "move")


@settings(max_examples=20)
@given(st.floats(-1.0, 3.0))
def test_smooth_rise_is_the_integral_of_the_step(x: float) -> None:
    h = 1e-5
    around = smooth_rise(np.array([x - h, x + h]))
    slope = smooth_step(np.array([x]))[0]
    assert (around[1] - around[0]) / (2 * h) == pytest.approx(slope, abs=1e-6)
