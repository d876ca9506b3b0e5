"""Specific force along trajectories against Pinocchio, and its derivatives against differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest
from synthetic import random_state, random_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State, local_motion
from skin2urdf.estimation.trajectory.kinematics import (
    Path,
    frame_motions,
    joint_columns,
    placed,
    placement_columns,
    seen_before_joint,
    seen_from_parent,
)
from skin2urdf.model.records import KinematicModel
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.structure.records import KinematicTree

_STEP = 1e-6
_UP = np.array([0.3, -2.0, 9.4])


@dataclass(frozen=True)
class _Case:
    tree: KinematicTree
    state: State
    q: F64
    qd: F64
    qdd: F64


@pytest.fixture(params=range(4))
def case(request: pytest.FixtureRequest) -> _Case:
    rng = np.random.default_rng(request.param)
    tree = random_tree(rng, 5, 4)
    t = np.linspace(0.0, 2.0, 17)
    size = rng.standard_normal((5, 3, 1))
    rate = rng.uniform(1.0, 6.0, (5, 3, 1))
    phase = rate * t + rng.uniform(0.0, 6.0, (5, 3, 1))
    q = (size * np.sin(phase)).sum(axis=1)
    qd = (size * rate * np.cos(phase)).sum(axis=1)
    qdd = -(size * rate**2 * np.sin(phase)).sum(axis=1)
    return _Case(tree, random_state(rng, tree, 1, 0.0), q, qd, qdd)


def _read(case: _Case, T_parent_joint: F64, T_joint_su: F64, q: F64, qd: F64, qdd: F64) -> F64:
    model = KinematicModel(case.tree, T_parent_joint, T_joint_su)
    return specific_forces(model, q.T, qd.T, qdd.T, _UP)


def test_frames_feel_what_pinocchio_says(case: _Case) -> None:
    tree, state = case.tree, case.state
    model = pin.Model()
    ids = []
    for j, parent in enumerate(tree.parent):
        joint = pin.JointModelPZ() if tree.prismatic[j] else pin.JointModelRZ()
        T = state.T_parent_joint[j]
        before = 0 if parent < 0 else ids[parent]
        ids.append(model.addJoint(before, joint, pin.SE3(T[:3, :3], T[:3, 3]), f"j{j}"))
    data = model.createData()
    _, carried = frame_motions(tree, state.T_parent_joint, _UP, case.q, case.qd, case.qdd)
    for k in range(case.q.shape[1]):
        pin.forwardKinematics(model, data, case.q[:, k], case.qd[:, k], case.qdd[:, k])
        for j in range(tree.n_joints):
            felt = pin.getClassicalAcceleration(model, data, ids[j], pin.LOCAL).linear
            felt = felt + data.oMi[ids[j]].rotation.T @ _UP
            np.testing.assert_allclose(carried[j].f[:, k], felt, atol=1e-9)


def test_columns_are_the_derivatives(case: _Case) -> None:
    tree, state = case.tree, case.state
    places = state.T_parent_joint, state.T_joint_su
    motion = case.q, case.qd, case.qdd
    here = _read(case, *places, *motion)
    fixed, carried = frame_motions(tree, state.T_parent_joint, _UP, *motion)
    still = np.zeros((3, case.q.shape[1]))
    for u, joint in enumerate(tree.su_joint):
        T = state.T_joint_su[u]
        turn = np.repeat(T[:3, :3, None], still.shape[1], axis=2)
        own = Path(still, still, still, np.repeat(np.eye(3)[:, :, None], still.shape[1], axis=2))
        columns = placement_columns(placed(carried[joint], T), own, tuple(range(6)))
        for i, column in enumerate(columns):
            moved = state.T_joint_su.copy()
            moved[u] = moved[u] @ _nudge(i)
            _agree(_read(case, places[0], moved, *motion)[:, u] - here[:, u], column)
        path = Path(still + T[:3, 3:4], still, still, turn)
        for k in reversed(tree.chain(int(joint))):
            slides = bool(tree.prismatic[k])
            path = seen_before_joint(path, slides, *(x[k] for x in motion))
            for i, column in enumerate(placement_columns(fixed[k], path, tuple(range(6)))):
                moved = state.T_parent_joint.copy()
                moved[k] = moved[k] @ _nudge(i)
                _agree(_read(case, moved, places[1], *motion)[:, u] - here[:, u], column)
            for i, column in enumerate(joint_columns(fixed[k], path, slides)):
                other = [x.copy() for x in motion]
                other[i][k] += _STEP
                _agree(_read(case, *places, *other)[:, u] - here[:, u], column)
            path = seen_from_parent(path, state.T_parent_joint[k])


def _nudge(axis: int) -> F64:
    return local_motion(_STEP * np.eye(6)[axis])[0]


def _agree(change: F64, column: F64) -> None:
    size = 1.0 + np.abs(column).max()
    np.testing.assert_allclose(change / _STEP, column.T, atol=1e-3 * size)
