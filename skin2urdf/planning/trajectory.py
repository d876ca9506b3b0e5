"""A joint trajectory as controllers take it: points, and polynomials between them.

Controllers of ros2_control interpolate points that have positions, velocities and accelerations by
the polynomial of fifth order between them. That is the motion itself here: limits are held, and
readings are predicted, along these polynomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Record


@dataclass(frozen=True, eq=False)
class JointTrajectory(Record):
    """Motion of D joints through K points.

    Attributes:
        joint_names: the joints.
        time: (K,) increasing times from the start [s].
        position: (K, D) [rad or m].
        velocity: (K, D) [rad/s or m/s].
        acceleration: (K, D) [rad/s^2 or m/s^2].
    """

    joint_names: tuple[str, ...]
    time: F64
    position: F64
    velocity: F64
    acceleration: F64

    @property
    def duration(self) -> float:
        """Time of the last point [s]."""
        return float(self.time[-1])

    @cached_property
    def _coefficients(self) -> F64:
        """(K - 1, 6, D) coefficients of the powers of the share of each interval."""
        h = np.diff(self.time)[:, None]
        p0, p1 = self.position[:-1], self.position[1:]
        v0, v1 = self.velocity[:-1] * h, self.velocity[1:] * h
        a0, a1 = self.acceleration[:-1] * h**2, self.acceleration[1:] * h**2
        dp = p1 - p0
        return np.stack(
            [
                p0,
                v0,
                0.5 * a0,
                10 * dp - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1,
                -15 * dp + 8 * v0 + 7 * v1 + 1.5 * a0 - a1,
                6 * dp - 3 * v0 - 3 * v1 - 0.5 * a0 + 0.5 * a1,
            ],
            axis=1,
        )

    def at(self, time: F64) -> tuple[F64, F64, F64, F64]:
        """Position, velocity, acceleration and jerk; at rest before and after all points.

        Args:
            time: (N,) times [s].

        Returns:
            Four (N, D) arrays [rad or m, and per s, s^2 and s^3].
        """
        inside = np.clip(time, self.time[0], self.time[-1])
        i = np.clip(np.searchsorted(self.time, inside, side="right") - 1, 0, len(self.time) - 2)
        h = (self.time[i + 1] - self.time[i])[:, None]
        x = (inside - self.time[i])[:, None] / h
        c = self._coefficients[i]
        outside = ((time < self.time[0]) | (time > self.time[-1]))[:, None]
        orders: list[F64] = []
        for n in range(4):
            factor = _falling(n)
            value = np.zeros(c.shape[::2])
            for k in range(5, n - 1, -1):
                value = value * x + factor[k] * c[:, k]
            orders.append(value / h**n if n == 0 else np.where(outside, 0.0, value / h**n))
        q, qd, qdd, jerk = orders
        return q, qd, qdd, jerk

    def dense(self, parts: int = 12) -> tuple[F64, F64, F64, F64]:
        """Position, velocity, acceleration and jerk between all points, both ends included.

        Jerk leaps at points: it counts as it is before and behind them.

        Args:
            parts: parts of each interval between two points.

        Returns:
            Four (parts + 1, K - 1, D) arrays.
        """
        x = np.linspace(0.0, 1.0, parts + 1)
        h = np.diff(self.time)[:, None]
        out = []
        for n in range(4):
            powers = np.zeros((parts + 1, 6))
            for k in range(n, 6):
                powers[:, k] = _falling(n)[k] * x ** (k - n)
            out.append(np.tensordot(powers, self._coefficients, (1, 1)) / h**n)
        q, qd, qdd, jerk = out
        return q, qd, qdd, jerk


def _falling(n: int) -> F64:
    """(6,) k (k - 1) .. (k - n + 1): what the n-th derivative makes of the powers k."""
    k = np.arange(6, dtype=np.float64)
    out = np.ones(6)
    for i in range(n):
        out *= k - i
    return out


def joined(names: Sequence[str], pieces: Sequence[JointTrajectory]) -> JointTrajectory:
    """One trajectory from pieces that begin where the one before ends, each from time 0."""
    time, start = [pieces[0].time[:1]], 0.0
    for piece in pieces:
        time.append(start + piece.time[1:])
        start += piece.duration

    def stacked(name: str) -> F64:
        first = getattr(pieces[0], name)[:1]
        return np.concatenate([first, *(getattr(piece, name)[1:] for piece in pieces)])

    return JointTrajectory(
        tuple(names),
        np.concatenate(time),
        stacked("position"),
        stacked("velocity"),
        stacked("acceleration"),
    )
