"""Swings of a few hertz about all joints at once: what readings hold are products of these.

Motions and readings are Pinocchio's, with derivatives in closed form.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from stand import UP
from synthetic import CUTOFF, RATE, motion_state, random_state, sampled_trajectory, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.fit import held
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import with_products
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.model.kinematics import to_pinocchio
from skin2urdf.signals.filters import filtered

_TREE = serial_tree(3)
_SECONDS = 40.0


def _truth() -> State:
    return replace(random_state(np.random.default_rng(3), _TREE, 1, 0.3), up=UP[None])


def _motion() -> tuple[F64, F64, F64]:
    """Three (N, 3): joints that wander by a radian and swing by 0.15 rad at 2 to 3 Hz."""
    t = np.arange(round(_SECONDS * RATE))[:, None, None] / RATE
    w = 2 * np.pi * np.array([[0.11, 0.07, 0.13], [2.1, 2.5, 2.9], [2.7, 2.3, 2.0]])
    size = np.array([[1.0, 0.8, 1.2], [0.15, 0.15, 0.15], [0.1, 0.1, 0.1]])
    a = w * t + np.array([[0.0, 1.0, 2.0], [0.5, 0.1, 0.9], [3.0, 4.0, 5.0]])
    q, qd, qdd = size * np.sin(a), size * w * np.cos(a), -size * w**2 * np.sin(a)
    return q.sum(axis=1), qd.sum(axis=1), qdd.sum(axis=1)


def _read(motion: tuple[F64, F64, F64]) -> tuple[F64, F64]:
    """(N, 3, 3) what accelerometers [m/s^2] and gyroscopes [rad/s] read."""
    truth = _truth()
    model = to_pinocchio(truth.model(_TREE))
    data, frames = model.createData(), [model.getFrameId(name) for name in _TREE.su_names]
    force, rate = np.empty((2, len(motion[0]), 3, 3))
    local = pin.ReferenceFrame.LOCAL
    for n, at in enumerate(zip(*motion, strict=True)):
        pin.forwardKinematics(model, data, *at)
        pin.updateFramePlacements(model, data)
        for u, frame in enumerate(frames):
            a = pin.getFrameClassicalAcceleration(model, data, frame, local)
            force[n, u] = a.linear + data.oMf[frame].rotation.T @ (9.81 * UP)
            rate[n, u] = pin.getFrameVelocity(model, data, frame, local).angular
    return np.einsum("uij,kuj->kui", truth.sensor_matrix(), force) + truth.bias, rate


@cache
def _found(gyros: bool, sampled: bool) -> MotionEstimate:
    """An estimate, with positions as they were sampled or with none but low-passed ones."""
    motion = _motion()
    force, rate = _read(motion)
    log = sampled_trajectory(motion[0], force, rate if gyros else None)
    log = log if sampled else replace(log, positions=np.zeros((0, 0)))
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.full(2, 6e-5)))
    start = replace(_truth(), bias=np.zeros((3, 3)), shape=np.zeros((3, 6)))
    return estimate_along([log], _TREE, start, priors, np.zeros(3), look_further=False)


def _error(found: MotionEstimate) -> float:
    """Of the places of SUs beyond the first joint; one rigid transform aligns all [m]."""
    q, both = np.random.default_rng(6).uniform(-1.0, 1.0, (40, 3)), []
    for state in (_truth(), found.state):
        model = to_pinocchio(state.model(_TREE))
        data, places = model.createData(), []
        for each in q:
            pin.framesForwardKinematics(model, data, each)
            places += [data.oMf[model.getFrameId(n)].translation.copy() for n in _TREE.su_names[1:]]
        both.append(np.array(places) - np.mean(places, axis=0))
    turned = Rotation.align_vectors(both[0], both[1])[0].apply(both[1])
    return float(np.sqrt(((turned - both[0]) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize("gyros", [False, True])
def test_products_of_swings_are_no_lengths(gyros: bool) -> None:
    assert _error(_found(gyros, True)) < 5e-6
    assert _error(_found(gyros, False)) > 5e-5


@pytest.mark.parametrize("gyros", [False, True])
def test_products_of_swings_leave_nothing(gyros: bool) -> None:
    left = [
        np.sqrt(np.mean(_found(gyros, s).fitted.predicted[0].residual ** 2)) for s in (True, False)
    ]
    assert left[0] < 0.05 * left[1]


def test_gyroscopes_feel_products_as_well() -> None:
    left = []
    for sampled in (True, False):
        turned = _found(True, sampled).fitted.predicted[0].turned
        assert turned is not None
        left.append(float(np.sqrt(np.mean(turned.residual**2))))
    assert left[0] < 0.05 * left[1]


def test_what_rings_where_the_low_pass_ends_is_no_product() -> None:
    """Readings of joints that ring at the cutoff while encoders stay are those to first order."""
    t = np.arange(round(8.0 * RATE)) / RATE
    ringing = np.outer(2e-4 * np.sin(2 * np.pi * CUTOFF * t), np.ones(3))
    at_rest = np.tile([0.3, -0.5, 0.8], (len(t), 1))
    log = sampled_trajectory(at_rest, np.zeros((len(t), 3, 3)))
    unseen = Unseen(np.arange(3), (filtered(ringing, log.taps),))
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    priors = replace(priors, unseen=np.ones(3))
    problem = MotionProblem(_TREE, [log], priors, unseen=unseen)
    state = motion_state(_truth(), np.ones(3))
    found = held(problem, state)
    told, predicted = with_products(problem, found)
    still = problem.predict(replace(state, unseen=np.zeros(3)), 0)
    by_ringing = np.abs(found.predicted[0].residual - still.residual).max()
    beyond = told.logs[0].beyond
    assert beyond is not None
    assert np.abs(beyond).max() < 0.01 * by_ringing
    again = told.predict(state, 0).residual
    np.testing.assert_allclose(predicted[0].residual, again, atol=1e-9 * by_ringing)
