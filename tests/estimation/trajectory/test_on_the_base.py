"""An SU on a base that swings is turned and placed by its own readings, from far away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import RATE, motion_state, random_state, sampled_trajectory, serial_tree

from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.trajectory.on_the_base import turned_as_the_base
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.skeleton import shift, turn
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.geometry.so3 import rotation_exp, rotation_log
from skin2urdf.signals.filters import second_derivative

_CHAIN = serial_tree(1)
_TREE = replace(_CHAIN, su_names=(*_CHAIN.su_names, "base"), su_joint=np.array([0, -1]))
_UP, _N = np.array([0.0, 0.0, 1.0]), 2500
_LEVER, _PLACE = np.array([0.0, 0.0, 0.5]), np.array([-0.05, 0.08, 0.15])


@pytest.mark.parametrize("degrees", [0.0, 95.0, 180.0, 260.0])
def test_an_su_is_turned_and_placed_whatever_it_begins_with(degrees: float) -> None:
    state = random_state(np.random.default_rng(3), _TREE, 1, 0.3)
    state = replace(state, up=_UP[None], bias=np.zeros((2, 3)), shape=np.zeros((2, 6)))
    R = state.T_joint_su[1, :3, :3]
    time = np.arange(_N) / RATE
    e = np.zeros((_N, 3))
    e[:, 0] = 4e-4 * np.sin(2 * np.pi * 1.9 * time) + 2e-4 * np.sin(2 * np.pi * 3.1 * time)
    e[:, 1] = 3e-4 * np.cos(2 * np.pi * 2.4 * time) + 1e-4 * np.sin(2 * np.pi * 3.7 * time)
    turning = second_derivative(e, RATE)
    felt = 9.81 * _UP - np.cross(e, 9.81 * _UP) + np.cross(turning, _LEVER + _PLACE)
    rng = np.random.default_rng(5)
    read = np.stack([np.tile(_UP * 9.81, (_N, 1)), felt @ R], axis=1)
    log = sampled_trajectory(np.zeros((_N, 1)), read + 7e-3 * rng.standard_normal(read.shape))
    # Encoders' positions are low-passed once, and so is what is beyond them.
    swing = np.hstack([e, np.cross(e, _LEVER)])
    joint = [*(turn(_TREE, i) for i in range(3)), *(shift(_TREE, i) for i in range(3))]
    unseen = Unseen(np.array(joint), (swing,), number=np.zeros(6, dtype=np.int64))
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    problem = MotionProblem(_TREE, [log], replace(priors, unseen=np.ones(1)), unseen=unseen)
    T = np.array(state.T_joint_su)
    T[1, :3, :3] = rotation_exp(np.radians(degrees) * _UP) @ R
    T[1, :3, 3] = 0.0 if degrees < 180.0 else -2 * _LEVER - _PLACE
    begin = motion_state(replace(state, T_joint_su=T), np.ones(1))
    found = turned_as_the_base(problem, begin, 2.0).placements.T_joint_su[1]
    assert np.linalg.norm(rotation_log(found[:3, :3].T @ R)) < 0.06
    np.testing.assert_allclose(found[:3, 3], _PLACE, atol=0.05)
