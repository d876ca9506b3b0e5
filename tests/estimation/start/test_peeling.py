"""Peeling: senses, sliding joints, and patterns that hardly tell slopes from lever arms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import exact_coefficients, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.solve.estimate import EstimationSettings, estimate
from skin2urdf.estimation.start.order import ordered
from skin2urdf.estimation.start.peeling import Peeled, Readings, candidates, misfit_of
from skin2urdf.geometry.se3 import inverse, placement
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features, StaticMoves
from skin2urdf.structure.records import KinematicTree

NOISE = 0.002
SETTINGS = EstimationSettings(
    priors=Priors(bias=0.0, scale=0.0, cross=0.0, gravity=GRAVITY), intrinsics=False
)


def state_of(rng: np.random.Generator, tree: KinematicTree, axes: F64) -> State:
    """A chain with given axes at position zero, some decimetres apart."""
    points = np.cumsum(rng.uniform(-0.3, 0.3, (len(axes), 3)), axis=0)
    world = placement(frame_with_z(axes), points)
    before = np.concatenate([np.eye(4)[None], world[:-1]])
    U = tree.n_sus
    R = Rotation.random(U, random_state=rng).as_matrix()
    T_joint_su = placement(R, rng.uniform(-0.1, 0.1, (U, 3)))
    up = np.array([[0.0, 0.0, 1.0]])
    return State(inverse(before) @ world, T_joint_su, up, np.zeros((U, 3)), np.zeros((U, 6)))


def features_of(
    rng: np.random.Generator, tree: KinematicTree, state: State, tone: float = 0.0
) -> Features:
    """Features of 14 poses; a pure tone makes dq and qdd the more alike the nearer it is to 1."""
    D, U, P = tree.n_joints, tree.n_sus, 14
    q = rng.uniform(-1.5, 1.5, (P, D)) * np.where(tree.prismatic, 0.15, 1.0)
    X = rng.standard_normal((P, 200, 1 + 2 * D))
    X[..., 1 + D :] = -tone * X[..., 1 : 1 + D] + np.sqrt(1 - tone**2) * X[..., 1 + D :]
    X *= np.r_[1.0, np.full(D, 0.05), np.full(D, 8.0)]
    information = np.swapaxes(X, 1, 2) @ X
    root = np.linalg.cholesky(information)[:, None]
    exact = exact_coefficients(tree, state, q, np.zeros(P, dtype=np.int64))
    error = np.linalg.solve(np.swapaxes(root, -1, -2), rng.standard_normal(exact.shape))
    return Features(
        tree.su_names, tree.joint_names, q, np.zeros(P), exact + NOISE * error,
        Information.of(np.tile(information[:, None], (1, U, 1, 1))), np.full((P, U, 3), NOISE),
        np.zeros(U), np.zeros(U), StaticMoves(np.zeros(0), np.zeros(0), np.zeros((0, U, 3))),
    )  # fmt: skip


def tip_only(n: int, prismatic: tuple[int, ...] = ()) -> KinematicTree:
    """A chain with one SU at its tip."""
    tree = serial_tree(n, prismatic)
    return KinematicTree(
        tree.joint_names, tree.parent, tree.joint_types, ("tip",), np.array([n - 1])
    )


@pytest.mark.parametrize("layout", [tip_only, serial_tree])
def test_many_parallel_vertical_axes_turn_in_the_right_senses(layout: type) -> None:
    """Gravity shows none of their senses, and 16 combinations are more than are followed."""
    senses = np.array([1.0, -1.0, -1.0, 1.0])
    axes = np.concatenate([senses[:, None] * [0.0, 0.0, 1.0], [[0.0, 0.8, 0.6]]])
    for seed in range(3):
        rng = np.random.default_rng(seed)
        tree = layout(5)
        found = estimate(features_of(rng, tree, state_of(rng, tree, axes)), tree, SETTINGS)
        assert found.cost_per_dof < 1.3


def test_vertical_axes_turn_in_the_right_senses_without_slopes() -> None:
    axes = np.array([1.0, -1.0, -1.0, 1.0])[:, None] * [0.0, 0.0, 1.0]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        tree = serial_tree(4)
        features = features_of(rng, tree, state_of(rng, tree, axes))
        keep = np.r_[1.0, np.zeros(4), np.ones(4)]
        information = Information.of(features.information.dense() * np.diag(keep))
        coefficients = features.coefficients * keep[:, None]
        bare = Features(
            **{**vars(features), "information": information, "coefficients": coefficients}
        )
        # Without the off-diagonal information the noise is somewhat larger than stated.
        assert estimate(bare, tree, SETTINGS).cost_per_dof < 1.6


def test_a_wrong_sense_costs_more_than_the_right_one() -> None:
    rng = np.random.default_rng(1)
    tree = tip_only(3)
    axes = np.array([[0.0, 0.0, 1.0]] * 3)
    state = state_of(rng, tree, axes)
    readings = Readings.of(feature_blocks(features_of(rng, tree, state), tree), 0)
    R_su_base = (np.linalg.multi_dot([*state.T_parent_joint, state.T_joint_su[0]])[:3, :3]).T
    right = axes @ R_su_base.T
    wrong = right * np.array([[1.0], [-1.0], [1.0]])
    good = misfit_of(readings, right, tree.prismatic)
    assert good < 2 * 14 * 9
    assert misfit_of(readings, wrong, tree.prismatic) > 100 * good


def test_slopes_and_lever_arms_that_go_together_still_show_the_axis() -> None:
    """Each alone is hardly known, but what they have in common is, a thousand times as well."""
    rng = np.random.default_rng(3)
    tree = tip_only(3)
    axes = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    state = state_of(rng, tree, axes)
    blocks = feature_blocks(features_of(rng, tree, state, tone=1 - 1e-8), tree)
    readings = Readings.of(blocks, 0)
    assert np.median(np.sqrt(readings.var_tau)) > 0.1
    found = candidates(readings, 2, Peeled.nothing(14), slides=False)[0]
    true = state.T_joint_su[0, 2, :3]
    assert np.rad2deg(np.arccos(found.axis @ true)) < 0.3


@pytest.mark.parametrize("seed", range(4))
def test_the_order_is_right_where_a_sliding_joint_carries_others(seed: int) -> None:
    """A slide moves the lever arms of the joints before it."""
    rng = np.random.default_rng(seed)
    true = tip_only(5, prismatic=(2,))
    axes = rng.standard_normal((5, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    features = features_of(rng, true, state_of(rng, true, axes))
    mixed = rng.permutation(5)
    unordered = KinematicTree(
        tuple(true.joint_names[i] for i in mixed), true.parent,
        tuple(true.joint_types[i] for i in mixed), true.su_names, true.su_joint,
    )  # fmt: skip
    assert ordered(unordered, features).joint_names == true.joint_names
