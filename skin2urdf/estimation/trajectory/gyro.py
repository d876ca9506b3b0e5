"""What gyroscopes say along a trajectory: how fast each SU turns, whatever gravity does.

A gyroscope reads

    y = (I + E) w - late w' + droop w'' + bias,    w = R_su_base w_base

where w is the SU's angular velocity, the sum over its joints of axis times velocity. E holds the
gyroscope's scale errors and how its axes lie in the frame of the SU, which is that of the
accelerometer: nine free numbers, for nothing says that two sensors are mounted alike. Its clock is
the SU's; by how much its own filter is later than the accelerometer's (late), and what it takes
away from fast motion (droop), come on top. Biases are those of each log, and hold what the Earth's
rotation adds to them.

A placement k that turns by phi turns all beyond it: with w_k the angular velocity of the frame it
is written in, the SU that turns along sees ``dw = R_su_k (w_k x phi)``. A joint that does e(t)
beyond what its encoder says adds ``R_su_k (w_k x z e + z e')``. Shifts change nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.trajectory.kinematics import FrameMotion, cross
from skin2urdf.estimation.trajectory.records import Turned
from skin2urdf.estimation.trajectory.state import (
    N_GYRO,
    N_GYRO_BIAS,
    N_GYRO_MATRIX,
    Layout,
    MotionState,
)
from skin2urdf.model.records import KinematicModel
from skin2urdf.model.specific_force import angular_velocities
from skin2urdf.signals.filters import filtered, first_derivative, second_derivative
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_SCALE, _TILT = 0.03, 0.02
"""Standard deviations of scale errors and of the directions of a gyroscope's axes [rad]: data
sheets allow 1 to 3 % of each, and boards turn a sensor in its housing by a degree."""
_BIAS = 0.1
"""Standard deviation of a bias [rad/s], 6 deg/s: the largest that data sheets of sensors without
any calibration allow. The Earth's rotation is 7e-5 rad/s."""
_LATE = 5e-3
"""Standard deviation of the delay between the filters of the two sensors in an SU [s]: chips offer
filters of 5 to 200 Hz for each, with delays of 20 to 1 ms, and commonly much the same for both."""
_SPAN = 2.0
"""Length of the spans of time over which noise averages out and errors do not [s]."""
_HUBER = 3.0
"""Residual, in standard deviations, beyond which a sample counts less, as for accelerations."""
_QUIET = 1e-5
"""Noise of a sample at least [rad/s]: what low-passed samples of the quietest chips have is ten
times that. Chips that set their zero at rest, and digits coarser than noise, read exactly nothing
there, which is no reason to believe them without end."""
_FEWEST = 50
"""Kept samples without which a gyroscope says nothing; a second of motion has twenty."""
_CONTRADICTS = 0.1
"""Part of the energy of a gyroscope's readings that a fit may leave. Its own errors are in the fit;
what is left beyond, 18 deg of direction or as much of scale, is of other axes, or other motion."""


def gyro_deviations(front: float) -> F64:
    """(14,) standard deviations of what is known of a gyroscope before; the bias at the end.

    Args:
        front: of the droop of a low-pass [s^2].
    """
    matrix = np.full((3, 3), _TILT)
    np.fill_diagonal(matrix, _SCALE)
    return np.concatenate([matrix.ravel(), [_LATE, front], np.full(3, _BIAS)])


def gyro_matrix(state: MotionState) -> F64:
    """(U, 3, 3) the gyroscopes' sensitivities I + E."""
    E = state.gyro[:, :N_GYRO_MATRIX].reshape(-1, 3, 3)
    return np.asarray(np.eye(3) + E)


def gyro_bias(state: MotionState, g: int) -> F64:
    """(U, 3) biases in a log [rad/s]."""
    begin = N_GYRO + N_GYRO_BIAS * g
    return state.gyro[:, begin : begin + N_GYRO_BIAS]


def with_gyros(tree: KinematicTree, logs: Sequence[Trajectory]) -> Bool:
    """(U,) True for SUs that turn, and have a gyroscope that tells of it in some log."""
    there = np.zeros(tree.n_sus, dtype=bool)
    for log in logs:
        if log.turning is not None:
            there |= log.turning.sum(axis=0) >= _FEWEST
    turns = [any(not tree.prismatic[j] for j in tree.chain(int(k))) for k in tree.su_joint]
    return np.asarray(there & np.array(turns, dtype=bool))


def without_gyros(logs: Sequence[Trajectory], sus: Bool) -> tuple[Trajectory, ...]:
    """Logs in which the gyroscopes of some SUs (U,) are not listened to."""
    return tuple(
        log if log.turning is None else replace(log, turning=log.turning & ~sus) for log in logs
    )


def predicted_turning(
    model: KinematicModel,
    log: Trajectory,
    links: tuple[F64, F64],
    state: MotionState,
    g: int,
    lags: F64,
) -> Turned | None:
    """Rates of turn of one log held against a state; None where it has none.

    Args:
        model: the robot in that state.
        log: the log.
        links: (N, D) positions and velocities of the model's joints along it.
        state: the state.
        g: number of the log.
        lags: (K, U) by how much readings are late [s].
    """
    if log.rates is None or log.turning is None:
        return None
    ideal = filtered(angular_velocities(model, *links), log.taps)
    read = (ideal.swapaxes(0, 1) @ np.swapaxes(gyro_matrix(state), 1, 2)).swapaxes(0, 1)
    late, droop = state.gyro[:, N_GYRO_MATRIX : N_GYRO_MATRIX + 2].T
    slope = first_derivative(read, log.rate)[log.kept]
    bend = second_derivative(read, log.rate)[log.kept]
    predicted = read[log.kept] + droop[:, None] * bend + gyro_bias(state, g)
    at = log.kept[:, None] + log.rate * (lags + late)
    residual, splines = np.zeros_like(predicted), log.rate_splines
    for u in np.flatnonzero(log.turning.any(axis=0)):
        residual[:, u] = splines[u].at(at[:, u]) - predicted[:, u]
    if log.beyond is not None:
        residual -= log.beyond[..., 3:]
    measured = log.turning & np.isfinite(residual).all(axis=2)
    return Turned(np.where(measured[..., None], residual, 0.0), measured, slope, bend)


def rate_columns(
    before: Sequence[int],
    state: MotionState,
    layout: Layout,
    g: int,
    u: int,
    frames: tuple[Mapping[int, FrameMotion], FrameMotion],
    slides: Mapping[int, bool],
    unseen: tuple[Int, Int, F64],
    slopes: tuple[F64, F64, F64],
) -> F64:
    """(C + n, 3, K) derivatives of a gyroscope's prediction, joint columns first.

    Args:
        before: joints before the SU, from the ground on, whose placements are estimated.
        state: where.
        layout: where coordinates stand.
        g: number of the log.
        u: the SU.
        frames: motion of the frames in which joints and hinges are placed, by their number, and of
            the SU's own.
        slides: which of these slide.
        unseen: (e,) joints that move beyond their encoders, (e,) which of the numbers that the SU
            feels makes them, and (2, e, K) that motion and its derivative per unit.
        slopes: (K, 3) derivatives of the prediction in time, of first and second order, and (K,)
            times since the middle of the log [s].
    """
    fixed, here = frames
    K = here.w.shape[1]

    def turned(k: int, axis: int) -> F64:
        """What the SU sees per turn about an axis of the frame in which joint k is placed."""
        R = fixed[k].R_frame_base
        w_base = np.einsum("ijk,ik->jk", R, fixed[k].w)
        return np.asarray(np.einsum("ijk,jk->ik", here.R_frame_base, cross(w_base, R[axis])))

    rows: list[F64] = []
    for k in before:
        rows += [np.zeros((2, 3, K)), np.stack([turned(k, 0), turned(k, 1)])]
    # Gravity's direction and size say nothing of how an SU turns.
    rows.append(np.zeros((3 if g > 0 else 1, 3, K)))
    joints, number, motion = unseen
    beyond = np.zeros((int(number.max(initial=-1)) + 1, 3, K))
    for k, n, e, ed in zip(joints.tolist(), number, *motion, strict=True):
        if not slides[k]:
            axis = np.einsum("ijk,jk->ik", here.R_frame_base, fixed[k].R_frame_base[2])
            beyond[n] += turned(k, 2) * e + axis * ed
    rows.append(beyond)
    if layout.n_further:
        # Neither how a robot is mounted nor shifts along axes; turns about axes, as those above.
        rows.append(np.zeros((2 if g == 0 else 0, 3, K)))
        for k in before:
            rows.append(np.stack([np.zeros((3, K)), turned(k, 2)]))
    joint = np.concatenate(rows)
    out = np.zeros((len(joint) + layout.n_su, 3, K))
    out[: len(joint)] = joint
    own = out[len(joint) :]
    for i in range(3):
        own[3 + i] = cross(here.w, np.eye(3)[:, i : i + 1])
    out = np.asarray(np.einsum("ij,cjk->cik", gyro_matrix(state)[u], out))
    own = out[len(joint) :]
    slope, bend, since = slopes
    own[layout.clock(g)] = -slope.T, -since * slope.T
    gyro = own[layout.gyro]
    for i in range(N_GYRO_MATRIX):
        gyro[i, i // 3] = here.w[i % 3]
    gyro[N_GYRO_MATRIX] = -slope.T
    gyro[N_GYRO_MATRIX + 1] = bend.T
    for i in range(N_GYRO_BIAS):
        gyro[N_GYRO + N_GYRO_BIAS * g + i, i] = 1.0
    return out


def rate_weights(
    tree: KinematicTree,
    logs: Sequence[Trajectory],
    used: Bool,
    turned: Sequence[Turned | None],
) -> tuple[tuple[F64, ...], tuple[F64, ...]]:
    """Noise of each rate as the residuals show it, and the information it counts with.

    What is left of spans of time, beyond what noise leaves of their means, is no noise that
    averages out (a bias that wanders, axes that gravity pulls at); each gyroscope counts the less.

    Args:
        tree: the structure.
        logs: the logs.
        used: (U,) gyroscopes that count.
        turned: what is left of each, None for logs without gyroscopes.

    Returns:
        Per log (K, U, 3) standard deviations [rad/s], and (K, U, 3) information [s^2/rad^2].
    """
    noise, weights = [], []
    for log, t in zip(logs, turned, strict=True):
        sd = np.full((len(log.kept), tree.n_sus, 3), np.inf)
        w = np.zeros_like(sd)
        noise.append(sd)
        weights.append(w)
        if t is None:
            continue
        for u in np.flatnonzero(used & t.measured.any(axis=0)):
            moves = log.moving[:, list(tree.chain(int(tree.su_joint[u])))].any(axis=1)
            for which in (moves, ~moves):
                sd[which, u] = _spread(t.residual[which & t.measured[:, u], u])
            size = np.sqrt(((t.residual[:, u] / sd[:, u]) ** 2).mean(axis=1))
            share = np.where(size > _HUBER, _HUBER / np.maximum(size, _HUBER), 1.0)
            counts = np.where(t.measured[:, u], log.independence * share, 0.0)[:, None]
            w[:, u] = counts / sd[:, u] ** 2
            w[:, u] /= max(1.0, _lasting(log, t.residual[:, u], w[:, u]))
    return tuple(noise), tuple(weights)


def _spread(residual: F64) -> float:
    """Standard deviation of residuals (M, 3) by their median, which outliers do not move."""
    if len(residual) < 8:
        return np.inf
    # The median of chi-squared with three degrees of freedom is 2.366.
    spread = float(np.sqrt(np.median((residual**2).sum(axis=1)) / 2.366))
    return max(spread, _QUIET)


def _lasting(log: Trajectory, residual: F64, weight: F64) -> float:
    """Mean squares of span means of residuals (K, 3), over their variances if they are noise."""
    n = max(1, int((log.time[-1] - log.time[0]) / _SPAN))
    first = np.linspace(0, len(log.kept), n + 1).astype(int)[:-1]
    total = np.add.reduceat(weight, first, axis=0)
    moment = np.add.reduceat(weight * residual, first, axis=0)
    known = total > 0
    return float((moment[known] ** 2 / total[known]).mean()) if known.any() else 0.0


def contradicting(logs: Sequence[Trajectory], turned: Sequence[Turned | None], used: Bool) -> Bool:
    """(U,) gyroscopes of which a fit leaves more than their own errors and noise explain.

    Args:
        logs: the logs.
        turned: what is left of each log.
        used: (U,) those that were listened to.
    """
    left, all_of_it = np.zeros(len(used)), np.zeros(len(used))
    for log, t in zip(logs, turned, strict=True):
        if t is None or log.rates is None:
            continue
        rates = log.rates[log.kept]
        for u in np.flatnonzero(used & t.measured.any(axis=0)):
            seen = rates[t.measured[:, u], u]
            all_of_it[u] += ((seen - np.median(seen, axis=0)) ** 2).sum()
            left[u] += (t.residual[:, u] ** 2).sum()
    return np.asarray(used & (left > _CONTRADICTS * all_of_it))
