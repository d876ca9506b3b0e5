"""Closed-form starts lead to the global optimum, whatever the posture of the base."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from synthetic import exact_coefficients, random_features, random_state, random_tree

from skin2urdf.arrays import F64
from skin2urdf.errors import InsufficientDataError
from skin2urdf.estimation.problem.blocks import FeatureBlocks, feature_blocks
from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.problem.state import State, identifiable
from skin2urdf.estimation.solve.estimate import EstimationSettings, estimate
from skin2urdf.estimation.solve.gauss_newton import gauss_newton
from skin2urdf.estimation.start.inward import inward_starts
from skin2urdf.estimation.start.orientation import Orientations
from skin2urdf.estimation.start.outward import outward_starts
from skin2urdf.estimation.start.starts import felt_up, placed
from skin2urdf.geometry.so3 import fibonacci_sphere
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.paper.case import TRUE_LINKS, TRUE_SUS, acc_matrix, dh_matrix
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features, StaticMoves
from skin2urdf.structure.records import KinematicTree

TILTS = {"upright": 0.0, "2 deg": np.deg2rad(2.0), "29 deg": 0.5}
PRIORS = Priors(bias=0.0, scale=0.0, cross=0.0, gravity=GRAVITY)
SETTINGS = EstimationSettings(priors=PRIORS, intrinsics=False)
NOISE = 0.01 * GRAVITY / np.sqrt(3.0)
"""Uniform noise within +-0.01 g (paper III)."""

Starts = Callable[[KinematicTree, FeatureBlocks, Priors], Iterator[Orientations]]


def paper_tree() -> KinematicTree:
    return KinematicTree(
        tuple(f"joint{i}" for i in range(7)), np.arange(-1, 6), ("revolute",) * 7,
        tuple(f"su{i}" for i in range(7)), np.arange(7),
    )  # fmt: skip


def paper_state(tilt: float) -> State:
    """The chain of Fig. 6 on a base that is tilted by so much [rad]."""
    base = dh_matrix(0.0, 0.0, 0.0, tilt)
    joints = np.array([base, *(dh_matrix(*link) for link in TRUE_LINKS)])
    sus = np.array([dh_matrix(*su[:4]) @ acc_matrix(*su[4:]) for su in TRUE_SUS])
    return State(joints, sus, np.array([[0, 0, 1.0]]), np.zeros((7, 3)), np.zeros((7, 6)))


def paper_features(tilt: float, seed: int, slopes: bool) -> Features:
    """Gravity and peak accelerations in 20 poses, with gravity's slopes where asked for."""
    rng = np.random.default_rng(seed)
    tree, state = paper_tree(), paper_state(tilt)
    q = rng.uniform(-2.62, 2.62, (20, 7))
    log = np.zeros(20, dtype=np.int64)
    swing = np.r_[1.0, np.full(7, 0.2 if slopes else 0.0), np.full(7, 2 * np.pi)]
    error = NOISE * rng.uniform(-np.sqrt(3), np.sqrt(3), (20, 7, 15, 3))
    inverse = np.divide(1.0, swing, out=np.zeros(15), where=swing > 0)[:, None]
    coefficients = exact_coefficients(tree, state, q, log) * (swing > 0)[:, None] + error * inverse
    return Features(
        tree.su_names, tree.joint_names, q, log, coefficients,
        Information.of(np.tile(np.diag(swing**2), (20, 7, 1, 1))), np.full((20, 7, 3), NOISE),
        np.zeros(7), np.zeros(7), StaticMoves(np.zeros(0), np.zeros(0), np.zeros((0, 7, 3))),
    )  # fmt: skip


def only(features: Features, tree: KinematicTree, sus: list[int]) -> tuple[Features, KinematicTree]:
    """Some of the SUs alone."""
    names = tuple(tree.su_names[u] for u in sus)
    index = [features.su_names.index(n) for n in names]
    arrays = {k: getattr(features, k)[:, index] for k in ("coefficients", "noise")}
    cut = replace(
        features, information=Information.of(features.information.dense()[:, index]),
        su_names=names, latency=np.zeros(len(sus)), latency_sd=np.zeros(len(sus)),
        moves=StaticMoves(np.zeros(0), np.zeros(0), np.zeros((0, len(sus), 3))), **arrays,
    )  # fmt: skip
    return cut, replace(tree, su_names=names, su_joint=tree.su_joint[sus])


EXPLAINED = 1.1
"""Chi-squared per measurement of the global optimum: chance adds less to the mean of 1."""


def best_after(starts: Starts, features: Features, tree: KinematicTree) -> float:
    """Lowest chi-squared per measurement that Gauss-Newton reaches from the starts.

    Those after one that explains the features are not tried.
    """
    cost = Cost(tree, feature_blocks(features, tree), PRIORS)
    free = identifiable(tree, 1, intrinsics=False)
    best = np.inf
    for start in starts(tree, cost.blocks, PRIORS):
        state = placed(cost, start, free)
        best = min(best, gauss_newton(cost, state, free, iterations=15)[1] / cost.n_data)
        if best < EXPLAINED:
            break
    return best


@pytest.mark.parametrize("tilt", TILTS)
@pytest.mark.parametrize("starts", [inward_starts, outward_starts])
def test_the_papers_chain_is_found_from_either_end(starts: Starts, tilt: str) -> None:
    for seed in range(6):
        features = paper_features(TILTS[tilt], seed, slopes=starts is inward_starts)
        # 66 parameters take 4 to 11 % off the mean of 1.
        assert 0.8 < best_after(starts, features, paper_tree()) < EXPLAINED


@pytest.mark.parametrize("tilt", TILTS)
@pytest.mark.parametrize("slopes", [True, False])
def test_the_estimate_takes_the_start_that_the_data_allow(tilt: str, slopes: bool) -> None:
    for seed in range(10, 15):
        found = estimate(paper_features(TILTS[tilt], seed, slopes), paper_tree(), SETTINGS)
        assert found.cost_per_dof == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("tilt", TILTS)
def test_one_su_at_the_tip_determines_the_whole_chain(tilt: str) -> None:
    for seed in range(4):
        features, tree = only(paper_features(TILTS[tilt], seed, True), paper_tree(), [6])
        assert 0.7 < best_after(inward_starts, features, tree) < EXPLAINED
        found = estimate(features, tree, SETTINGS)
        assert found.cost_per_dof == pytest.approx(1.0, abs=0.25)


def test_starts_are_close_before_any_refinement() -> None:
    """Axes seen from the tip agree with the truth to a degree."""
    features, state = paper_features(0.5, 0, True), paper_state(0.5)
    features = replace(features, coefficients=exact_coefficients(
        paper_tree(), state, features.q, features.log
    ))  # fmt: skip
    blocks = feature_blocks(features, paper_tree())
    start = next(iter(inward_starts(paper_tree(), blocks, PRIORS)))
    R = np.eye(3)
    axes = []
    for T in state.T_parent_joint:
        R = R @ T[:3, :3]
        axes.append(R[:, 2])
    angles = np.array(axes) @ np.array(axes).T
    np.testing.assert_allclose(start.axes @ start.axes.T, angles, atol=1e-6)
    np.testing.assert_allclose(start.axes @ start.up[0], np.array(axes) @ [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_branching_trees_with_sliding_joints_are_found_inwards(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, 7, 8, prismatic=0.25)
    state = random_state(rng, tree, intrinsics=0.0)
    # Every joint needs an SU beyond it.
    beyond = tree.activity().any(axis=0)
    if not beyond.all():
        tree = replace(tree, su_names=tuple(f"su{i}" for i in range(7)), su_joint=np.arange(7))
        state = random_state(rng, tree, intrinsics=0.0)
    features = random_features(rng, tree, state, 12, noise=0.05)
    assert best_after(inward_starts, features, tree) < EXPLAINED


def test_both_senses_of_a_vertical_axis_are_tried() -> None:
    features = paper_features(0.0, 0, False)
    blocks = feature_blocks(features, paper_tree())
    axes = np.array([s.axes[0] for s in outward_starts(paper_tree(), blocks, PRIORS)])
    assert (axes[:, 2] > 0.9).any()
    assert (axes[:, 2] < -0.9).any()


def test_an_su_that_is_never_heard_leaves_its_segment_bare() -> None:
    features = paper_features(0.5, 0, False)
    noise = np.array(features.noise)
    noise[:, 3] = np.inf
    blocks = feature_blocks(replace(features, noise=noise), paper_tree())
    assert not list(outward_starts(paper_tree(), blocks, PRIORS))


def test_a_bare_segment_without_slopes_is_an_error_in_words() -> None:
    features, tree = only(paper_features(0.5, 0, False), paper_tree(), [0, 1, 3, 6])
    with pytest.raises(InsufficientDataError) as caught:
        estimate(features, tree, SETTINGS)
    assert caught.value.lacks == "starts"
    assert caught.value.remedy


def test_gravity_of_all_logs_follows_from_the_first_one() -> None:
    rng = np.random.default_rng(4)
    tree = random_tree(rng, 6, 8)
    state = random_state(rng, tree, n_logs=3)
    features = random_features(rng, tree, state, 12, noise=0.02)
    cost = Cost(tree, feature_blocks(features, tree), Priors(gravity=GRAVITY))
    found = felt_up(replace(state, up=state.up[:1]), cost, features)
    np.testing.assert_allclose(found, state.up, atol=0.01)
    deaf = replace(
        features, noise=np.where(features.log[:, None, None] == 2, np.inf, features.noise)
    )
    cost = Cost(tree, feature_blocks(deaf, tree), Priors(gravity=GRAVITY))
    np.testing.assert_array_equal(felt_up(state, cost, deaf)[2], state.up[0])


def test_the_sphere_is_covered_evenly() -> None:
    points: F64 = fibonacci_sphere(800)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=2e-3)
    nearest = np.sort(points @ points.T, axis=1)[:, -2]
    angles = np.rad2deg(np.arccos(nearest))
    assert angles.max() < 7.5
    assert angles.min() > 2.0


def test_without_a_search_only_the_earlier_estimate_is_followed() -> None:
    """Readings of two SUs exchanged in half of the poses: nothing explains them."""
    features = paper_features(0.5, 0, slopes=True)
    mixed = np.array(features.coefficients)
    mixed[::2, [2, 5]] = mixed[::2, [5, 2]]
    hopeless = replace(features, coefficients=mixed)
    earlier = estimate(features, paper_tree(), SETTINGS).state
    searched = estimate(hopeless, paper_tree(), SETTINGS, earlier)
    followed = estimate(hopeless, paper_tree(), SETTINGS, earlier, search=False)
    assert min(searched.cost_per_dof, followed.cost_per_dof) > 3.0
    assert len(searched.hypotheses) > 1
    assert len(followed.hypotheses) == 1
