"""Predicted features against Pinocchio's LOCAL frame Jacobians."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import (
    exact_coefficients,
    pinocchio_jacobians,
    random_state,
    random_tree,
    serial_tree,
)

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State, local_motion
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.kinematics import PinocchioTree, to_pinocchio
from skin2urdf.model.prediction import (
    Chains,
    SuKinematics,
    joint_twists,
    su_kinematics,
    twist_maps,
    zero_frames,
)
from skin2urdf.structure.records import KinematicTree


def kinematics(tree: KinematicTree, state: State, q: F64) -> SuKinematics:
    built = PinocchioTree(tree)
    built.write_joints(state.T_parent_joint)
    R, p = built.joint_frames(q)
    up = np.tile(state.up[0] * GRAVITY, (len(q), 1))
    return su_kinematics(Chains.of(tree), tree.su_joint, R, p, state.T_joint_su, up)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(1, 6))
def test_features_are_those_of_pinocchio(seed: int, n_joints: int, n_sus: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, n_joints, n_sus, prismatic=0.4)
    state = random_state(rng, tree, intrinsics=0.0)
    q = rng.uniform(-3, 3, (3, n_joints))
    kin = kinematics(tree, state, q)
    features = kin.features()
    expected = exact_coefficients(tree, state, q, np.zeros(3, dtype=np.int64))
    R, _, _ = pinocchio_jacobians(tree, state, q)
    np.testing.assert_allclose(kin.R, R, atol=1e-12)
    L = (features.shape[2] - 1) // 2
    for u, joint in enumerate(tree.su_joint):
        chain = np.array(tree.chain(int(joint)), dtype=np.int64)
        n = len(chain)
        own = np.r_[0, 1 : 1 + n, 1 + L : 1 + L + n]
        rows = np.r_[0, 1 + chain, 1 + n_joints + chain]
        np.testing.assert_allclose(features[:, u, own], expected[:, u, rows], atol=1e-11)
        assert not np.delete(features[:, u], own, axis=1).any()
        # Nothing outside the chain moves the SU: Pinocchio agrees.
        assert not np.delete(expected[:, u], rows, axis=1).any()


def test_an_axis_along_z_under_a_lever_reads_what_paper_equation_1_says() -> None:
    tree = serial_tree(1)
    T = np.eye(4)
    T[:3, 3] = 0.5, 0.0, 0.2
    state = State(
        np.eye(4)[None], T[None], np.array([[1.0, 0, 0]]), np.zeros((1, 3)), np.zeros((1, 6))
    )
    f0, s, tau = kinematics(tree, state, np.zeros((1, 1))).features()[0, 0]
    np.testing.assert_allclose(f0, [GRAVITY, 0, 0])
    np.testing.assert_allclose(tau, [0, 0.5, 0])  # alpha x r
    np.testing.assert_allclose(s, [0, -GRAVITY, 0])  # gravity turns the other way


def test_slopes_are_the_change_of_the_static_reading() -> None:
    rng = np.random.default_rng(3)
    tree = random_tree(rng, 6, 5)
    state = random_state(rng, tree)
    q = rng.uniform(-2, 2, (2, 6))
    features = kinematics(tree, state, q).features()
    h = 1e-6
    for u, joint in enumerate(tree.su_joint):
        for i, d in enumerate(tree.chain(int(joint))):
            dq = h * np.eye(6)[d]
            plus, minus = kinematics(tree, state, q + dq).f0, kinematics(tree, state, q - dq).f0
            np.testing.assert_allclose(
                features[:, u, 1 + i], (plus - minus)[:, u] / (2 * h), atol=1e-7
            )


def test_twist_maps_are_the_change_under_a_move_of_the_su() -> None:
    rng = np.random.default_rng(4)
    tree = random_tree(rng, 5, 4)
    state = random_state(rng, tree)
    q = rng.uniform(-2, 2, (3, 5))
    moved, _ = twist_maps(kinematics(tree, state, q))
    h = 1e-6
    for i in range(6):
        x = np.zeros((tree.n_sus, 6))
        x[:, i] = h
        ends = []
        for sign in (1, -1):
            T = state.T_joint_su @ local_motion(sign * x)[0]
            shifted = State(state.T_parent_joint, T, state.up, state.bias, state.shape)
            ends.append(kinematics(tree, shifted, q).features())
        np.testing.assert_allclose(moved[..., i], (ends[0] - ends[1]) / (2 * h), atol=1e-7)


def test_zero_frames_are_where_the_placements_put_the_joints() -> None:
    rng = np.random.default_rng(2)
    tree = random_tree(rng, 6, 1, prismatic=0.5)
    assert tree.prismatic.any()
    assert not tree.prismatic.all()
    state = random_state(rng, tree)
    built = PinocchioTree(tree)
    built.write_joints(state.T_parent_joint)
    q = rng.uniform(-2, 2, (4, 6))
    R, p = built.joint_frames(q)
    R_zero, p_zero = zero_frames(R, p, q, tree.prismatic)
    for j, parent in enumerate(tree.parent):
        T = state.T_parent_joint[j]
        R_parent = R[:, parent] if parent >= 0 else np.tile(np.eye(3), (4, 1, 1))
        p_parent = p[:, parent] if parent >= 0 else np.zeros((4, 3))
        np.testing.assert_allclose(R_zero[:, j], R_parent @ T[:3, :3], atol=1e-12)
        np.testing.assert_allclose(p_zero[:, j], R_parent @ T[:3, 3] + p_parent, atol=1e-12)


def test_joint_twists_are_adjoints_of_the_joints_frames() -> None:
    rng = np.random.default_rng(6)
    tree = random_tree(rng, 4, 3)
    state = random_state(rng, tree)
    q = rng.uniform(-2, 2, (2, 4))
    chains = Chains.of(tree)
    built = PinocchioTree(tree)
    built.write_joints(state.T_parent_joint)
    R, p = built.joint_frames(q)
    kin = kinematics(tree, state, q)
    basis = rng.standard_normal((4, 6, 2))
    twists = joint_twists(chains, kin, R, p, basis)
    for i in range(2):
        for u in range(tree.n_sus):
            for place in range(chains.joint.shape[1]):
                if not chains.present[u, place]:
                    assert not twists[i, u, place].any()
                    continue
                j = chains.joint[u, place]
                su = pin.SE3(kin.R[i, u], kin.p[i, u])
                T = su.actInv(pin.SE3(R[i, j], p[i, j]))
                expected = T.toActionMatrix() @ basis[j]
                np.testing.assert_allclose(twists[i, u, place], expected, atol=1e-12)


def test_placements_are_written_in_place() -> None:
    rng = np.random.default_rng(7)
    tree = random_tree(rng, 5, 3)
    built, q = PinocchioTree(tree), rng.uniform(-2, 2, (1, 5))
    for _ in range(2):
        state = random_state(rng, tree)
        built.write_joints(state.T_parent_joint)
        fresh = PinocchioTree(tree)
        fresh.write_joints(state.T_parent_joint)
        for a, b in zip(built.joint_frames(q), fresh.joint_frames(q), strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_finished_model_carries_the_sus_as_frames() -> None:
    rng = np.random.default_rng(8)
    tree = random_tree(rng, 5, 4)
    state = random_state(rng, tree)
    q = rng.uniform(-2, 2, (1, 5))
    model = to_pinocchio(state.model(tree))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q[0])
    kin = kinematics(tree, state, q)
    for u, name in enumerate(tree.su_names):
        frame = data.oMf[model.getFrameId(name)]
        np.testing.assert_allclose(frame.rotation, kin.R[0, u], atol=1e-12)
        np.testing.assert_allclose(frame.translation, kin.p[0, u], atol=1e-12)


@pytest.mark.parametrize("on_base", [True, False])
def test_chains_are_padded_to_one_length(on_base: bool) -> None:
    tree = KinematicTree(
        ("a", "b", "c"), np.array([-1, 0, 0]), ("revolute", "prismatic", "revolute"),
        ("s", "t"), np.array([-1 if on_base else 0, 1]),
    )  # fmt: skip
    chains = Chains.of(tree)
    assert chains.length.tolist() == [0 if on_base else 1, 2]
    assert chains.present.tolist() == [[not on_base, False], [True, True]]
    assert chains.prismatic.tolist() == [[False, False], [False, True]]
    assert chains.joint[1].tolist() == [0, 1]
    assert chains.n_rows == 5
