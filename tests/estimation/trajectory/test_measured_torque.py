"""Joints that yield under torques that the log holds: stiffness and places, whatever efforts hold.

Torques and readings are Pinocchio's, of links with inertias that the estimator knows nothing of.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from synthetic import RATE, random_state, reading_errors, sampled_trajectory, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory import known_torque, measured_torque
from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.model.kinematics import to_pinocchio
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import filtered

_N = 3000
_TREE = serial_tree(2)
_UP = np.array([0.0, 0.0, 1.0])
_STIFF = np.array([7000.0, 3500.0])
_NOISE = 7e-3
_SMALL = 0.025
"""Error of readings [m/s^2]: logs of such motion have 0.015 to 0.022 where torques are not told,
and 0.058 and more where gears are taken for rigid."""


@cache
def _truth() -> State:
    return replace(random_state(np.random.default_rng(3), _TREE, 1, 0.3), up=_UP[None])


@cache
def _motion() -> tuple[F64, F64, F64]:
    """Twenty-four seconds of links that wander, and swing at 2 to 3 Hz."""
    rng = np.random.default_rng(1)
    t = np.arange(_N)[:, None, None] / RATE
    slow, fast = rng.uniform(0.2, 0.6, (2, 2)), rng.uniform(2.0, 3.0, (4, 2))
    w = np.concatenate([slow, fast]) * 2 * np.pi
    speeds = np.concatenate([rng.uniform(0.6, 1.0, (2, 2)), rng.uniform(0.35, 0.7, (4, 2))])
    size, phase = speeds / w, w * t + rng.uniform(0, 6, (6, 2))
    q, qd, qdd = size * np.sin(phase), size * w * np.cos(phase), -size * w**2 * np.sin(phase)
    return q.sum(axis=1), qd.sum(axis=1), qdd.sum(axis=1)


@cache
def _torques() -> F64:
    """(N, 2) torques of a robot of 20 and 8 kg [N m]."""
    model = to_pinocchio(_truth().model(_TREE))
    for joint, mass, lever in ((1, 20.0, (0.2, 0.1, 0.1)), (2, 8.0, (0.3, 0.1, -0.1))):
        model.inertias[joint] = pin.Inertia(mass, np.array(lever), 0.02 * mass * np.eye(3))
    data = model.createData()
    return np.array([pin.rnea(model, data, *x).copy() for x in zip(*_motion(), strict=True)])


def _found(effort: F64, noise: float = _NOISE, stiff: F64 = _STIFF) -> MotionEstimate:
    """An estimate from motors' positions, readings, and efforts (N, 2)."""
    rng = np.random.default_rng(5)
    q, qd, qdd = _motion()
    truth = _truth()
    ideal = specific_forces(truth.model(_TREE), q, qd, qdd, 9.81 * _UP)
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
    read = read + noise * rng.standard_normal(read.shape)
    log = sampled_trajectory(q + _torques() / stiff, read)
    log = replace(log, effort=filtered(effort, log.taps))
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    return estimate_along([log], _TREE, truth, priors, np.zeros(2), only_known=True)


def _compliance(found: MotionEstimate) -> tuple[F64, F64]:
    """(2,) compliances [rad/(N m)] and their standard deviations, if weights are right."""
    problem = found.problem
    system = eliminated(found.fitted.equations, problem.free_joint, problem.free_su)
    return found.compliance(joint_inverse(system.schur, problem.free_joint))


def _measured(rng: np.random.Generator, noise: float, friction: float) -> F64:
    """Efforts with white noise, and with friction as parts of the largest torque of each joint."""
    speed, largest = _motion()[1], np.abs(_torques()).max(axis=0)
    rubs = friction * largest * (np.tanh(speed / 0.01) + 0.1 * speed)
    return np.asarray(_torques() + rubs + noise * rng.standard_normal((_N, 2)))


@pytest.mark.parametrize(
    ("sign", "noise", "friction", "part", "off"),
    [(-1, 0.1, 0.0, 0.01, _SMALL), (1, 1.0, 0.0, 0.03, _SMALL), (1, 0.1, 0.2, 0.1, 0.06)],
    ids=["sensors of the load", "noisy", "motors"],
)
def test_stiffness_is_found_and_links_are_where_they_are(
    sign: int, noise: float, friction: float, part: float, off: float
) -> None:
    found = _found(sign * _measured(np.random.default_rng(2), noise, friction))
    assert "elastic" in found.causes
    compliance, deviation = _compliance(found)
    # Efforts of the load are those of the drive with another sign.
    np.testing.assert_allclose(compliance, sign / _STIFF, rtol=part)
    assert (deviation < 0.05 / _STIFF).all()
    assert reading_errors(found.state, _truth(), _TREE) < off


def test_efforts_that_are_no_torques_are_not_used_and_cost_no_fit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def never(*_: object) -> known_torque.Under:
        raise AssertionError("one look is enough")

    monkeypatch.setattr(measured_torque, "fit_under", never)
    rng = np.random.default_rng(4)
    found = _found(np.cumsum(rng.standard_normal((_N, 2)), axis=0))
    assert found.under_known is None
    assert np.isnan(_compliance(found)).all()


def test_products_of_what_links_do_are_no_lengths(monkeypatch: pytest.MonkeyPatch) -> None:
    """Links swing by a fifth more than their motors; what that makes of products is no length."""

    def left() -> float:
        found = _found(_torques(), 1e-4, _STIFF / 2)
        return float(np.sqrt(np.mean(found.fitted.predicted[0].residual ** 2)))

    with_products = left()
    monkeypatch.setattr(
        known_torque, "fit_with_products", lambda problem, fitted, _: (problem, fitted)
    )
    assert with_products < 0.3 * left()
