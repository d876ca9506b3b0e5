"""The bound is what the comparison of URDFs measures, over many draws of the errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skin2urdf.estimation.problem.state import N_JOINT, N_SU, State, Step, moved
from skin2urdf.estimation.uncertainty.bounds import Align, expected_errors, limbs_of
from skin2urdf.estimation.uncertainty.covariance import ArrowCovariance
from skin2urdf.geometry.se3 import adjoint, exp, inverse
from skin2urdf.model.prediction import Chains
from skin2urdf.model.records import OpenDirection
from skin2urdf.structure.records import KinematicTree
from skin2urdf.urdf.compare import compare, random_positions
from skin2urdf.urdf.emit import emit
from skin2urdf.urdf.loading import load_robot

ARM = 0.1
TREE = KinematicTree(
    joint_names=tuple("abcdef"),
    parent=np.array([-1, 0, 1, -1, 3, -1]),
    joint_types=("revolute", "revolute", "revolute", "revolute", "prismatic", "revolute"),
    su_names=tuple(f"su_{u}" for u in range(7)),
    su_joint=np.array([0, 1, 2, 4, 3, 5, -1]),
)
TRUST = np.array([0, 2, 2, 2, 1, 0, 2])
CONFIGURATIONS = 15


def transforms(rng: np.random.Generator, n: int) -> np.ndarray:
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.random(n, random_state=rng).as_matrix()
    T[:, :3, 3] = rng.uniform(-0.4, 0.4, (n, 3))
    return T


def random_state(rng: np.random.Generator, tree: KinematicTree = TREE) -> State:
    D, U = tree.n_joints, tree.n_sus
    up = np.array([[0.0, 0.0, 1.0]])
    return State(transforms(rng, D), transforms(rng, U), up, np.zeros((U, 3)), np.zeros((U, 6)))


def random_covariance(
    rng: np.random.Generator, tree: KinematicTree = TREE, size: float = 3e-5
) -> ArrowCovariance:
    """Every SU leans on all joints of its chain."""

    def square(n: int, *shape: int) -> np.ndarray:
        root = size * rng.standard_normal((*shape, n, n)) / np.sqrt(5)
        return np.asarray(root @ np.swapaxes(root, -1, -2) + 0.01 * size**2 * np.eye(n))

    chains, U = Chains.of(tree), tree.n_sus
    columns = (N_JOINT * chains.joint[..., None] + np.arange(N_JOINT)).reshape(U, -1)
    lean = rng.standard_normal((U, N_SU, columns.shape[1]))
    lean *= np.repeat(chains.present, N_JOINT, axis=1)[:, None]
    return ArrowCovariance(square(N_JOINT * tree.n_joints), columns, lean, square(N_SU, U))


def text(state: State, tree: KinematicTree = TREE) -> str:
    limits = np.tile([-1.5, 1.5], (tree.n_joints, 1))
    return emit(state.model(tree), name="r", limits=limits, visuals=False)


def test_limbs_are_named_by_their_first_joint() -> None:
    assert limbs_of(TREE).tolist() == [0, 0, 0, 3, 3, 5, -1]


@pytest.mark.parametrize("align", ["limbs", "base"])
def test_errors_are_as_large_as_the_bound_says(tmp_path: Path, align: Align) -> None:
    rng = np.random.default_rng(0)
    true = random_state(rng)
    D, U = TREE.n_joints, TREE.n_sus
    n = N_JOINT * D + N_SU * U
    covariance = random_covariance(rng)
    root = np.linalg.cholesky(covariance.dense())
    free = [np.zeros((0, 6)) for _ in range(U)]
    free[0] = np.array([[0.0, 0.6, 0.8, 0.0, 0.0, 0.0]])
    free[5] = np.eye(6)[[1]]
    paths = tmp_path / "est.urdf", tmp_path / "true.urdf"
    paths[1].write_text(text(true))
    squares = []
    for _ in range(60):
        flat = root @ rng.standard_normal(n)
        for u in (0, 5):  # what is free may be far off
            at = N_JOINT * D + N_SU * u
            flat[at : at + 6] += 0.02 * rng.standard_normal() * free[u][0]
        zero = Step(np.zeros((D, N_JOINT)), np.zeros((0, 2)), np.zeros((U, N_SU)))
        paths[0].write_text(text(moved(true, zero.like(flat))))
        c = compare(
            *paths, unobservable=dict(zip(TREE.su_names, free, strict=True)),
            anchors=[name for name, t in zip(TREE.su_names, TRUST, strict=True) if t == 2],
            align=align, n_configurations=CONFIGURATIONS, rng=np.random.default_rng(1),
        )  # fmt: skip
        by_name = {su.name: su for su in c.sus}
        rows = [by_name[name] for name in TREE.su_names]
        squares.append(
            [[s.rms**2 if s else np.nan for s in (su.position, su.orientation)] for su in rows]
        )
    q = random_positions(
        *map(load_robot, paths), TREE.joint_names, CONFIGURATIONS, np.random.default_rng(1)
    )
    bound = expected_errors(TREE, true, covariance, q, free=free, trust=TRUST, arm=ARM, align=align)
    ratio = np.sqrt(np.mean(squares, axis=0)) / np.where(np.array(bound) > 0, bound, 1.0).T
    assert np.isnan(ratio[6, 0])  # the position of an SU on the RS
    np.testing.assert_allclose(np.delete(ratio.ravel(), 12), 1.0, atol=0.3)


@pytest.mark.parametrize("trusted", ["both branches", "one branch"])
def test_what_follows_open_directions_is_not_expected_either(tmp_path: Path, trusted: str) -> None:
    """A branch that is far along a slide and a turn, beside small errors of everything."""
    rng = np.random.default_rng(0)
    tree = KinematicTree(
        tuple("abcde"), np.array([-1, 0, 1, 0, 3]), ("revolute",) * 5,
        tuple(f"su_{u}" for u in range(5)), np.array([1, 2, 2, 3, 4]),
    )  # fmt: skip
    trust = np.array([2, 2, 2, 2, 2] if trusted == "both branches" else [2, 2, 2, 1, 1])
    true = random_state(rng, tree)
    covariance = random_covariance(rng, tree)
    root = np.linalg.cholesky(covariance.dense())
    into_d = adjoint(inverse(true.T_parent_joint[3]))
    axes = (2, 5) if trusted == "both branches" else (2,)
    directions = [OpenDirection({"d": into_d @ np.eye(6)[i]}, {}) for i in axes]
    paths = tmp_path / "est.urdf", tmp_path / "true.urdf"
    paths[1].write_text(text(true, tree))
    squares = []
    for _ in range(40):
        joints = true.T_parent_joint.copy()
        joints[3] = (
            exp(rng.uniform(-1.0, 1.0, 6) * [0, 0, 0.3, 0, 0, 2.0 * (5 in axes)]) @ joints[3]
        )
        far = replace(true, T_parent_joint=joints)
        zero = Step(np.zeros((5, N_JOINT)), np.zeros((0, 2)), np.zeros((5, N_SU)))
        flat = root @ rng.standard_normal(len(root))
        paths[0].write_text(text(moved(far, zero.like(flat)), tree))
        into_d = adjoint(inverse(joints[3]))
        there = [OpenDirection({"d": into_d @ np.eye(6)[i]}, {}) for i in axes]
        c = compare(
            *paths, open_directions=there, n_configurations=CONFIGURATIONS,
            anchors=[name for name, t in zip(tree.su_names, trust, strict=True) if t == 2],
            rng=np.random.default_rng(1),
        )  # fmt: skip
        by_name = {su.name: su for su in c.sus}
        rows = [by_name[name] for name in tree.su_names]
        squares.append([[su.position.rms**2, su.orientation.rms**2] for su in rows])  # type: ignore[union-attr]
    q = random_positions(
        *map(load_robot, paths), tree.joint_names, CONFIGURATIONS, np.random.default_rng(1)
    )
    bound = expected_errors(
        tree, true, covariance, q, free=[np.zeros((0, 6))] * 5, trust=trust, arm=ARM,
        open_directions=directions,
    )  # fmt: skip
    ratio = np.sqrt(np.mean(squares, axis=0)) / np.array(bound).T
    np.testing.assert_allclose(ratio, 1.0, atol=0.3)


def test_nothing_aligned_is_nothing_to_expect() -> None:
    state = random_state(np.random.default_rng(2))
    trust = np.where(limbs_of(TREE) == 3, 1, -1)
    position, orientation = expected_errors(
        TREE, state, random_covariance(np.random.default_rng(3)), np.zeros((2, TREE.n_joints)),
        free=[np.zeros((0, 6))] * TREE.n_sus, trust=trust, arm=ARM,
    )  # fmt: skip
    assert np.isfinite(position).tolist() == [False, False, False, True, True, False, True]
    assert position[6] == 0.0
    assert orientation[6] > 0.0
