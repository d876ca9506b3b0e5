"""Joints that yield under load are found from the readings alone, and cost the robot nothing.

Deflections come from Pinocchio's inverse dynamics of a robot with inertias, which the estimator
knows nothing of.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from synthetic import (
    RATE,
    motion_state,
    random_state,
    reading_errors,
    sampled_trajectory,
    serial_tree,
    stays,
)

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory import attempt
from skin2urdf.estimation.trajectory.attempt import EXPLAINED, Attempt
from skin2urdf.estimation.trajectory.balance import bending, followed
from skin2urdf.estimation.trajectory.bending import Bending
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import CERTAIN
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.model.kinematics import to_pinocchio
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import first_derivative, second_derivative
from skin2urdf.signals.trajectory import Trajectory

_N = 5000
_TREE = serial_tree(2)
_UP = np.array([0.0, 0.0, 1.0])
_SOFT = np.array([1 / 14_000, 1 / 7_000])


@cache
def _truth() -> State:
    state = random_state(np.random.default_rng(3), _TREE, 1, 0.3)
    return replace(state, up=_UP[None])


def _torques(q: F64, qd: F64, qdd: F64) -> F64:
    """(N, 2) torques of a robot of 20 and 8 kg [N m]."""
    model = to_pinocchio(_truth().model(_TREE))
    for joint, mass, lever in ((1, 20.0, (0.2, 0.1, 0.1)), (2, 8.0, (0.3, 0.1, -0.1))):
        model.inertias[joint] = pin.Inertia(mass, np.array(lever), 0.02 * mass * np.eye(3))
    data = model.createData()
    return np.array([pin.rnea(model, data, *x).copy() for x in zip(q, qd, qdd, strict=True)])


def _trajectory(
    rng: np.random.Generator,
    compliance: F64,
    lag: float = 0.0,
    swings: tuple[float, float] | None = None,
) -> Trajectory:
    """Forty seconds of smooth motion of links, and the positions of the motors that make it.

    Args:
        rng: of motion and noise.
        compliance: (2,) of the gears [rad/(N m)].
        lag: damping of the gears over their stiffness [s].
        swings: least and highest frequency [Hz] of patterns beside slow motion; None without any.
    """
    t = np.arange(_N) / RATE
    if swings is None:
        rates = rng.uniform(0.2, 1.2, (6, 2)) * 2 * np.pi
        waves = rng.uniform(0.3, 0.5, (6, 2)) * 2 / rates
    else:
        slow, fast = rng.uniform(0.2, 0.6, (2, 2)), rng.uniform(*swings, (4, 2))
        rates = np.concatenate([slow, fast]) * 2 * np.pi
        speeds = rng.uniform(0.6, 1.0, (2, 2)), rng.uniform(0.35, 0.7, (4, 2))
        waves = np.concatenate(speeds) / rates
    phase = rates * t[:, None, None] + rng.uniform(0, 6, (6, 2))
    q = (waves * np.sin(phase)).sum(axis=1)
    qd = (waves * rates * np.cos(phase)).sum(axis=1)
    qdd = -(waves * rates**2 * np.sin(phase)).sum(axis=1)
    truth = _truth()
    torque = _torques(q, qd, qdd)
    deflection = compliance * np.stack([np.interp(t - lag, t, x) for x in torque.T], axis=1)
    ideal = specific_forces(truth.model(_TREE), q, qd, qdd, 9.81 * _UP)
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
    read = read + 7e-3 * rng.standard_normal(read.shape)
    # Nobody knows how the gears swung when the log begins.
    return sampled_trajectory(q + deflection, read).without_first(4.0)


def _from_place_to_place(compliance: F64, gap: float, step: float = 1e-9) -> Trajectory:
    """Forty seconds between sixteen places, with gears that yield and have play [rad].

    Encoders have steps [rad].
    """
    rng = np.random.default_rng(4)
    q = stays(rng.uniform(-1.5, 1.5, (16, 2)), 130, 170)
    qd, qdd = first_derivative(q, RATE), second_derivative(q, RATE)
    torque = _torques(q, qd, qdd)
    # A link takes a moment to fall across its gap.
    side = np.tanh(torque / (0.2 * torque.std(axis=0)))
    truth = _truth()
    ideal = specific_forces(truth.model(_TREE), q, qd, qdd, 9.81 * _UP)
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
    read = read + 7e-3 * rng.standard_normal(read.shape)
    motors = q + compliance * torque + 0.5 * gap * side
    return sampled_trajectory(np.round(motors / step) * step, read, still_below=1e-3)


def _fit(log: Trajectory) -> MotionEstimate:
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    return estimate_along([log], _TREE, _truth(), priors, np.zeros(2))


def test_joints_that_yield_are_followed() -> None:
    stiff, soft = (
        _fit(_trajectory(np.random.default_rng(1), c, 2e-3)) for c in (0.0 * _SOFT, _SOFT)
    )
    assert not stiff.deflections.any()
    assert not soft.drifts.any()
    assert soft.misfit < 1.5
    assert soft.causes == ("elastic",)
    bends = soft.problem.unseen
    assert isinstance(bends, Bending)
    near, far = np.diag(bends.compliance)
    assert far / near == pytest.approx(2.0, rel=0.05)
    np.testing.assert_allclose(soft.deflections, [5.20e-3, 6.24e-3], rtol=0.03)
    # Of a fit with rigid joints they are 0.058 m/s^2; of six such logs they were 0.015 to 0.022.
    assert reading_errors(soft.state, _truth(), _TREE) < 0.025
    for part in (soft.information.shared, soft.information.shared_su):
        assert np.isfinite(part).all()


def test_play_is_told_from_springs() -> None:
    loose, soft = (
        _fit(_from_place_to_place(compliance, gap))
        for compliance, gap in ((0.0 * _SOFT, 2e-3), (_SOFT, 2e-4))
    )
    assert "play" in loose.causes
    assert "elastic" not in loose.causes
    # Each link lies a milliradian off on either side; springs like that bend by 2.2 at most.
    assert (loose.deflections < 1.6e-3).all()
    assert "elastic" in soft.causes
    assert "play" not in soft.causes
    # Beside steps of encoders half as large, a gap is taken for one as well.
    coarse = _fit(_from_place_to_place(0.0 * _SOFT, 3e-3, 1.5e-3))
    assert "play" in coarse.tried
    assert "elastic" not in coarse.tried


def test_springs_that_leave_more_than_noise_are_not_taken_for_play(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What they leave may look like gaps, and be what biases do that drift."""
    monkeypatch.setattr(attempt, "deflections_saturate", lambda *_: True)
    log = _from_place_to_place(_SOFT, 0.0)
    drifts = np.linspace(-0.02, 0.02, len(log.readings))[:, None, None]
    found = _fit(replace(log, readings=log.readings + drifts * np.array([1.0, -0.5, 0.7])))
    assert found.tried["play"] > EXPLAINED
    assert set(found.causes) == {"elastic", "drift"}
    assert found.misfit < 1.5


def test_gaps_are_followed_from_what_one_look_says_of_loads() -> None:
    """Where slack says more than springs do to first order, these are not followed at all."""
    log = _from_place_to_place(0.0 * _SOFT, 2e-3)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    start = _truth(), priors, np.zeros(2)
    found = estimate_along([log], _TREE, *start, look_further=False)
    rigid = Attempt(found.problem, found.fitted, (), None)
    gaps = rigid.with_gaps()
    assert gaps is not None
    assert gaps.causes == ("play",)
    assert gaps.misfit < 0.5 * rigid.misfit
    assert rigid.few_sizes["play"][1].gain > CERTAIN
    assert "play" not in gaps.few_sizes


def test_what_yields_passes_the_low_pass_as_motion_does() -> None:
    """At 4 to 5 Hz a low-pass of 6 Hz takes off up to a tenth, of deflections no more than that."""
    stiff, soft = (
        _fit(_trajectory(np.random.default_rng(1), c, swings=(4.0, 5.0)))
        for c in (0.0 * _SOFT, _SOFT / 4)
    )
    assert soft.causes == ("elastic",)
    assert reading_errors(soft.state, _truth(), _TREE) < 2 * reading_errors(
        stiff.state, _truth(), _TREE
    )


@pytest.mark.parametrize("base", [False, True])
def test_equations_hold_the_gradient_in_what_yields(*, base: bool) -> None:
    rng = np.random.default_rng(2)
    log = _trajectory(rng, _SOFT)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    elastic = bending(_TREE, [log], _truth(), 9.81, joints=True, base=base)
    n = elastic.n_numbers
    x = 1e-3 * rng.standard_normal(n)
    if base:
        x[-9:] = [*[1e-4] * 3, *[3e-5] * 3, 0.05, -0.1, 0.3]
    for _ in range(2):
        elastic, x = followed(elastic, _TREE, [log], _truth(), 9.81, x)
    yielding = replace(priors, unseen=elastic.spread)
    problem = MotionProblem(_TREE, [log], yielding, unseen=elastic)
    state = motion_state(_truth(), x)
    weights = [np.full((*log.valid.shape, 3), 1e4)]

    def chi2(at: MotionState) -> float:
        residual = problem.predict(at, 0).residual
        return float((weights[0] * residual**2).sum()) + problem.prior_chi2(at)

    equations = problem.equations(state, [problem.predict(state, 0)], weights)
    layout, still = problem.layout, np.zeros((2, problem.layout.n_su))
    for i in range(layout.unseen.start, layout.unseen.stop):
        joint = np.zeros(layout.n_joint)
        joint[i] = 1e-6
        slope = (
            chi2(layout.moved(state, joint, still)) - chi2(layout.moved(state, -joint, still))
        ) / 2e-6
        # What low-passes do to the product of a deflection and of slow geometry is small.
        scale = np.sqrt(equations.joint[i, i] * chi2(state))
        assert slope == pytest.approx(-2 * equations.joint_gradient[i], rel=2e-3, abs=5e-4 * scale)
