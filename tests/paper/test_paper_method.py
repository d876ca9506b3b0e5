"""The paper's estimator: its error function is the paper's, and it finds the paper's robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from hypothesis import given, settings
from hypothesis import strategies as st

from skin2urdf.arrays import F64
from skin2urdf.errors import InsufficientDataError, StructureError
from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.solve.progressive import minimise
from skin2urdf.geometry.se3 import screw
from skin2urdf.model.records import KinematicModel
from skin2urdf.paper import case
from skin2urdf.paper.method import (
    PaperSettings,
    as_estimate,
    estimate_paper,
)
from skin2urdf.paper.model import (
    error_function,
    link_transform,
    mean_gravity,
    su_transform,
)
from skin2urdf.paper.placements import dh_table, placements
from skin2urdf.paper.search import SearchSettings, search
from skin2urdf.paper.training import (
    MotionPattern,
    SuTraining,
    su_training,
    training_features,
)
from skin2urdf.signals.records import Features
from skin2urdf.structure.records import KinematicTree

TREE = synthetic.serial_tree(case.N_DOFS)
PATTERN = MotionPattern()


def case_features(seed: int, noise: float = case.NOISE) -> Features:
    training = case.simulate_training(np.random.default_rng(seed), noise=noise)
    return training_features(
        TREE,
        training.q,
        training.gravity,
        training.acceleration,
        max(training.noise, 1e-4),
        PATTERN,
    )


def random_dh(rng: np.random.Generator, n: int, extended: bool) -> F64:
    """(n, 4 or 6) parameters inside the bounds of eq. 18."""
    size = np.array([np.pi, 1.0, 1.0, np.pi, np.pi, 1.0][: 6 if extended else 4])
    out = rng.uniform(-1.0, 1.0, (n, len(size))) * size
    out[:, 2] = np.abs(out[:, 2])
    return out


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 7),
    amplitude=st.floats(0.2, 5.0),
    frequency=st.floats(0.3, 4.0),
)
def test_error_function_is_the_papers_at_any_parameters(
    seed: int, n: int, amplitude: float, frequency: float
) -> None:
    rng = np.random.default_rng(seed)
    links, su = random_dh(rng, n - 1, False), random_dh(rng, 1, True)[0]
    q, K = rng.uniform(-3, 3, (5, n)), min(3, n)
    gravity, acceleration = rng.standard_normal((5, 3)), rng.standard_normal((5, n, 3))
    data = SuTraining(q, np.zeros(5), gravity, acceleration[:, n - K :])
    free = (2, 4, 9) if n > 1 else (5, 8)
    fixed = np.concatenate([links[-1] if n > 1 else np.zeros(4), su])
    pattern = MotionPattern(amplitude, frequency)
    wrong = np.where(np.isin(range(10), free), 0.7, fixed)
    error = error_function(data, list(link_transform(links[:-1])), free, wrong, pattern)
    # Rounding of the written-out second difference, p / h^2 in double precision.
    rounding = 1e-13 * (1000 * frequency) ** 2
    expected = case.error_parts(links, su, q, gravity, acceleration, 3, amplitude, frequency)
    np.testing.assert_allclose(
        error.parts(fixed[list(free)]), expected, rtol=1e-6 + rounding, atol=1e-9
    )


def test_second_difference_is_the_tangential_acceleration() -> None:
    pose = np.array([0.3, -0.8, 1.1])
    links, su = case.TRUE_LINKS[:2], case.TRUE_SUS[2]
    T = case.serial_chain(links, su, pose)
    T_axis = case.serial_chain(links[:0], np.array([*links[0], 0.0, 0.0]), pose[:1])
    tangential = np.cross(T_axis[:3, 2], T[:3, 3] - T_axis[:3, 3]) * PATTERN.peak_acceleration
    np.testing.assert_allclose(
        case.peak_acceleration(links, su, pose, 1), T[:3, :3].T @ tangential / 9.81, rtol=1e-5
    )


def test_pattern_angle_is_eq_10_without_cancellation() -> None:
    pattern = MotionPattern(0.7, 2.5)
    for time in (0.01, 0.13, -0.2):
        assert pattern.angle(time) == pytest.approx(case.pattern_angle(time, 0.7, 2.5), rel=1e-12)
    h = pattern.time_step
    assert h == 1 / 2500
    assert 2 * pattern.angle(h) / h**2 == pytest.approx(pattern.peak_acceleration, rel=1e-5)


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_truth_has_no_error_and_everything_else_has_some(n: int) -> None:
    blocks = feature_blocks(case_features(3, noise=0.0), TREE)
    data = su_training(blocks, n - 1, PATTERN, 3)
    links = list(link_transform(case.TRUE_LINKS[: max(0, n - 2)]))
    truth = np.concatenate([case.TRUE_LINKS[n - 2] if n > 1 else np.zeros(4), case.TRUE_SUS[n - 1]])
    error = error_function(data, links, range(10), truth, PATTERN)
    assert error(truth) < 1e-9
    for i in range(2 if n > 1 else 6, 10):
        changed = truth.copy()
        changed[i] += 0.1
        assert error(changed) > 1e-4


def test_gravity_may_point_anywhere_in_every_log() -> None:
    rng = np.random.default_rng(5)
    q, su = rng.uniform(-2, 2, (12, 1)), case.TRUE_SUS[0]
    up = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]])
    log = np.arange(12) % 2
    T = np.array([case.serial_chain(case.TRUE_LINKS[:0], su, p) for p in q])
    gravity = np.einsum("pij,pi->pj", T[:, :3, :3], up[log])
    data = SuTraining(q, log, gravity, np.zeros((12, 1, 3)))
    fixed = np.concatenate([np.zeros(4), su])
    e1, _ = error_function(data, [], (9,), fixed, PATTERN).parts(fixed[9:])
    assert e1 == pytest.approx(0.0, abs=1e-12)
    one_log = replace(data, log=np.zeros(12))
    assert error_function(one_log, [], (9,), fixed, PATTERN).parts(fixed[9:])[0] > 1.0
    np.testing.assert_allclose(mean_gravity(data, [], su_transform(su), 2), up, atol=1e-12)


def test_bounds_are_those_of_eq_18() -> None:
    data = SuTraining(np.zeros((3, 2)), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 2, 3)))
    lower, upper = error_function(data, [], range(10), np.zeros(10), PATTERN).bounds
    pi = np.pi
    np.testing.assert_array_equal(lower, [-pi, -1, 0, -pi, -pi, -1, 0, -pi, -pi, -1])
    np.testing.assert_array_equal(upper, [pi, 1, 1, pi, pi, 1, 1, pi, pi, 1])


def test_training_set_survives_the_way_through_features() -> None:
    training = case.simulate_training(np.random.default_rng(2), n_poses=6, amplitude=0.4)
    pattern = MotionPattern(0.4, 1.0)
    features = training_features(
        TREE, training.q, training.gravity, training.acceleration, training.noise, pattern
    )
    data = su_training(feature_blocks(features, TREE), 4, pattern, 3)
    np.testing.assert_allclose(data.gravity, training.gravity[:, 4])
    np.testing.assert_allclose(data.acceleration, training.acceleration[:, 4, 2:5])
    np.testing.assert_array_equal(data.q, training.q[:, :5])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_finds_the_papers_chain(seed: int) -> None:
    features = case_features(seed)
    result = estimate_paper(features, TREE, rng_seed=seed)
    assert result.converged
    assert [s.n_parameters for s in result.steps] == [4, 8, 10, 10, 10, 10, 10]
    assert all(0 < s.e_total <= 0.1 for s in result.steps)
    # From there the weighted least-squares reaches the noise: it is the right robot.
    found = as_estimate(result, features)
    _, chi2 = minimise(found.cost, result.state, found.free)
    assert chi2 / found.degrees_of_freedom < 1.1 < found.cost_per_dof


def test_same_seed_same_result() -> None:
    features = case_features(1)
    short = PaperSettings(search=SearchSettings(evaluations=1000, attempts=3))
    one, two = (estimate_paper(features, TREE, short, rng_seed=3) for _ in range(2))
    assert max(step.attempts for step in one.steps) > 1
    np.testing.assert_array_equal(one.links, two.links)
    np.testing.assert_array_equal(one.sus, two.sus)


def test_a_spent_budget_is_told() -> None:
    quick = SearchSettings(e_stop=1e-6, evaluations=40, attempts=2)
    result = estimate_paper(case_features(0), TREE, PaperSettings(search=quick))
    assert not result.converged
    assert all(s.attempts == 2 and 40 <= s.iterations <= 90 for s in result.steps)


def test_restarts_look_elsewhere_and_angles_come_back_wrapped() -> None:
    seen: list[F64] = []

    def error(x: F64) -> float:
        seen.append(x.copy())
        return 2.0 + float(np.cos(x[0] - 0.4) + x[1])

    bounds = (np.array([-np.pi, 0.0]), np.array([np.pi, 1.0]))
    few = SearchSettings(e_stop=0.5, evaluations=60, attempts=3)
    found = search(error, bounds, np.array([True, False]), few, np.random.default_rng(0))
    assert found.attempts == 3
    assert found.calls == len(seen)
    points = np.array(seen)
    assert (np.abs(points[:60, 0]) <= np.pi).all()
    assert (np.abs(points[60:, 0]) > np.pi).any()
    assert ((points[:, 1] >= 0) & (points[:, 1] <= 1)).all()
    assert found.x[0] == pytest.approx(0.4 - np.pi, abs=0.05)
    assert found.value == pytest.approx(1.0, abs=0.01)


def test_branches_several_sus_and_an_su_on_the_base() -> None:
    rng = np.random.default_rng(4)
    tree = KinematicTree(
        ("j0", "j1", "j2"),
        np.array([-1, 0, 0]),
        ("revolute",) * 3,
        ("base", "a", "b", "b2", "c", "a2"),
        np.array([-1, 0, 1, 1, 2, 0]),
    )
    truth = synthetic.random_state(rng, tree, intrinsics=0.0)
    features = synthetic.random_features(rng, tree, truth, 15, noise=0.02)
    result = estimate_paper(features, tree, rng_seed=1)
    assert result.converged
    assert [s.n_parameters for s in result.steps] == [4, 4, 8, 6, 8]
    found = as_estimate(result, features)
    _, chi2 = minimise(found.cost, result.state, found.free)
    assert chi2 / found.degrees_of_freedom < 1.2


def test_placements_agree_on_gravity_whatever_the_yaw_was() -> None:
    features = case_features(6, noise=0.0)
    blocks = feature_blocks(features, TREE)
    links = np.concatenate([np.zeros((1, 4)), case.TRUE_LINKS])
    sus = np.array(case.TRUE_SUS)
    links[1, 0] += 0.9  # yaw of everything behind DoF 2 and of SU 1, each on its own
    sus[0, 0] -= 1.7
    transforms = list(link_transform(links[1:]))
    gravity = np.array(
        [
            mean_gravity(
                su_training(blocks, u, PATTERN, 3), transforms[:u], su_transform(sus[u]), 1
            )
            for u in range(case.N_DOFS)
        ]
    )
    state = placements(TREE, blocks, links, sus, gravity, 9.81)
    # What is left is the second difference, 3e-6 of every acceleration.
    assert Cost(TREE, blocks, Priors()).at(state).chi2 < 1e-3 * blocks.count.sum()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_numbers_of_a_model_are_those_it_was_made_of(seed: int) -> None:
    rng = np.random.default_rng(seed)
    links, sus = random_dh(rng, 6, False), random_dh(rng, 7, True)
    first = screw("x", 0.5, 0.0) @ screw("z", 0.3, 0.2)
    joints = np.concatenate([first[None], link_transform(links)])
    table = dh_table(KinematicModel(TREE, joints, su_transform(sus)), links[0, 0], links[0, 1])
    parallel = np.abs(np.sin(np.concatenate([links[:, 3], sus[:, 3]]))).min()
    np.testing.assert_allclose(table.links[1:], links, atol=1e-9 / parallel**2)
    np.testing.assert_allclose(table.sus, sus, atol=1e-9 / parallel**2)


def test_says_what_it_can_not_do() -> None:
    features = case_features(0)
    slides = replace(TREE, joint_types=("revolute",) * 6 + ("prismatic",))
    with pytest.raises(StructureError) as caught:
        estimate_paper(features, slides)
    assert caught.value.dofs == ("joint6",)
    bare = replace(TREE, su_names=TREE.su_names[1:], su_joint=TREE.su_joint[1:])
    with pytest.raises(StructureError) as caught:
        estimate_paper(features, bare)
    assert caught.value.dofs == ("joint0",)
    noise = features.noise.copy()
    noise[2:, 3] = np.inf
    quick = PaperSettings(search=SearchSettings(evaluations=20, attempts=1))
    with pytest.raises(InsufficientDataError) as lacking:
        estimate_paper(replace(features, noise=noise), TREE, quick)
    assert (lacking.value.lacks, lacking.value.names) == ("poses", ("su3",))
