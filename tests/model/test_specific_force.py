"""Readings along trajectories against Pinocchio's classical accelerations."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from synthetic import pinocchio_jacobians, pinocchio_model, random_state, random_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.model.specific_force import (
    AroundPose,
    angular_velocities,
    specific_forces,
)
from skin2urdf.structure.records import KinematicTree

UP = np.array([1.2, -0.7, 9.6])


def by_pinocchio(tree: KinematicTree, state: State, q: F64, qd: F64, qdd: F64) -> F64:
    """(N, U, 3) specific forces, sample by sample."""
    model, frames = pinocchio_model(tree, state)
    data = model.createData()
    out = np.zeros((len(q), tree.n_sus, 3))
    for n in range(len(q)):
        pin.forwardKinematics(model, data, q[n], qd[n], qdd[n])
        pin.updateFramePlacements(model, data)
        for u, frame in enumerate(frames):
            a = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL).linear
            out[n, u] = a + data.oMf[frame].rotation.T @ UP
    return out


def beyond(tree: KinematicTree, state: State, pose: F64, *motion: F64) -> F64:
    """(N, U, 3) what perfect sensors read beyond first order."""
    perfect = np.broadcast_to(np.eye(3), (tree.n_sus, 3, 3))
    around = AroundPose.of(state.model(tree), perfect, pose, *motion, UP)
    return around.beyond(np.arange(tree.n_sus))


@pytest.fixture(scope="module", params=range(4))
def robot(request: pytest.FixtureRequest) -> tuple[KinematicTree, State]:
    """Branching trees with prismatic joints and an SU on the base."""
    rng = np.random.default_rng(request.param)
    tree = random_tree(rng, 6, 6, prismatic=0.35)
    return tree, random_state(rng, tree)


def test_readings_are_those_of_rigid_bodies(robot: tuple[KinematicTree, State]) -> None:
    tree, state = robot
    rng = np.random.default_rng(9)
    q, qd, qdd = (s * rng.standard_normal((40, tree.n_joints)) for s in (1.5, 2.0, 10.0))
    found = specific_forces(state.model(tree), q, qd, qdd, UP)
    np.testing.assert_allclose(found, by_pinocchio(tree, state, q, qd, qdd), atol=1e-10)


def test_rates_are_the_angular_columns_of_jacobians(robot: tuple[KinematicTree, State]) -> None:
    tree, state = robot
    rng = np.random.default_rng(9)
    q, qd = (s * rng.standard_normal((40, tree.n_joints)) for s in (1.5, 2.0))
    _, w, _ = pinocchio_jacobians(tree, state, q)
    expected = np.einsum("nudi,nd->nui", w, qd)
    found = angular_velocities(state.model(tree), q, qd)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_the_rest_is_what_first_order_leaves(robot: tuple[KinematicTree, State]) -> None:
    """Readings less gravity, its turning by the Jacobian's angular part, and the lever arms."""
    tree, state = robot
    rng = np.random.default_rng(8)
    pose = rng.standard_normal(tree.n_joints)
    dq, qd, qdd = (s * rng.standard_normal((30, tree.n_joints)) for s in (0.2, 1.0, 8.0))
    R, w, v = (x[0] for x in pinocchio_jacobians(tree, state, pose[None]))
    f0 = UP @ R
    s = np.cross(f0[:, None], w)
    linear = f0 + np.einsum("nd,udi->nui", dq, s) + np.einsum("nd,udi->nui", qdd, v)
    expected = by_pinocchio(tree, state, pose + dq, qd, qdd) - linear
    found = beyond(tree, state, pose, dq, qd, qdd)
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_nothing_is_left_at_rest_in_the_pose(robot: tuple[KinematicTree, State]) -> None:
    tree, state = robot
    pose, zero = np.full(tree.n_joints, 0.4), np.zeros((3, tree.n_joints))
    np.testing.assert_allclose(beyond(tree, state, pose, zero, zero, zero), 0.0, atol=1e-12)


def test_what_is_left_is_of_second_order(robot: tuple[KinematicTree, State]) -> None:
    tree, state = robot
    rng = np.random.default_rng(7)
    pose = rng.standard_normal(tree.n_joints)
    motion = [rng.standard_normal((20, tree.n_joints)) for _ in range(3)]

    def size(scale: float) -> float:
        rest = beyond(tree, state, pose, *(scale * x for x in motion))
        return float(np.linalg.norm(rest))

    assert size(1e-3) / size(5e-4) == pytest.approx(4.0, rel=0.02)


def test_imperfect_sensors_read_what_they_make_of_it(robot: tuple[KinematicTree, State]) -> None:
    tree, state = robot
    rng = np.random.default_rng(6)
    sensors = np.eye(3) + 0.1 * rng.standard_normal((tree.n_sus, 3, 3))
    pose, some = rng.standard_normal(tree.n_joints), np.array([3, 0, 4])
    motion = [rng.standard_normal((20, tree.n_joints)) for _ in range(3)]
    around = AroundPose.of(state.model(tree), sensors, pose, *motion, UP)
    ideal = beyond(tree, state, pose, *motion)[:, some]
    expected = np.einsum("uij,nuj->nui", sensors[some], ideal)
    np.testing.assert_allclose(around.beyond(some), expected, atol=1e-10)


def test_a_pendulum_feels_its_textbook_forces() -> None:
    """One joint about x, an SU at distance r: centripetal along the rod, tangential across."""
    tree = KinematicTree(
        ("swing",), np.array([-1]), ("revolute",), ("bob", "hook"), np.array([0, -1])
    )
    r, g = 0.7, 9.81
    T_joint = np.eye(4)
    T_su = np.tile(np.eye(4), (2, 1, 1))
    T_su[0, 0, 3] = r
    state = State(T_joint[None], T_su, np.array([[0, 1.0, 0]]), np.zeros((2, 3)), np.zeros((2, 6)))
    q, qd, qdd = (np.array([[x]]) for x in (0.3, 2.0, -5.0))
    up = np.array([0.0, g, 0.0])
    found = specific_forces(state.model(tree), q, qd, qdd, up)[0]
    np.testing.assert_allclose(
        found[0], [-r * 4.0 + g * np.sin(0.3), r * -5.0 + g * np.cos(0.3), 0.0], atol=1e-12
    )
    np.testing.assert_allclose(found[1], up)
