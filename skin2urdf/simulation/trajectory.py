"""Trajectories as points on a regular grid with a spline through them, and how to build one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.simulation.pattern import (
    PEAK_SPEED,
    Tones,
    smooth_rise,
    smooth_step,
    windowed_pattern,
)

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

GRID = 4e-3
"""Spacing of the points that define a trajectory [s]."""

_SHORTEST_MOVE = 0.6
"""Shortest duration of a move [s]; no drive starts and stops within a few samples."""

PhaseKind = Literal["rest", "move", "structural", "pattern"]


@dataclass(frozen=True)
class Phase:
    """What the reference does for some time.

    Attributes:
        kind: rest, move between poses, structural move of one DoF, or pattern around a pose.
        start: first instant [s].
        end: last instant [s].
        joint: the DoF that moves; -1 where none or several do.
        pose: index of the pose the robot is in; -1 in moves and at home.
    """

    kind: PhaseKind
    start: float
    end: float
    joint: int = -1
    pose: int = -1


@dataclass(frozen=True, eq=False)
class JointMotion(Record):
    """Motion of all joints: the quintic spline through points on a regular grid.

    The spline IS the motion, so its velocity and acceleration are exact.

    Attributes:
        time: (K,) grid [s].
        position: (K, D) positions on the grid [rad or m].
    """

    time: F64
    position: F64

    @cached_property
    def _splines(self) -> tuple[BSpline, BSpline, BSpline]:
        from scipy.interpolate import make_interp_spline

        spline = make_interp_spline(self.time, self.position, k=5)
        return spline, spline.derivative(1), spline.derivative(2)

    def at(self, time: F64) -> tuple[F64, F64, F64]:
        """Position, velocity and acceleration.

        Args:
            time: (N,) times inside the grid [s].

        Returns:
            Three (N, D) arrays [rad or m, and per s, and per s^2].
        """
        q, qd, qdd = (np.ascontiguousarray(spline(time)) for spline in self._splines)
        return q, qd, qdd


class PathBuilder:
    """Builds a trajectory piece by piece; every piece starts and ends at rest.

    Attributes:
        phases: what has been built so far.
    """

    def __init__(self, start: F64) -> None:
        self.phases: list[Phase] = []
        self._pose = start
        self._pieces: list[F64] = [start[None]]
        self._points = 1

    def rest(self, duration: float, pose: int = -1) -> None:
        """Stay where it is for a time [s]."""
        self._append("rest", duration, lambda t: np.zeros((t.size, self._pose.size)), pose=pose)

    def move_to(self, goal: F64, speed: F64, kind: PhaseKind, joint: int = -1) -> None:
        """Make a smooth move.

        Args:
            goal: (D,) where to [rad or m].
            speed: (D,) fastest speeds [rad/s or m/s].
            kind: what the move is.
            joint: the DoF that moves, -1 for several.
        """
        delta = goal - self._pose
        duration = max(_SHORTEST_MOVE, float(np.max(PEAK_SPEED * np.abs(delta) / speed)))
        whole = GRID * np.ceil(duration / GRID)
        self._append(kind, duration, lambda t: smooth_step(t / whole)[:, None] * delta, joint)
        self._pose = goal

    def cruise_to(self, goal: F64, speed: float, acceleration: float, scale: F64) -> None:
        """Move as controllers do: all DoFs in proportion, speeding up, cruising, slowing down.

        The speed rises and falls along a `smooth_step`. A way too short to reach it is made of the
        two flanks alone, at the acceleration that was asked for.

        Args:
            goal: (D,) where to [rad or m].
            speed: peak speed of the DoF that has farthest to go, in units of its ``scale`` [1/s].
            acceleration: its peak acceleration, in the same units [1/s^2].
            scale: (D,) way of each DoF that counts as one unit [rad or m].
        """
        delta = goal - self._pose
        way = float(np.max(np.abs(delta) / scale))
        speed = min(speed, float(np.sqrt(way * acceleration / PEAK_SPEED)))
        flank = PEAK_SPEED * speed / acceleration
        cruise = way / speed
        # Whole grid steps, so that the move ends at rest; that slows it down by a step at most.
        stretch = GRID * np.ceil((cruise + flank) / GRID) / (cruise + flank)

        def part(t: F64) -> F64:
            t = t / stretch
            risen = smooth_rise(t / flank) - smooth_rise((t - cruise) / flank)
            return np.asarray(flank / cruise * risen)[:, None] * delta

        self._append("move", (cruise + flank) * stretch - 0.5 * GRID, part)
        self._pose = goal

    def excite(
        self,
        tones: Mapping[int, Tones],
        duration: float,
        ramp: float,
        pose: int,
    ) -> None:
        """Play a pattern and return.

        Args:
            tones: DoF -> tones of its pattern.
            duration: length of the pattern [s].
            ramp: length of either flank of its window [s].
            pose: index of the pose.
        """

        def offset(t: F64) -> F64:
            total = np.zeros((t.size, self._pose.size))
            for joint, joint_tones in tones.items():
                total[:, joint] = windowed_pattern(t, duration, ramp, joint_tones)
            return total

        joint = next(iter(tones)) if len(tones) == 1 else -1
        self._append("pattern", duration, offset, joint, pose)

    @property
    def end(self) -> float:
        """How long all that has been built takes [s]."""
        return (self._points - 1) * GRID

    def motion(self) -> JointMotion:
        """Return all that has been built."""
        position = np.concatenate(self._pieces)
        return JointMotion(_grid(0, len(position)), position)

    def _append(
        self,
        kind: PhaseKind,
        duration: float,
        offset: Callable[[F64], F64],
        joint: int = -1,
        pose: int = -1,
    ) -> None:
        count = int(np.ceil(duration / GRID))
        start = (self._points - 1) * GRID
        self._pieces.append(self._pose + offset(_grid(1, count + 1)))
        self._points += count
        self.phases.append(Phase(kind, start, start + count * GRID, joint, pose))


def _grid(first: int, end: int) -> F64:
    """Times of the grid points first, ..., end - 1 [s]."""
    return np.arange(first, end, dtype=np.float64) * GRID
