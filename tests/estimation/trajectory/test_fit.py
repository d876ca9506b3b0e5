"""Fits of all samples: exact derivatives, starts from afar, sensors, and honest uncertainty."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from synthetic import RATE, random_state, sampled_trajectory, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.fit import fit, independent
from skin2urdf.estimation.trajectory.front_end import droop as front_droop
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.trajectory import Trajectory

_TREE = serial_tree(3)
_NOISE = 2e-3


@cache
def _truth() -> State:
    state = random_state(np.random.default_rng(3), _TREE, 1, 0.3)
    up = np.array([[0.0, 0.0, 1.0]])
    return replace(state, up=up)


def _trajectory(
    rng: np.random.Generator, *, pole: float = 0.0, drift: float = 0.0, late: float = 0.0
) -> Trajectory:
    """Sixty seconds of smooth motion of all joints at once, read by noisy sensors.

    Args:
        rng: of motion and noise.
        pole: time constant of the sensors' low-pass [s].
        drift: change of all biases from begin to end [m/s^2].
        late: lag of the sensors' clocks [s].
    """
    n = 7500
    t = np.arange(n) / RATE
    rates = rng.uniform(0.3, 2.5, (6, 3)) * 2 * np.pi
    size = rng.uniform(0.1, 0.5, (6, 3)) * 3 / rates
    phases = rng.uniform(0, 6, (6, 3))

    def positions(at: F64) -> F64:
        return (size * np.sin(rates * at[:, None, None] + phases)).sum(axis=1)

    truth = _truth()
    fine = np.arange(-50, 4 * n + 50) / (4 * RATE) - late
    q = positions(fine)
    qd = np.gradient(q, fine, axis=0)
    qdd = np.gradient(qd, fine, axis=0)
    ideal = specific_forces(truth.model(_TREE), q, qd, qdd, 9.81 * truth.up[0])
    if pole:
        share = 1 - np.exp(-(fine[1] - fine[0]) / pole)
        slow = ideal.copy()
        for i in range(1, len(slow)):
            slow[i] = slow[i - 1] + share * (0.5 * (ideal[i] + ideal[i - 1]) - slow[i - 1])
        ideal = slow
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal)[50:-50:4] + truth.bias
    read = read + drift * (t / t[-1])[:, None, None]
    read = read + _NOISE / 0.3 * rng.standard_normal(read.shape)
    return sampled_trajectory(positions(t), read)


def _fit(
    log: Trajectory, start: State, droop: float = 6e-5, look_further: bool = True
) -> MotionEstimate:
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.full(2, droop)))
    return estimate_along([log], _TREE, start, priors, np.zeros(3), look_further=look_further)


def _from_afar(rng: np.random.Generator) -> State:
    """All offsets zero, every orientation off by 5 deg, sensors perfect."""
    state = _truth()

    def turned(T: F64) -> F64:
        axis = rng.standard_normal((len(T), 3))
        axis *= np.deg2rad(5.0) / np.linalg.norm(axis, axis=1, keepdims=True)
        out = T.copy()
        out[:, :3, 3] = 0.0
        out[:, :3, :3] = T[:, :3, :3] @ rotation_exp(axis)
        return out

    return replace(
        state,
        T_parent_joint=turned(state.T_parent_joint),
        T_joint_su=turned(state.T_joint_su),
        bias=np.zeros((3, 3)),
        shape=np.zeros((3, 6)),
    )


def _reading_errors(found: State) -> float:
    """Largest error of what SUs read along another motion, which no choice of frames changes."""
    q = np.random.default_rng(9).uniform(-1, 1, (40, 3))
    qd, qdd = 2 * q[::-1], 10 * q[:, ::-1]
    up = 9.81 * np.array([0.0, 0.0, 1.0])
    both = [
        np.einsum(
            "uij,kuj->kui", s.sensor_matrix(), specific_forces(s.model(_TREE), q, qd, qdd, up)
        )
        + s.bias
        for s in (found, _truth())
    ]
    return float(np.abs(both[0] - both[1]).max())


def test_equations_hold_the_gradient_of_chi_squared() -> None:
    rng = np.random.default_rng(0)
    log = _trajectory(rng)
    priors = motion_priors(Priors(), gravity=0.02, front=(np.zeros(2), np.full(2, 6e-5)))
    problem = MotionProblem(_TREE, [log], replace(priors, bias_walk=1e-3), [4])
    state = MotionState(
        placements=_from_afar(rng),
        gravity=9.8,
        front=1e-5 * rng.uniform(1, 3, (3, 2)),
        clock=1e-3 * rng.standard_normal((1, 3, 2)) * [1.0, 0.02],
        knots=(0.01 * rng.standard_normal((4, 3, 3)),),
        unseen=np.zeros(0),
    )
    weights = [np.full((*log.valid.shape, 3), 1e4)]

    def chi2(at: MotionState) -> float:
        residual = problem.predict(at, 0).residual
        return float((weights[0] * residual**2).sum()) + problem.prior_chi2(at)

    equations = problem.equations(state, [problem.predict(state, 0)], weights)
    layout = problem.layout
    for _ in range(8):
        joint = np.where(problem.free_joint, rng.standard_normal(layout.n_joint), 0.0)
        sus = np.where(problem.free_su, rng.standard_normal((3, layout.n_su)), 0.0)
        sus[:, layout.front] *= 1e-4
        sus[:, layout.clock(0)] *= [1e-2, 1e-3]
        expected = -2 * (joint @ equations.joint_gradient + (sus * equations.su_gradient).sum())
        h = 1e-6
        ahead = chi2(layout.moved(state, h * joint, h * sus))
        behind = chi2(layout.moved(state, -h * joint, -h * sus))
        # Columns are not low-passed once more, residuals are: what that changes is small.
        assert (ahead - behind) / (2 * h) == pytest.approx(expected, rel=2e-2)


def test_a_start_with_all_offsets_zero_leads_to_the_optimum() -> None:
    rng = np.random.default_rng(1)
    log = _trajectory(rng)
    far, near = _fit(log, _from_afar(rng)), _fit(log, _truth())
    # Chi-squared is over the noise that each fit leaves, which is what must agree.
    np.testing.assert_allclose(far.fitted.noise[0], near.fitted.noise[0], rtol=1e-2)
    assert _reading_errors(far.state) < 1.1 * _reading_errors(near.state)
    assert far.misfit < 1.5


def test_a_slow_sensor_is_recognised_and_costs_no_lever_arm() -> None:
    rng = np.random.default_rng(2)
    pole = 1 / (2 * np.pi * 21.0)
    log = _trajectory(rng, pole=pole, late=0.02)
    # Slack, which nothing but a slow sensor asks for here, leaves the lever arms as wrong.
    known, blind = _fit(log, _truth()), _fit(log, _truth(), droop=0.0, look_further=False)
    np.testing.assert_allclose(front_droop(known.fitted.state.front), pole**2 / 2, rtol=0.4)
    np.testing.assert_allclose(known.fitted.state.clock[0, :, 0], 0.02 + pole, atol=1e-4)
    assert _reading_errors(known.state) < 0.5 * _reading_errors(blind.state)


def test_a_bias_that_drifts_is_followed() -> None:
    rng = np.random.default_rng(4)
    sound, drifting = (_fit(_trajectory(rng, drift=d), _truth()) for d in (0.0, 0.05))
    assert not sound.drifts.any()
    np.testing.assert_allclose(drifting.drifts, 0.05, rtol=0.3)
    assert drifting.misfit < 1.5


def test_no_motion_of_revolute_joints_tells_the_size_of_gravity() -> None:
    log = _trajectory(np.random.default_rng(5))
    unsure = motion_priors(Priors(), gravity=0.0981, front=(np.zeros(2), np.zeros(2)))
    found = estimate_along([log], _TREE, _truth(), unsure, np.zeros(3)).information
    equations = found.equations
    J, n = len(equations.joint), 15
    whole = np.zeros((J + 3 * n + 1, J + 3 * n + 1))
    whole[:J, :J], whole[-1, -1] = equations.joint, found.shared[0, 0]
    whole[-1, :J] = whole[:J, -1] = found.shared_joint[0]
    for u, columns in enumerate(equations.columns):
        at = slice(J + n * u, J + n * (u + 1))
        whole[at, at] = equations.su[u]
        np.add.at(whole[at].T, columns, equations.mixed[u].T)
        whole[:J, at] = whole[at, :J].T
        whole[at, -1] = whole[-1, at] = found.shared_su[u, :, 0]
    # What is left of gravity's information when all else may follow is what was known before.
    rest = whole[:-1, :-1] + 1e-3 * np.eye(len(whole) - 1)
    left = whole[-1, -1] - whole[-1, :-1] @ np.linalg.solve(rest, whole[:-1, -1])
    assert left == pytest.approx(0.01**-2, rel=0.05)


def test_a_part_of_the_samples_is_predicted_as_all_are() -> None:
    """The low-pass of a sensor is that of all samples, however few of them are compared."""
    rng = np.random.default_rng(4)
    log = _trajectory(rng, pole=0.01)
    priors = motion_priors(Priors(), gravity=0.02, front=(np.zeros(2), np.full(2, 6e-5)))
    whole, part = (MotionProblem(_TREE, [each], priors) for each in (log, log.thinned(3)))
    state = MotionState(
        placements=_truth(),
        gravity=9.81,
        front=np.full((3, 2), 5e-5),
        clock=np.zeros((1, 3, 2)),
        knots=(np.zeros((0, 3, 3)),),
        unseen=np.zeros(0),
    )
    assert len(part.logs[0].kept) == -(-len(log.kept) // 3)
    for of_all, of_part in zip(
        (whole.predict(state, 0).residual, log.time, log.valid),
        (part.predict(state, 0).residual, part.logs[0].time, part.logs[0].valid),
        strict=True,
    ):
        np.testing.assert_allclose(of_part, of_all[::3], atol=1e-12)


def test_sensors_are_fitted_again_behind_their_front_ends() -> None:
    """What is left of readings is changed in place, to what sensors that droop leave of it."""
    log = _trajectory(np.random.default_rng(4), pole=0.02)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.full(2, 1e-3)))
    problem = MotionProblem(_TREE, [log], priors)
    state = MotionState(
        placements=replace(_truth(), bias=np.zeros((3, 3)), shape=np.zeros((3, 6))),
        gravity=9.81,
        front=np.full((3, 2), [4e-4, 0.0]),
        clock=np.full((1, 3, 2), [0.02, 0.0]),
        knots=(np.zeros((0, 3, 3)),),
        unseen=np.zeros(0),
    )
    left = problem.predict(state, 0)
    weight = np.where(left.measured[..., None], 1e4, 0.0) * np.ones(3)
    before = float((weight * left.residual**2).sum())
    found = problem.refit_sensors(state, (left,), [weight], problem.free_su)
    after = problem.predict(found, 0).residual
    np.testing.assert_allclose(left.residual, after, atol=1e-9)
    assert (weight * after**2).sum() < 0.05 * before


def test_samples_are_left_out_only_where_they_are_very_many() -> None:
    log = replace(_trajectory(np.random.default_rng(1)), independence=0.6)
    assert independent([log]) == [log]
    most = 3 * log.valid.size
    assert independent([log], most) == [log]
    few = independent([log], most - 1)[0]
    assert (few.thin, few.independence) == (2, 1.0)
    np.testing.assert_array_equal(few.kept, log.kept[::2])
    # Where each tells something of its own, all stay.
    assert independent([replace(log, independence=0.8)], most - 1)[0].thin == 1


def test_a_fit_goes_on_while_clocks_do() -> None:
    found = _fit(_trajectory(np.random.default_rng(6), pole=0.004), _truth())
    at = found.fitted.state
    late = replace(at, clock=at.clock + np.array([0.03, 0.0]))
    # Placements are where they belong, and the first step is as short as the last may be.
    again = fit(found.problem, late, near=True, tolerance=30.0)
    assert again.chi2 < found.fitted.chi2 + 100.0
    np.testing.assert_allclose(again.state.clock[0, :, 0], at.clock[0, :, 0], atol=1e-4)
