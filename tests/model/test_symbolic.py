"""The symbolic twin against Pinocchio and against the numeric prediction."""

from __future__ import annotations

import casadi as ca
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import pinocchio_jacobians, random_state, random_tree, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State, local_motion
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.model.prediction import Chains, su_kinematics
from skin2urdf.model.symbolic import (
    chain_function,
    chain_kinematics,
    moved_placements,
    stacked_placements,
)
from skin2urdf.model.symbolic import local_motion as symbolic_local_motion
from skin2urdf.structure.records import KinematicTree


def evaluated(tree: KinematicTree, state: State, u: int, q: F64, x: F64) -> dict[str, F64]:
    """The symbolic chain of SU u at one position q (D,), local coordinates x (n + 1, 6)."""
    chain = list(tree.chain(int(tree.su_joint[u])))
    T = np.concatenate([state.T_parent_joint[chain], state.T_joint_su[u][None]])
    stacked = stacked_placements(T).reshape(-1, 3).T
    function = chain_function(tuple(bool(tree.prismatic[j]) for j in chain))
    out = function(q=q[chain], placements=stacked, x=x.T, gravity_up=state.up[0] * GRAVITY)
    return {name: value.full() for name, value in out.items()}


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 5), st.booleans())
def test_it_is_pinocchio_and_the_prediction(
    seed: int, n_joints: int, n_sus: int, displaced: bool
) -> None:
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, n_joints, n_sus, prismatic=0.4)
    state = random_state(rng, tree, intrinsics=0.0)
    xj = displaced * rng.standard_normal((n_joints, 6))
    xs = displaced * rng.standard_normal((n_sus, 6))
    T_parent_joint = state.T_parent_joint @ local_motion(xj)[0]
    T_joint_su = state.T_joint_su @ local_motion(xs)[0]
    moved = State(T_parent_joint, T_joint_su, state.up, state.bias, state.shape)
    q = rng.uniform(-3, 3, (1, n_joints))

    R, w, v = pinocchio_jacobians(tree, moved, q)
    built = PinocchioTree(tree)
    built.write_joints(T_parent_joint)
    chains = Chains.of(tree)
    up = moved.up * GRAVITY
    kin = su_kinematics(chains, tree.su_joint, *built.joint_frames(q), T_joint_su, up)
    features = kin.features()[0]
    L = chains.joint.shape[1]
    for u, joint in enumerate(tree.su_joint):
        chain = list(tree.chain(int(joint)))
        n = len(chain)
        out = evaluated(tree, state, u, q[0], np.concatenate([xj[chain], xs[u][None]]))
        np.testing.assert_allclose(out["R"], R[0, u], atol=1e-12)
        np.testing.assert_allclose(out["p"][:, 0], kin.p[0, u], atol=1e-12)
        np.testing.assert_allclose(out["w"].T, w[0, u, chain].reshape(n, 3), atol=1e-12)
        np.testing.assert_allclose(out["v"].T, v[0, u, chain].reshape(n, 3), atol=1e-12)
        rows = np.r_[0, 1 : 1 + n, 1 + L : 1 + L + n]
        np.testing.assert_allclose(out["features"].T, features[u, rows], atol=1e-11)


@given(st.integers(0, 2**32 - 1))
def test_local_motions_are_those_of_the_state(seed: int) -> None:
    x = np.random.default_rng(seed).uniform(-3, 3, 6)
    R, p = symbolic_local_motion(ca.DM(x))
    T, _ = local_motion(x)
    np.testing.assert_allclose(R.full(), T[:3, :3], atol=1e-15)
    np.testing.assert_allclose(p.full()[:, 0], T[:3, 3])


def test_a_column_depends_on_nothing_at_or_before_its_joint() -> None:
    prismatic = (False, True, False, False)
    q, T, x = ca.SX.sym("q", 4), ca.SX.sym("T", 3, 20), ca.SX.sym("x", 6, 5)
    chain = chain_kinematics(prismatic, q, moved_placements(T, x))
    for d in range(4):
        column = ca.vertcat(chain.w[:, d], chain.v[:, d])
        assert [ca.depends_on(column, x[:, k]) for k in range(5)] == [k > d for k in range(5)]
        assert not any(ca.depends_on(column, q[k]) for k in range(d + 1))


def test_expressions_may_be_matrices_of_either_kind() -> None:
    rng = np.random.default_rng(2)
    values = [rng.standard_normal(shape) for shape in ((3, 1), (3, 16), (6, 4))]
    results = []
    for kind in (ca.SX, ca.MX):
        q, T, x = kind.sym("q", 3), kind.sym("T", 3, 16), kind.sym("x", 6, 4)
        chain = chain_kinematics((False, True, False), q, moved_placements(T, x))
        function = ca.Function("f", [q, T, x], [chain.features(ca.DM([1, 2, 3]))])
        results.append(function(*values).full())
    np.testing.assert_allclose(results[0], results[1], rtol=1e-13)


def test_derivatives_in_the_coordinates_are_those_of_differences() -> None:
    rng = np.random.default_rng(1)
    tree = serial_tree(4, prismatic=(2,))
    state = random_state(rng, tree)
    q, x = rng.uniform(-2, 2, 4), 0.3 * rng.standard_normal((5, 6))
    T = np.concatenate([state.T_parent_joint, state.T_joint_su[3:]])
    X = ca.SX.sym("x", 6, 5)
    function = chain_function((False, False, True, False))
    up = state.up[0] * GRAVITY
    features = function(q, stacked_placements(T).reshape(-1, 3).T, X, up)[4]
    J = ca.Function("J", [X], [ca.jacobian(ca.vec(features), X)])(x.T).full()
    h = 1e-6
    for i in range(30):
        dx = h * np.eye(30)[i].reshape(5, 6)
        ends = [evaluated(tree, state, 3, q, x + sign * dx)["features"] for sign in (1, -1)]
        difference = (ends[0] - ends[1]).ravel(order="F") / (2 * h)
        np.testing.assert_allclose(J[:, i], difference, atol=1e-7)


def test_functions_are_made_once_per_kind_of_chain() -> None:
    assert chain_function((False, True)) is chain_function((False, True))
    assert chain_function((False, True)) is not chain_function((True, False))
