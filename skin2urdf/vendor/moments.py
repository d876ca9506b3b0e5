"""What readings have to do with the motion of a segment: products, summed over spans of time.

On a segment that moves as its frame does, with the orientation R of the base frame in it, the
acceleration a of its origin, and ``A = [w']x + [w]x [w]x``, an SU at r, turned by R_su, reads

    y = Q (g R up + a + A r) + b,    Q = S R_su^T,

with S near 1 the sensor's own shape. So readings are linear in 22 numbers per axis i of the sensor,
``Q_ic up_j``, ``Q_ic``, ``Q_ic r_j`` and ``b_i``, on regressors that do not depend on the SU: their
products with each other and with the readings are all that a search over segments, SUs and
directions of gravity has to know.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.estimation.trajectory.kinematics import FrameMotion, frame_motions
from skin2urdf.signals.filters import filtered, first_derivative
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

N_REGRESSORS = 22
TURNED, MOVED, LEVER, CONSTANT = slice(0, 9), slice(9, 12), slice(12, 21), 21
"""Regressors: entries of R (by row) and of a, entries of A (by row), and one."""
SPAN = 2.0
"""Length of the spans of time whose sums are kept apart [s]: errors of one are those of the next
only where the model lacks something."""


@dataclass(frozen=True, eq=False)
class Moments(Record):
    """Products over S spans of time of one segment's regressors with U SUs' readings.

    Attributes:
        N: (U, S, 22, 22) regressors with each other.
        c: (U, S, 22, 3) with the readings, and
        s: (U, S, 22, 3) with the slopes of the readings in time [1/s].
        yy: (U, S) of readings with themselves, and
        ys: (U, S) with their slopes, and
        ss: (U, S) of slopes.
        count: (U, S) samples.
    """

    N: F64
    c: F64
    s: F64
    yy: F64
    ys: F64
    ss: F64
    count: Int


def all_moments(tree: KinematicTree, T_parent_joint: F64, log: Trajectory) -> list[Moments]:
    """Moments of all segments of a tree in one log; the last is the base.

    Args:
        tree: D joints.
        T_parent_joint: (D, 4, 4) their placements.
        log: with columns in the tree's order.
    """
    q, qd, qdd = (np.ascontiguousarray(x.T) for x in (log.q, log.qd, log.qdd))
    _, carried = frame_motions(tree, T_parent_joint, np.zeros(3), q, qd, qdd)
    readings = np.nan_to_num(log.readings)
    slopes = first_derivative(readings, log.rate)[log.kept]
    readings = readings[log.kept]
    return [
        _moments(filtered(_regressors(motion), log.taps)[log.kept], readings, slopes, log)
        for motion in carried
    ]


def rough_moments(tree: KinematicTree, T_parent_joint: F64, log: Trajectory) -> list[Moments]:
    """The same without a second low-pass on motion, which has one already.

    What is lost by it are the highest of the frequencies that are compared, of which moves from
    place to place have nothing.

    Args:
        tree: D joints.
        T_parent_joint: (D, 4, 4) their placements.
        log: with columns in the tree's order.
    """
    q, qd, qdd = (np.ascontiguousarray(x[log.kept].T) for x in (log.q, log.qd, log.qdd))
    _, carried = frame_motions(tree, T_parent_joint, np.zeros(3), q, qd, qdd)
    readings = np.nan_to_num(log.readings)[log.kept]
    return [
        _moments(_regressors(motion), readings, np.zeros_like(readings), log) for motion in carried
    ]


def _regressors(motion: FrameMotion) -> F64:
    """(N, 22) regressors of a segment."""
    n = motion.w.shape[1]
    out = np.ones((n, N_REGRESSORS))
    out[:, TURNED] = np.broadcast_to(motion.R_frame_base, (3, 3, n)).reshape(9, n).T
    out[:, MOVED] = motion.f.T
    out[:, LEVER] = motion.A.reshape(9, n).T
    return out


def _moments(X: F64, readings: F64, slopes: F64, log: Trajectory) -> Moments:
    n = max(1, int((log.time[-1] - log.time[0]) / SPAN))
    edges = np.linspace(0, len(log.kept), n + 1).astype(int)
    U = readings.shape[1]
    N, c = np.zeros((U, n, N_REGRESSORS, N_REGRESSORS)), np.zeros((U, n, N_REGRESSORS, 3))
    s = np.zeros_like(c)
    for sus, valid in _alike(log.valid):
        ok = valid.astype(float)[:, None]
        for i, (first, last) in enumerate(pairwise(edges)):
            part = (X * ok)[first:last]
            N[sus, i] = part.T @ part
            c[sus, i] = _products(part, readings[first:last, sus])
            s[sus, i] = _products(part, slopes[first:last, sus])
    ok = log.valid[:, :, None]
    y, d = np.where(ok, readings, 0.0), np.where(ok, slopes, 0.0)

    def summed(x: F64 | Bool) -> F64:
        return np.add.reduceat(np.asarray(x, dtype=np.float64), edges[:-1], axis=0).T

    return Moments(
        N,
        c,
        s,
        summed((y * y).sum(axis=2)),
        summed((y * d).sum(axis=2)),
        summed((d * d).sum(axis=2)),
        summed(log.valid).astype(np.int64),
    )


def _products(X: F64, y: F64) -> F64:
    """(U, 22, 3) regressors (n, 22) times readings (n, U, 3)."""
    product = X.T @ y.reshape(len(y), -1)
    return product.reshape(X.shape[1], -1, 3).swapaxes(0, 1)


def _alike(valid: Bool) -> Iterator[tuple[Int, Bool]]:
    """SUs whose samples (K, U) are valid at the same times, and when (K,)."""
    groups: dict[bytes, list[int]] = {}
    for u, column in enumerate(valid.T):
        groups.setdefault(np.packbits(column).tobytes(), []).append(u)
    for members in groups.values():
        yield np.array(members), valid[:, members[0]]


def joined(logs: Sequence[Moments]) -> Moments:
    """Moments of several logs, one span after the other."""
    parts = {
        name: np.concatenate([getattr(log, name) for log in logs], axis=1)
        for name in Moments.__dataclass_fields__
    }
    return Moments(**parts)
