"""Estimates from features alone: fit, truth of the covariances, robustness, several logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from synthetic import pinocchio_model, random_features, random_state, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State, moved
from skin2urdf.estimation.solve.estimate import (
    Estimate,
    EstimationSettings,
    estimate,
    robust_weights,
)
from skin2urdf.estimation.uncertainty.observability import observability
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.records import Features
from skin2urdf.structure.records import KinematicTree

NOISE = 0.05
TREE = serial_tree(4)
PLAIN = EstimationSettings(
    priors=Priors(bias=0.0, scale=0.0, cross=0.0, gravity=GRAVITY), intrinsics=False
)
SENSORS = EstimationSettings(priors=Priors(bias=0.3, scale=0.02, cross=0.01, gravity=GRAVITY))


def up_vectors(*tilts: float) -> F64:
    """Up in the base frame of logs; the first is z by convention, the others are tilted."""
    return np.array([[0.0, np.sin(t), np.cos(t)] for t in tilts])


def drawn(rng: np.random.Generator, tree: KinematicTree, priors: Priors, hidden: float) -> State:
    """A random robot whose sensors are drawn from the priors.

    Args:
        rng: source of randomness.
        tree: the structure.
        priors: spread of the sensors.
        hidden: spread of the rotations that cross-axis errors hide [rad]. The state's SU frames
            are those the sensors seem to have.
    """
    state = random_state(rng, tree, intrinsics=0.0)
    U, sd = tree.n_sus, priors.deviations
    T = state.T_joint_su.copy()
    T[:, :3, :3] @= Rotation.from_rotvec(hidden * rng.standard_normal((U, 3))).as_matrix()
    return replace(
        state,
        T_joint_su=T,
        bias=sd[:3] * rng.standard_normal((U, 3)),
        shape=sd[3:] * rng.standard_normal((U, 6)),
    )


def poses(tree: KinematicTree, state: State, q: F64) -> F64:
    """(C, U, 4, 4) SU poses in the base frame, by Pinocchio."""
    model, frames = pinocchio_model(tree, state)
    data = model.createData()
    out = []
    for position in q:
        pin.framesForwardKinematics(model, data, position)
        out.append([data.oMf[f].homogeneous for f in frames])
    return np.array(out)


def relative(tree: KinematicTree, state: State, q: F64, pairs: Sequence[tuple[int, int]]) -> F64:
    """(C n, 4, 4) pose of one SU seen from another, which no choice of frames changes."""
    T = poses(tree, state, q)
    return np.concatenate([np.linalg.inv(T[:, a]) @ T[:, b] for a, b in pairs])


def differences(T: F64, T_reference: F64) -> F64:
    """(..., 6 n) twists (linear [m], angular [rad]) from references to frames (..., n, 4, 4)."""
    E = np.linalg.inv(T_reference) @ T
    angular = Rotation.from_matrix(E[..., :3, :3].reshape(-1, 3, 3)).as_rotvec()
    twists = np.concatenate([E[..., :3, 3], angular.reshape(*E.shape[:-2], 3)], axis=-1)
    return twists.reshape(*E.shape[:-3], -1)


def squared_error(
    found: Estimate, truth: State, q: F64, pairs: Sequence[tuple[int, int]]
) -> tuple[float, int]:
    """Normalised squared error of relative SU poses and the number of their degrees of freedom."""
    covariance = observability(found).covariance.dense()
    zero = found.cost.zero_step()
    at = relative(found.tree, found.state, q, pairs)
    n, h = zero.flat().size, 1e-6
    steps = np.eye(n)
    # Biases and shapes of sensors, and gravity, move nothing.
    placing = [zero.like(step) for step in steps]
    moving = [i for i, step in enumerate(placing) if step.joints.any() or step.sus[:, :6].any()]
    moving = [i for i in moving if covariance[i, i] > 0]
    states = [moved(found.state, zero.like(h * steps[i])) for i in moving]
    J = np.zeros((6 * len(at), n))
    there = np.array([relative(found.tree, state, q, pairs) for state in states])
    J[:, moving] = differences(there, at).T / h
    e = differences(relative(found.tree, truth, q, pairs), at)
    S = J @ covariance @ J.T
    lam, V = np.linalg.eigh(S)
    keep = lam > 1e-9 * lam[-1]
    return float(np.sum((V[:, keep].T @ e) ** 2 / lam[keep])), int(keep.sum())


@pytest.mark.parametrize("setting", [PLAIN, SENSORS], ids=["placements", "sensors"])
def test_the_cost_per_degree_of_freedom_is_one(setting: EstimationSettings) -> None:
    costs = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        state = drawn(rng, TREE, setting.priors, 0.0)
        features = random_features(rng, TREE, state, 8, noise=NOISE)
        costs.append(estimate(features, TREE, setting).cost_per_dof)
    assert np.mean(costs) == pytest.approx(1.0, abs=0.06)
    assert max(costs) < 1.3


@pytest.mark.parametrize(
    ("setting", "hidden"),
    [(PLAIN, 0.0), (replace(SENSORS, priors=replace(SENSORS.priors, cross=0.0)), 0.0),
     (SENSORS, 0.01)],
    ids=["placements", "bias and scale", "cross axes"],
)  # fmt: skip
def test_errors_are_as_large_as_the_covariance_says(
    setting: EstimationSettings, hidden: float
) -> None:
    """NEES: the squared error over its covariance averages to its degrees of freedom."""
    total, dofs = 0.0, 0
    for seed in range(24):
        rng = np.random.default_rng(100 + seed)
        felt = drawn(rng, TREE, setting.priors, 0.0)
        features = random_features(rng, TREE, felt, 8, noise=NOISE)
        # Where a sensor sits and where its cross-axis errors make it seem to sit.
        T = felt.T_joint_su.copy()
        turn = hidden * rng.standard_normal((TREE.n_sus, 3))
        T[:, :3, :3] @= Rotation.from_rotvec(turn).as_matrix()
        found = estimate(features, TREE, setting)
        q = rng.uniform(-1.5, 1.5, (1, 4))
        # SU 0 is left out: its place along axis 1 is open.
        error, n = squared_error(found, replace(felt, T_joint_su=T), q, [(1, 3), (2, 3)])
        total, dofs = total + error, dofs + n
    assert dofs == 24 * 12
    assert 0.8 < total / dofs < 1.25


def test_intrinsics_are_found_where_they_can_be_seen() -> None:
    rng = np.random.default_rng(7)
    truth = drawn(rng, TREE, SENSORS.priors, 0.0)
    features = random_features(rng, TREE, truth, 40, noise=0.01)
    found = estimate(features, TREE, SENSORS).state
    # The tip SU turns about all axes.
    np.testing.assert_allclose(found.bias[3], truth.bias[3], atol=0.02)
    np.testing.assert_allclose(found.shape[3], truth.shape[3], atol=2e-3)


@pytest.mark.parametrize("refine", ["none", "casadi"])
def test_refinement_ends_at_the_same_optimum(refine: str) -> None:
    rng = np.random.default_rng(3)
    features = random_features(rng, TREE, drawn(rng, TREE, SENSORS.priors, 0), 8, noise=NOISE)
    plain = estimate(features, TREE, SENSORS)
    found = estimate(features, TREE, replace(SENSORS, refine=refine))  # type: ignore[arg-type]
    assert found.chi2 == pytest.approx(plain.chi2, abs=0.05)


def corrupted(features: Features, pose: int, su: int, size: float) -> Features:
    """Features in which something hit one SU in one pose."""
    coefficients = features.coefficients.copy()
    rng = np.random.default_rng(5)
    coefficients[pose, su] += size * rng.standard_normal(coefficients.shape[2:])
    return replace(features, coefficients=coefficients)


def test_one_bad_block_does_little_harm() -> None:
    rng = np.random.default_rng(4)
    truth = drawn(rng, TREE, PLAIN.priors, 0.0)
    features = random_features(rng, TREE, truth, 12, noise=NOISE, shuffle=False)
    q = rng.uniform(-1.5, 1.5, (5, 4))

    def error(of: Features, robust: bool) -> tuple[float, Estimate]:
        found = estimate(of, TREE, replace(PLAIN, robust=robust))
        pairs = [(1, 3), (2, 3)]
        e = differences(
            relative(TREE, found.state, q, pairs), relative(TREE, truth, q, pairs)
        ).reshape(-1, 6)
        return float(np.sqrt(np.mean(e[:, :3] ** 2))), found

    bad = corrupted(features, 5, 2, 0.3)
    clean, _ = error(features, robust=True)
    plain, without = error(bad, robust=False)
    robust, found = error(bad, robust=True)
    assert plain > 5 * clean
    assert robust < 0.25 * plain
    assert found.weight[5, 2] < 0.1
    assert np.delete(found.weight.ravel(), 5 * 4 + 2).min() > 0.5
    assert without.weight.min() == 1.0
    # What the block says is still told, before its weight.
    assert found.chi2_by_block[5, 2] / found.count[5, 2] > 20


@given(st.integers(0, 10_000), st.floats(0.1, 1000.0))
@settings(max_examples=50, deadline=None)
def test_weights_do_not_depend_on_the_noise_level(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    count = rng.integers(1, 40, (8, 5))
    chi2 = rng.chisquare(count)
    chi2[3, 2] = 100.0 * count[3, 2]
    weight = robust_weights(chi2, count)
    np.testing.assert_allclose(robust_weights(scale * chi2, count), weight, rtol=1e-9)
    assert ((weight > 0) & (weight <= 1)).all()
    assert weight[3, 2] < 1.0


def test_blocks_without_data_keep_their_weight() -> None:
    count = np.array([[6, 6], [0, 6], [6, 6]])
    chi2 = np.array([[6.0, 6.0], [0.0, 6.0], [6.0, 600.0]])
    weight = robust_weights(chi2, count)
    np.testing.assert_allclose(weight, [[1, 1], [1, 1], [1, 0.03]])


def test_rests_that_fit_do_not_outvote_patterns() -> None:
    """Patterns hold second-order effects at first; rests of a good sensor hold hardly any noise."""
    count = np.array([[3]] * 20 + [[45]] * 4)
    chi2 = count * np.array([[0.01]] * 20 + [[50.0], [60.0], [40.0], [6000.0]])
    weight = robust_weights(chi2, count)[:, 0]
    np.testing.assert_array_equal(weight[:23], 1.0)
    assert weight[23] < 0.1


def link_one_yaw_is_open(ups: F64) -> bool:
    """Whether the yaw of the first segment's SU about a vertical axis 1 stays open."""
    rng = np.random.default_rng(2)
    tree = serial_tree(4)
    state = drawn(rng, tree, PLAIN.priors, 0.0)
    joints = state.T_parent_joint.copy()
    joints[0] = np.eye(4)
    state = replace(state, T_parent_joint=joints, up=ups)
    features = random_features(rng, tree, state, 12, noise=NOISE, shuffle=False)
    found = estimate(features, tree, PLAIN)
    assert found.cost_per_dof == pytest.approx(1.0, abs=0.2)
    return bool(np.linalg.norm(_angular(observability(found).su_unobservable[0])) > 0.05)


def _angular(directions: F64) -> F64:
    return directions[:, 3:]


def test_a_second_log_with_the_base_tilted_shows_the_yaw_of_the_first_segment() -> None:
    assert link_one_yaw_is_open(up_vectors(0.0))
    assert not link_one_yaw_is_open(up_vectors(0.0, 0.4))


def test_the_tilt_of_a_second_log_is_found() -> None:
    rng = np.random.default_rng(6)
    truth = replace(drawn(rng, TREE, PLAIN.priors, 0.0), up=up_vectors(0.0, 0.7, -1.1))
    features = random_features(rng, TREE, truth, 15, noise=NOISE)
    found = estimate(features, TREE, PLAIN)
    assert found.cost_per_dof == pytest.approx(1.0, abs=0.2)
    # The base's yaw is a matter of choice; angles between the up vectors are not.
    np.testing.assert_allclose(found.state.up @ found.state.up.T, truth.up @ truth.up.T, atol=5e-3)


def test_an_earlier_estimate_is_as_good_as_a_start() -> None:
    rng = np.random.default_rng(8)
    features = random_features(rng, TREE, drawn(rng, TREE, SENSORS.priors, 0), 8, noise=NOISE)
    first = estimate(features, TREE, SENSORS)
    again = estimate(features, TREE, SENSORS, start=first.state)
    assert again.chi2 == pytest.approx(first.chi2, abs=0.02)
