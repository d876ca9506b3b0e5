"""Gyroscopes in the fit of all samples."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from synthetic import RATE, random_state, sampled_trajectory, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.model.specific_force import angular_velocities, specific_forces
from skin2urdf.signals.trajectory import Trajectory

_TREE = serial_tree(3)
_ACCELERATION, _TURN = 5e-3, 2e-3
"""Noise of a sample [m/s^2, rad/s]."""
_BIAS = np.array([0.01, -0.02, 0.005])
_MATRIX = np.array([[1.01, 0.004, -0.006], [0.003, 0.992, 0.005], [-0.004, 0.007, 1.004]])


def _truth() -> State:
    state = random_state(np.random.default_rng(3), _TREE, 1, 0.3)
    return replace(state, up=np.array([[0.0, 0.0, 1.0]]))


def _motion(rng: np.random.Generator, t: F64, late: float = 0.0) -> tuple[F64, F64, F64]:
    """Smooth motion of all joints at once, and its derivatives."""
    w = rng.uniform(0.2, 1.2, (6, 3)) * 2 * np.pi
    size, phase = rng.uniform(0.1, 0.5, (6, 3)) * 2 / w, rng.uniform(0, 6, (6, 3))
    a = w * (t - late)[:, None, None] + phase
    q, qd, qdd = size * np.sin(a), size * w * np.cos(a), -size * w**2 * np.sin(a)
    return q.sum(axis=1), qd.sum(axis=1), qdd.sum(axis=1)


def _log(late: float = 0.0, noise: float = _ACCELERATION) -> Trajectory:
    """Forty seconds of motion, felt by noisy accelerometers and gyroscopes on one clock."""
    n = 5000
    t, rng = np.arange(n) / RATE, np.random.default_rng(1)
    truth = _truth()
    q, qd, qdd = _motion(np.random.default_rng(0), t, late)
    model = truth.model(_TREE)
    force = specific_forces(model, q, qd, qdd, 9.81 * truth.up[0])
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), force) + truth.bias
    read += noise * rng.standard_normal(read.shape)
    turn = angular_velocities(model, q, qd) @ _MATRIX.T + _BIAS
    turn += _TURN * rng.standard_normal(turn.shape)
    return sampled_trajectory(_motion(np.random.default_rng(0), t)[0], read, turn)


def _fit(log: Trajectory) -> MotionEstimate:
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.full(2, 6e-5)))
    start = replace(_truth(), bias=np.zeros((3, 3)), shape=np.zeros((3, 6)))
    return estimate_along([log], _TREE, start, priors, np.zeros(3))


def test_a_gyroscope_that_reads_nothing_at_rest_is_not_believed_without_end() -> None:
    """As of chips that set their zero there."""
    n = 5000
    t, rng = np.arange(n) / RATE, np.random.default_rng(1)
    cycle = t % 10 / 10
    swell = np.where(cycle < 0.5, np.sin(np.pi * cycle / 0.5) ** 4, 0.0)
    q = _motion(np.random.default_rng(0), t)[0] * swell[:, None]
    qd = np.gradient(q, 1 / RATE, axis=0)
    truth = _truth()
    model = truth.model(_TREE)
    force = specific_forces(model, q, qd, np.gradient(qd, 1 / RATE, axis=0), 9.81 * truth.up[0])
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), force) + truth.bias
    read += _ACCELERATION * rng.standard_normal(read.shape)
    turn = angular_velocities(model, q, qd) @ _MATRIX.T
    turn += _TURN * rng.standard_normal(turn.shape)
    turn[cycle >= 0.5] = 0.0
    log = sampled_trajectory(q, read, turn)
    moves = np.repeat((cycle < 0.52)[log.kept][:, None], 3, axis=1)
    found = _fit(replace(log, moving=moves))
    assert found.misfit < 1.2
    assert found.gyros is not None
    assert not found.gyros.contradict.any()


@cache
def _found() -> MotionEstimate:
    return _fit(_log(late=4e-3))


def test_gradients_of_rates_are_those_of_chi_squared() -> None:
    rng = np.random.default_rng(0)
    log = _log()
    priors = motion_priors(Priors(), gravity=0.02, front=(np.zeros(2), np.full(2, 6e-5)))
    motions = 0.1 * _motion(rng, np.arange(len(log.q)) / RATE)[0][:, :2]
    unseen = Unseen(np.array([1, 2]), (motions,))
    problem = MotionProblem(_TREE, [log], replace(priors, unseen=np.ones(2)), unseen=unseen)
    layout = problem.layout
    size = np.r_[np.full(9, 0.01), 1e-3, 1e-5, np.full(3, 0.01)]
    state = MotionState(
        placements=_truth(),
        gravity=9.8,
        front=np.zeros((3, 2)),
        clock=1e-3 * rng.standard_normal((1, 3, 2)) * [1.0, 0.02],
        knots=(np.zeros((0, 3, 3)),),
        unseen=0.1 * rng.standard_normal(2),
        gyro=size * rng.standard_normal((3, 14)),
    )
    # Nothing but the rates, so that nothing else hides what is wrong with them.
    weights = [np.zeros((*log.valid.shape, 6))]
    weights[0][..., 3:] = 1e4

    def chi2(at: MotionState) -> float:
        turned = problem.predict(at, 0).turned
        assert turned is not None
        return float((weights[0][..., 3:] * turned.residual**2).sum())

    here = problem.predict(state, 0)
    alone = problem.equations(state, [here], weights)
    nothing = problem.equations(state, [here], [np.zeros_like(weights[0])])
    for _ in range(8):
        joint = np.where(problem.free_joint, rng.standard_normal(layout.n_joint), 0.0)
        sus = np.where(problem.free_su, rng.standard_normal((3, layout.n_su)), 0.0)
        sus[:, layout.clock(0)] *= [1e-2, 1e-3]
        sus[:, layout.gyro] *= size
        gradient = (
            alone.joint_gradient - nothing.joint_gradient,
            (alone.su_gradient - nothing.su_gradient),
        )
        expected = -2 * (joint @ gradient[0] + (sus * gradient[1]).sum())
        h = 1e-6
        ahead = chi2(layout.moved(state, h * joint, h * sus))
        behind = chi2(layout.moved(state, -h * joint, -h * sus))
        # Columns are not low-passed once more, residuals are: what that changes is small.
        np.testing.assert_allclose((ahead - behind) / (2 * h), expected, rtol=0.03)


def test_a_gyroscope_is_found_as_it_is() -> None:
    found = _found().gyros
    assert found is not None
    assert found.used.all()
    assert not found.contradict.any()
    scale = found.scale - (np.diag(_MATRIX) - 1)
    tilt = found.misalignment - _MATRIX[~np.eye(3, dtype=bool)]
    # What turns both sensors of an SU alike is no error of either.
    assert np.abs(scale / found.scale_sd).max() < 5
    assert np.abs(tilt / found.misalignment_sd).max() < 5
    assert np.abs((found.bias - _BIAS) / found.bias_sd).max() < 5
    assert found.bias_sd.max() < 1e-4
    low_passed = _TURN * np.sqrt((np.convolve(_log().taps, _log().taps) ** 2).sum())
    np.testing.assert_allclose(found.noise, low_passed, rtol=0.1)


def test_both_sensors_of_an_su_share_its_clock() -> None:
    fitted = _found().fitted.state
    np.testing.assert_allclose(fitted.clock[0, :, 0], 4e-3, atol=1e-4)
    np.testing.assert_allclose(fitted.gyro[:, 9], 0.0, atol=2e-4)


def test_directions_are_better_known_with_gyroscopes() -> None:
    log = _log(noise=0.1)
    both, deaf = _fit(log), _fit(replace(log, rates=None, turning=None))
    assert deaf.gyros is None
    free = both.problem.free_joint[: 4 * 3].reshape(3, 4)[:, 2:]

    def information(of: MotionEstimate) -> F64:
        return np.diag(of.information.equations.joint)[: 4 * 3].reshape(3, 4)[:, 2:][free]

    # Before the first joint nothing turns, and nothing tells a gyroscope how that is placed.
    assert (information(both) > 3 * information(deaf))[2:].all()


def test_a_gyroscope_of_other_axes_is_left_out() -> None:
    log = _log(late=4e-3)
    assert log.rates is not None
    rates = np.array(log.rates)
    rates[:, 1] = rates[:, 1][:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    found = _fit(replace(log, rates=rates))
    assert found.gyros is not None
    assert found.gyros.contradict.tolist() == [False, True, False]
    assert found.gyros.used.tolist() == [True, False, True]
    q, qd, qdd = _motion(np.random.default_rng(7), np.arange(0.0, 5.0, 0.1))
    # Gravity stands still in the first SU, whose tilt and bias only sums of both show.
    both = [
        np.einsum(
            "uij,kuj->kui",
            f.state.sensor_matrix(),
            specific_forces(f.state.model(_TREE), q, qd, qdd, 9.81 * f.state.up[0]),
        )
        + f.state.bias
        for f in (found, _found())
    ]
    np.testing.assert_allclose(both[0], both[1], atol=0.02)
