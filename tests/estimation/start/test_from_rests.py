"""Orientations from gravity alone, as a state to start from."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.estimation.start.from_rests import state_of
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.structure.from_motion import MotionTree
from skin2urdf.structure.records import KinematicTree


def test_the_state_has_the_directions_of_the_tree_and_no_offsets() -> None:
    rng = np.random.default_rng(0)
    tree = KinematicTree(
        ("a", "b"), np.array([-1, 0]), ("revolute", "revolute"), ("s", "t"), np.array([0, 1])
    )
    axes = rng.standard_normal((2, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    R = rotation_exp(rng.standard_normal((2, 3)))
    sensor = rng.standard_normal((2, 9)) * 0.01
    up = np.array([[0.0, 0.0, 1.0]])
    found = MotionTree(tree, axes, R, up, sensor[:, :3], sensor[:, 3:], np.ones(2), np.ones(2))
    state = state_of(found)
    first, second = state.T_parent_joint
    T_base_joint = np.array([first, first @ second])
    T_base_su = T_base_joint @ state.T_joint_su
    assert T_base_joint[:, :3, 2] == pytest.approx(axes)
    assert T_base_su[:, :3, :3] == pytest.approx(R)
    assert T_base_su[:, :3, 3] == pytest.approx(np.zeros((2, 3)))
    assert state.bias == pytest.approx(sensor[:, :3])
