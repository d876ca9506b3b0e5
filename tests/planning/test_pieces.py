"""Trajectories are what controllers make of their points; pieces hold all limits in between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BPoly

from skin2urdf.errors import PlanError
from skin2urdf.planning.limits import Given, complete
from skin2urdf.planning.patterns import draw_tones, largest_amplitudes, pattern
from skin2urdf.planning.pieces import rest, strain, transfer
from skin2urdf.planning.plan import make_plan
from skin2urdf.planning.records import Limits, PlanSettings
from skin2urdf.planning.trajectory import JointTrajectory, joined


def limits_of(rng: np.random.Generator, n: int) -> Limits:
    velocity = rng.uniform(0.3, 4.0, n)
    acceleration = velocity * 10 ** rng.uniform(-0.5, 1.5, n)
    jerk = acceleration * 10 ** rng.uniform(0.0, 2.5, n)
    names = tuple(f"j{d}" for d in range(n))
    wide = np.full(n, 3.0)
    return Limits(names, np.zeros(n, dtype=bool), -wide, wide, velocity, acceleration, jerk)


def test_between_points_lies_the_polynomial_of_fifth_order() -> None:
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.05, 0.5, 6))
    q, qd, qdd = rng.standard_normal((3, 6, 2))
    given = JointTrajectory(("a", "b"), time, q, qd, qdd)
    spline = BPoly.from_derivatives(time, np.stack([q, qd, qdd], axis=1))
    at = rng.uniform(time[0], time[-1], 50)
    for n, values in enumerate(given.at(at)):
        np.testing.assert_allclose(values, spline.derivative(n)(at) if n else spline(at), atol=1e-7)
    densely = given.dense(4)
    np.testing.assert_allclose(densely[1][0], qd[:-1], atol=1e-9)
    np.testing.assert_allclose(densely[2][-1], qdd[1:], atol=1e-7)


def test_it_rests_before_the_first_and_after_the_last_point() -> None:
    given = JointTrajectory(
        ("a",), np.array([1.0, 2.0]), np.array([[0.0], [1.0]]), np.ones((2, 1)), np.ones((2, 1))
    )
    q, *rates = given.at(np.array([0.0, 3.0]))
    np.testing.assert_array_equal(q, [[0.0], [1.0]])
    assert not np.any(rates)


@pytest.mark.parametrize("seed", range(12))
def test_transfers_hold_limits_of_any_size(seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits = limits_of(rng, int(rng.integers(1, 8)))
    start, goal = rng.uniform(-2.5, 2.5, (2, limits.n_joints))
    goal = goal if seed % 3 else start + 1e-3 * goal
    piece = transfer(start, goal, limits)
    assert strain(piece, limits).max() <= 1.0
    np.testing.assert_allclose(piece.position[[0, -1]], [start, goal], atol=1e-12)
    assert not piece.velocity[[0, -1]].any()
    assert not piece.acceleration[[0, -1]].any()


def test_a_transfer_uses_what_it_may() -> None:
    limits = limits_of(np.random.default_rng(1), 4)
    piece = transfer(np.full(4, -2.5), np.full(4, 2.5), limits)
    assert strain(piece, limits)[1:].max() > 0.9


def test_strain_sees_what_leaves_a_limit_between_points() -> None:
    limits = replace(limits_of(np.random.default_rng(0), 1), lower=[-1.0], upper=[1.0])
    limits = Limits(
        limits.joint_names, limits.prismatic, np.array([-1.0]), np.array([1.0]),
        limits.velocity, limits.acceleration, limits.jerk,
    )  # fmt: skip
    turn = JointTrajectory(
        ("j0",), np.array([0.0, 1.0]), np.full((2, 1), 0.9), np.array([[1.0], [-1.0]]),
        np.zeros((2, 1)),
    )  # fmt: skip
    assert np.abs(turn.position).max() < 1.0
    assert strain(turn, limits)[0] > 1.0
    half = Limits(
        ("j0",), limits.prismatic, np.array([-np.inf]), np.array([1.0]),
        limits.velocity, limits.acceleration, limits.jerk,
    )  # fmt: skip
    assert strain(turn, half)[0] > 1.0


def test_tones_of_joints_differ_and_each_joint_has_several() -> None:
    tones = draw_tones(7, (0.6, 2.6), np.random.default_rng(0))
    assert tones.frequency.shape == (7, 3)
    assert len(np.unique(tones.frequency)) == 21
    assert draw_tones(30, (0.6, 2.6), np.random.default_rng(0)).frequency.shape == (30, 2)


@pytest.mark.parametrize("seed", range(4))
def test_patterns_hold_limits_and_use_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits, settings = limits_of(rng, 5), PlanSettings()
    tones = draw_tones(5, settings.band, rng)
    amplitude, swing = largest_amplitudes(tones, limits, settings, 6.0)
    piece = pattern(np.zeros(5), tones, amplitude, 6.0, settings.ramp, limits)
    used = strain(piece, limits)
    assert used.max() <= 1.0
    assert (np.abs(piece.dense()[0]).max(axis=(0, 1)) <= swing).all()
    assert not piece.velocity[[0, -1]].any()
    assert used.max() > 0.3


def test_pieces_are_joined_without_a_gap() -> None:
    limits = limits_of(np.random.default_rng(2), 2)
    there = transfer(np.zeros(2), np.ones(2), limits)
    whole = joined(limits.joint_names, [there, rest(limits.joint_names, np.ones(2), 0.5)])
    assert whole.duration == pytest.approx(there.duration + 0.5)
    assert (np.diff(whole.time) > 0).all()
    np.testing.assert_allclose(whole.at(np.array([whole.duration]))[0], 1.0)


@pytest.mark.parametrize("seed", range(3))
def test_plans_without_a_model_hold_limits_and_last_as_long_as_asked(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given = {
        f"j{d}": Given(
            prismatic=d == 2, lower=None if d == 1 else -0.5, upper=0.8, velocity=float(v),
            jerk=None if d else 40.0,
        )
        for d, v in enumerate(rng.uniform(0.5, 2.0, 3))
    }  # fmt: skip
    limits = complete(tuple(given), given)
    plan = make_plan(limits, PlanSettings(minutes=1.2, seed=seed, candidates=30, share=0.8))
    assert strain(plan.trajectory, limits)[1:].max() <= 0.8 + 1e-9
    assert strain(plan.trajectory, limits)[0] <= 1.0
    assert plan.trajectory.duration == pytest.approx(72.0, abs=1e-6)
    assert plan.checked is None
    alone = [phase.joint for phase in plan.phases if phase.kind == "structural"]
    assert alone == [0, 1, 2]
    for phase in plan.phases:
        moved = np.ptp(plan.trajectory.at(np.linspace(phase.start, phase.end, 50))[0], axis=0)
        if phase.kind == "structural":
            assert np.argmax(moved) == phase.joint
            assert np.delete(moved, phase.joint).max() < 1e-9
        elif phase.kind == "rest":
            assert moved.max() < 1e-9
        elif phase.kind == "pattern":
            assert moved.min() > 1e-3


def test_what_can_not_be_planned_is_refused_in_words() -> None:
    given = {"a": Given(lower=-1.0, upper=1.0, velocity=1.0)}
    limits = complete(("a",), given)
    with pytest.raises(PlanError) as refused:
        make_plan(limits, PlanSettings(minutes=0.2))
    assert "--minutes" in refused.value.remedy
    assert refused.value.exit_status == 2
    for wrong in (
        Given(lower=1.0, upper=-1.0),
        Given(lower=0.0, upper=0.1),
        Given(velocity=0.0),
        Given(acceleration=-1.0),
        Given(jerk=float("inf")),
    ):
        with pytest.raises(PlanError) as refused:
            complete(("a",), {"a": wrong})
        assert "a " in str(refused.value)
        assert refused.value.remedy
