"""What is known before the logs are read, as information on the coordinates of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import N_JOINT, N_PLACEMENT, N_SU
from skin2urdf.estimation.trajectory.blueprint import Blueprint
from skin2urdf.estimation.trajectory.gyro import gyro_deviations
from skin2urdf.estimation.trajectory.records import Equations
from skin2urdf.estimation.trajectory.state import N_GYRO, N_GYRO_BIAS, Layout, MotionState


@dataclass(frozen=True, eq=False)
class ClockPriors(Record):
    """What is known of the clock of every SU in every log.

    Attributes:
        mean: (G, U, 2) lag [s] and drift [1] to expect.
        deviation: (G, U, 2) their standard deviations.
    """

    mean: F64
    deviation: F64


@dataclass(frozen=True)
class MotionPriors(Record):
    """What is known before the logs are read, as standard deviations; 0 fixes a quantity.

    Attributes:
        sensors: bias, scale, cross-axis and offsets, as for features.
        gravity: of the magnitude of gravity [m/s^2].
        front: (2, 2) mean and standard deviation of a sensor's front end [s^2].
        lag: of an SU's clock [s].
        drift: of its rate [1].
        bias_walk: of the change of a bias per root of a second [m/s^2/sqrt(s)].
        unseen: (S,) of the numbers that make what encoders do not see.
        gyro: (14,) of a gyroscope's coordinates, its bias in a log last.
        blueprint: the robot, where it is known; else its frames are the log's to choose.
        clocks: of SUs of which other SUs tell more than ``lag`` and ``drift`` do.
        curvature: of the curvature of an SU's axes [s^2/m].
        warming: of what the scales of an SU's axes change by within a log [1].
    """

    sensors: Priors
    gravity: float
    front: F64
    lag: float
    drift: float
    bias_walk: float
    unseen: F64
    gyro: F64 = field(default_factory=lambda: np.zeros(N_GYRO + N_GYRO_BIAS))
    blueprint: Blueprint | None = None
    clocks: ClockPriors | None = None
    curvature: float = 0.0
    warming: float = 0.0


def sense(priors: MotionPriors, state: MotionState) -> float:
    """What sensors read per m/s^2: gravity is what they are held against, whatever it is.

    Their scales do not tell its size: sensors of one kind may share a scale error.
    """
    return priors.sensors.gravity / state.gravity


def prior_information(
    priors: MotionPriors, layout: Layout, seconds: Sequence[float], state: MotionState
) -> tuple[F64, F64, F64, F64]:
    """Information (J,) and (U, n, n) of the priors and their gradients (J,) and (U, n).

    Args:
        priors: what is known before.
        layout: where coordinates stand.
        seconds: length of each log [s].
        state: where the gradients are wanted.
    """
    places = state.placements
    U = len(places.bias)
    joint, su = np.zeros(layout.n_joint), np.zeros((U, layout.n_su, layout.n_su))
    joint_gradient, su_gradient = np.zeros(layout.n_joint), np.zeros((U, layout.n_su))

    def inverse(deviation: F64 | float) -> F64:
        d = np.asarray(deviation, dtype=np.float64)
        return np.divide(1.0, d**2, out=np.zeros_like(d), where=d > 0)

    joint[layout.gravity] = inverse(priors.gravity / state.gravity)
    joint_gradient[layout.gravity] = -joint[layout.gravity] * (1 - sense(priors, state))
    joint[layout.unseen] = inverse(priors.unseen)
    joint_gradient[layout.unseen] = -joint[layout.unseen] * state.unseen
    if priors.blueprint:
        of_joints, of_further = priors.blueprint.information(places)
        joint[layout.joints], joint_gradient[layout.joints] = of_joints
        joint[layout.further], joint_gradient[layout.further] = of_further
    of_su = np.zeros((U, layout.n_su))
    of_su[:, N_PLACEMENT:N_SU] = inverse(priors.sensors.deviations)
    of_su[:, layout.front] = inverse(priors.front[1])
    value = np.zeros((U, layout.n_su))
    value[:, N_PLACEMENT:N_SU] = np.concatenate([places.bias, places.shape], axis=1)
    value[:, layout.front] = state.front - priors.front[0]
    for g in range(layout.n_logs):
        of_su[:, layout.clock(g)] = inverse(np.array([priors.lag, priors.drift]))
        value[:, layout.clock(g)] = state.clock[g]
        if priors.clocks is not None:
            of_su[:, layout.clock(g)] = inverse(priors.clocks.deviation[g])
            value[:, layout.clock(g)] -= priors.clocks.mean[g]
    if layout.curves:
        of_su[:, layout.curvature] = inverse(priors.curvature)
        value[:, layout.curvature] = state.curvature
    if layout.warms:
        for g, of_log in enumerate(state.warming):
            of_su[:, layout.warming(g)] = inverse(priors.warming)
            value[:, layout.warming(g)] = of_log.reshape(U, -1)
    if layout.gyros:
        of_log = np.tile(priors.gyro[N_GYRO:], layout.n_logs)
        of_su[:, layout.gyro] = inverse(np.concatenate([priors.gyro[:N_GYRO], of_log]))
        value[:, layout.gyro] = state.gyro
    su[:, range(layout.n_su), range(layout.n_su)] = of_su
    su_gradient -= of_su * value
    for g, n in enumerate(layout.n_knots):
        if n and priors.bias_walk > 0:
            step = seconds[g] / (n - 1)
            D = np.diff(np.eye(n), axis=0)
            walk = D.T @ D * inverse(priors.bias_walk) / step
            # The walk begins anywhere near the SU's own bias, which its mean is to be; switched on
            # anew for another log, a sensor has another one.
            mean = inverse(priors.bias_walk) / step * n
            if layout.n_logs > 1:
                mean = np.minimum(mean, inverse(priors.sensors.bias))
            walk += np.ones((n, n)) / n**2 * mean
            full = np.kron(walk, np.eye(3))
            at = layout.knots(g)
            su[:, at, at] += full
            flat = state.knots[g].swapaxes(0, 1).reshape(U, -1)
            su_gradient[:, at] -= flat @ full
    return joint, su, joint_gradient, su_gradient


def with_priors(
    priors: MotionPriors,
    layout: Layout,
    seconds: Sequence[float],
    state: MotionState,
    data: Equations,
) -> Equations:
    """Normal equations of data with those of the priors, of which offsets have one as well."""
    joint, su, joint_gradient, su_gradient = prior_information(priors, layout, seconds, state)
    places, weight = state.placements, priors.sensors.position**-2.0
    D = layout.n_joints
    held = np.zeros(data.joint.shape[0])
    pulled = np.zeros_like(held)
    # An offset not known is to be short; its gradient is that along the frame's own axes.
    local = np.einsum(
        "dji,dj->di", places.T_parent_joint[:, :3, :3], places.T_parent_joint[:, :3, 3]
    )
    for i in (0, 1):
        held[N_JOINT * np.arange(D) + i] = weight
        pulled[N_JOINT * np.arange(D) + i] = -weight * local[:, i]
    su = np.array(su)
    su_gradient = np.array(su_gradient)
    at_su = np.einsum("uji,uj->ui", places.T_joint_su[:, :3, :3], places.T_joint_su[:, :3, 3])
    su[:, range(3), range(3)] += weight
    su_gradient[:, :3] -= weight * at_su
    return replace(
        data,
        joint=data.joint + np.diag(joint + held),
        su=data.su + su,
        joint_gradient=data.joint_gradient + joint_gradient + pulled,
        su_gradient=data.su_gradient + su_gradient,
    )


def prior_chi2(
    priors: MotionPriors, layout: Layout, seconds: Sequence[float], state: MotionState
) -> float:
    """Chi-squared of the priors at a state."""
    joint, su, joint_gradient, su_gradient = prior_information(priors, layout, seconds, state)
    places, weight = state.placements, priors.sensors.position**-2.0
    total: float = weight * float((places.T_parent_joint[:, :3, 3] ** 2).sum())
    total += weight * float((places.T_joint_su[:, :3, 3] ** 2).sum())
    known = joint > 0
    total += float((joint_gradient[known] ** 2 / joint[known]).sum())
    for H, s in zip(su, su_gradient, strict=True):
        has = np.diag(H) > 0
        total += float(s[has] @ np.linalg.solve(H[np.ix_(has, has)], s[has]))
    return total


def motion_priors(
    sensors: Priors, *, gravity: float, front: tuple[F64, F64], gyro: bool = True
) -> MotionPriors:
    """What is commonly known before logs are read.

    Args:
        sensors: of bias, scale and cross-axis.
        gravity: standard deviation of its magnitude [m/s^2].
        front: mean and standard deviation (2,) of sensors' front ends [s^2].
        gyro: whether gyroscopes have errors.
    """
    return MotionPriors(
        sensors=sensors,
        gravity=gravity,
        front=np.stack(front),
        lag=1.0,
        drift=1e-2,
        bias_walk=0.0,
        unseen=np.zeros(0),
        gyro=gyro_deviations(float(front[1].max())) * gyro,
    )
