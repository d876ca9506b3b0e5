"""Limbs on a base that gives way are turned and placed by what they feel of it together."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
from stand import UP, readings_on_a_stand
from synthetic import motion_state, random_state, sampled_trajectory, stays

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State, Step, identifiable, moved
from skin2urdf.estimation.trajectory.azimuth import turned
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.fit import fit
from skin2urdf.estimation.trajectory.heights import rise
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.on_the_base import limbs_turned_alike
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.uncertainty.observability import Subject, observability_along
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.model.kinematics import to_pinocchio
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_TREE = KinematicTree(
    tuple(f"joint{i}" for i in range(5)),
    np.array([-1, 0, -1, 2, -1]),
    ("revolute",) * 5,
    tuple(f"su{i}" for i in range(5)),
    np.arange(5),
)
_ROOTS = np.array([0, 2, 4])
_BODIES = [
    pin.Inertia(mass, np.array(lever), 0.02 * mass * np.eye(3))
    for mass, lever in (
        (15.0, (0.2, 0.1, 0.1)), (8.0, (0.3, 0.1, -0.1)), (12.0, (-0.1, 0.2, 0.1)),
        (6.0, (0.1, 0.3, 0.2)), (10.0, (0.2, -0.2, 0.1)),
    )
]  # fmt: skip
_TURNS = np.array([0.0, 2.4, -2.0])
"""By how much limbs are turned about gravity where a fit begins [rad]."""


def _truth() -> State:
    state = random_state(np.random.default_rng(3), _TREE, 1, 0.3)
    T = np.array(state.T_parent_joint)
    # The base's frame is on the first axis.
    T[0, :3, 3] = 0.0
    return State(T, state.T_joint_su, UP[None], state.bias, state.shape)


def _begin() -> State:
    """Limbs turned about gravity, with first axes through the origin, as features leave them."""
    truth = _truth()
    T = np.array(truth.T_parent_joint)
    for root, angle in zip(_ROOTS, _TURNS, strict=True):
        T[root, :3, :3] = rotation_exp(angle * UP) @ T[root, :3, :3]
        T[root, :3, 3] = 0.0
    return State(T, truth.T_joint_su, truth.up, truth.bias, truth.shape)


@cache
def _log() -> Trajectory:
    at = np.random.default_rng(1).uniform(-1.5, 1.5, (10, 5))
    q = stays(at, 180, 120)
    read, _ = readings_on_a_stand(_TREE, _truth(), _BODIES, q, 1 / 30_000)
    return sampled_trajectory(q, read + 7e-3 * np.random.default_rng(2).standard_normal(read.shape))


@cache
def _found() -> MotionEstimate:
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    return estimate_along([_log()], _TREE, _begin(), priors, np.zeros(5))


def test_limbs_are_turned_as_they_feel_the_base_tilt() -> None:
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    problem = MotionProblem(_TREE, [_log()], priors)
    still = fit(problem, motion_state(_begin(), np.zeros(0)))
    T = limbs_turned_alike(problem, still, 2.0).placements.T_parent_joint
    true = _truth().T_parent_joint
    axes, others = (each[_ROOTS, :3, 2] @ np.array([1.0, 1.0j, 0.0]) for each in (T, true))
    off = np.angle(axes / others)
    np.testing.assert_allclose(np.angle(np.exp(1j * (off - off[0]))), 0.0, atol=0.3)


def test_a_robot_of_several_limbs_is_followed_on_a_base_that_gives_way() -> None:
    found = _found()
    assert found.causes == ("base",)
    assert found.misfit < 1.5
    truth, state = _truth(), found.state
    # Sensors need no errors that they have not, as far as one joint shows any.
    assert np.abs(state.shape - truth.shape).max() < 0.04
    assert np.abs(state.bias - truth.bias).max() < 0.4


def test_limbs_are_placed_by_the_motion_of_their_base() -> None:
    """Between them as they stand: all may stand elsewhere, and turned about gravity."""
    found, true = _found().state.T_parent_joint, _truth().T_parent_joint
    axes, others = (each[0, :3, 2] @ np.array([1.0, 1.0j, 0.0]) for each in (found, true))
    turn = rotation_exp(np.angle(axes / others) * UP)
    for limb in _ROOTS[1:]:
        line = found[limb, :3, 2]
        off = turn @ true[limb, :3, 3] - found[limb, :3, 3]
        # How far along its axis the frame of a joint is, is a choice; so is how high the base is.
        across = np.cross(line, off)
        assert abs(across @ np.cross(line, UP)) < 0.1


def test_what_is_stated_of_axes_covers_their_errors() -> None:
    found, truth = _found(), _truth()
    free = identifiable(_TREE, 1)
    subject = Subject(_TREE, found.state, free, np.zeros((1, 5)), Priors(), Priors())
    seen = observability_along(subject, found.information)
    for j in (1, 3):
        off = np.subtract(*(_between_axes(s.T_parent_joint[j]) for s in (found.state, truth)))
        stated = np.sqrt(np.trace(seen.joint_covariance[j][:2, :2]))
        assert abs(off) < 3 * stated


def _between_axes(T: F64) -> float:
    """Distance between the axis of a joint and that of its parent [m]."""
    across = np.cross([0.0, 0.0, 1.0], T[:3, 2])
    return float(abs(across @ T[:3, 3]) / np.linalg.norm(across))


def test_all_limbs_rise_and_turn_together() -> None:
    state = _truth()
    joints, sus = rise(_TREE, state)
    about, swung = turned(_TREE, state, UP)
    places: list[F64] = []
    far, angle = 0.2, 1e-5
    raised, rotated = np.zeros((2, 5, 15))
    raised[:, :3], rotated[:, :6] = far * sus, angle * swung
    none = np.zeros((0, 2))
    after = (
        state, moved(state, Step(far * joints, none, raised)),
        moved(state, Step(angle * about, none, rotated)),
    )  # fmt: skip
    q = np.random.default_rng(4).uniform(-1.0, 1.0, 5)
    for each in after:
        model = to_pinocchio(each.model(_TREE))
        data = model.createData()
        pin.framesForwardKinematics(model, data, q)
        places.append(
            np.array([data.oMf[model.getFrameId(su)].translation for su in _TREE.su_names])
        )
    up = places[1] - places[0]
    np.testing.assert_allclose(up, np.tile(up[0], (5, 1)), atol=1e-9)
    assert np.linalg.norm(up[0]) > far / 3
    np.testing.assert_allclose(places[2], places[0] @ rotation_exp(angle * UP).T, atol=1e-9)
