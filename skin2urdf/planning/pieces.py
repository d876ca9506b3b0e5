"""Pieces of motion that begin and end at rest: transfers, rests, patterns; all within limits."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.planning.records import Limits
from skin2urdf.planning.trajectory import JointTrajectory

_STEP = 0.02
"""Time between points [s]."""
_SMOOTH = 3.0
"""Points over which acceleration is built up at least, so that what lies between them is no more
than the points say."""
_ROOM = 0.97
"""Share of a limit that is planned for."""
_SHORTEST = 0.3
"""Shortest transfer [s]; no drive starts and stops within a few control cycles."""


def strain(piece: JointTrajectory, limits: Limits) -> F64:
    """(4,) largest excursion from the middle, speed, acceleration and jerk, over their limits.

    Looked for densely, between the points as well. Positions without limits count as 0, and of a
    limit without another one it only counts whether it is left.
    """
    q, *rates = piece.dense()
    out = np.zeros(4)
    low, high = q.min(axis=(0, 1)), q.max(axis=(0, 1))
    both = np.isfinite(limits.lower) & np.isfinite(limits.upper)
    if both.any():
        lower, upper = limits.lower[both], limits.upper[both]
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        out[0] = np.max(np.maximum(high[both] - middle, middle - low[both]) / half)
    beyond = np.maximum(limits.lower - low, high - limits.upper)[~both]
    out[0] = max(out[0], 1.0 + float(beyond.max(initial=-1.0)) if (beyond > 0).any() else 0.0)
    for i, (x, most) in enumerate(
        zip(rates, (limits.velocity, limits.acceleration, limits.jerk), strict=True)
    ):
        out[1 + i] = float((np.abs(x).max(axis=(0, 1)) / most).max(initial=0.0))
    return out


def rest(names: tuple[str, ...], pose: F64, duration: float) -> JointTrajectory:
    """Stay for a time [s] in a pose (D,)."""
    zero = np.zeros((2, pose.size))
    return JointTrajectory(names, np.array([0.0, duration]), np.tile(pose, (2, 1)), zero, zero)


def slowed(piece: JointTrajectory, factor: float) -> JointTrajectory:
    """The same way, in a time that is longer by a factor."""
    return JointTrajectory(
        piece.joint_names, factor * piece.time, piece.position,
        piece.velocity / factor, piece.acceleration / factor**2,
    )  # fmt: skip


def transfer(start: F64, goal: F64, limits: Limits) -> JointTrajectory:
    """The fastest smooth move on a straight line through joint space that starts and ends at rest.

    Ruckig finds the motion along the line within the limits of all joints; it is slowed down where
    polynomials through its points would go beyond.

    Args:
        start: (D,) where it begins, and
        goal: (D,) where it ends [rad or m].
        limits: what joints may do.
    """
    way = goal - start
    size = np.abs(way)
    moving = size > 1e-12
    if not moving.any():
        return rest(limits.joint_names, start, _SHORTEST)
    speed, acceleration, jerk = (
        _ROOM * float(np.min(most[moving] / size[moving]))
        for most in (limits.velocity, limits.acceleration, limits.jerk)
    )
    slower = 1.0
    while True:
        time, s, ds, dds = _along_a_line(speed / slower, acceleration / slower**2, jerk / slower**3)
        piece = JointTrajectory(limits.joint_names, time, start + s * way, ds * way, dds * way)
        # A motion that takes k times as long has k times less speed, k^2, k^3 times less of others.
        over = strain(piece, limits)[1:] ** (1 / np.arange(1, 4))
        if over.max() <= 1.0:
            return piece
        slower *= 1.01 * float(over.max())


def _along_a_line(speed: float, acceleration: float, jerk: float) -> tuple[F64, F64, F64, F64]:
    """Times (K,) and position, speed, acceleration (K, 1) of a move from 0 to 1 at rest."""
    from ruckig import InputParameter, Ruckig, Trajectory

    jerk = min(0.5 * jerk, acceleration / (_SMOOTH * _STEP))
    given = InputParameter(1)
    given.target_position = [1.0]
    given.max_velocity, given.max_acceleration, given.max_jerk = [speed], [acceleration], [jerk]
    given.minimum_duration = _SHORTEST
    found = Trajectory(1)
    Ruckig(1).calculate(given, found)
    n = max(int(np.ceil(found.duration / _STEP)), 4)
    time = np.linspace(0.0, found.duration, n + 1)
    s, ds, dds = np.array([[x[0] for x in found.at_time(float(t))] for t in time]).T
    # What ends is at rest, to the last digit.
    s[[0, -1]], ds[[0, -1]], dds[[0, -1]] = (0.0, 1.0), 0.0, 0.0
    return time, s[:, None], ds[:, None], dds[:, None]
