"""Ways between free poses on which nothing touches, straight or through others."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.sparse.csgraph import dijkstra

from skin2urdf.arrays import F64
from skin2urdf.planning.pieces import transfer
from skin2urdf.planning.records import Limits
from skin2urdf.planning.trajectory import JointTrajectory

_PARTS = 40
"""Parts that are looked at, at most, in the search of one way."""
_STOP = 0.7
"""Time that starting and stopping adds to a transfer [s]."""


class Roadmap:
    """Free poses, and what is known of the straight ways between them.

    A way is looked at once the shortest route leads along it, and what was found is kept
    (a lazy roadmap: Bohlin and Kavraki 2000).

    Args:
        poses: (N, D) free poses [rad or m].
        limits: what joints may do.
        is_free: tells whether nothing touches along a piece.
    """

    def __init__(
        self, poses: F64, limits: Limits, is_free: Callable[[JointTrajectory], bool]
    ) -> None:
        self._poses, self._limits, self._is_free = poses, limits, is_free
        length = np.max(np.abs(poses[:, None] - poses) / limits.velocity, axis=2)
        # Every part of a way starts and stops, which takes about as long.
        self.length = np.where(length > 0, length + _STOP, 0.0)
        self._pieces: dict[tuple[int, int], JointTrajectory] = {}

    def way(self, start: int, goal: int) -> list[JointTrajectory] | None:
        """Transfers from one pose to another; None where none was found.

        Args:
            start: index of the pose where it begins.
            goal: index of the pose where it ends.
        """
        for _ in range(_PARTS):
            route = self._shortest(start, goal)
            if route is None:
                return None
            if all(self._is_open(a, b) for a, b in pairwise(route)):
                return [self._pieces[edge] for edge in pairwise(route)]
        return None

    def _shortest(self, start: int, goal: int) -> list[int] | None:
        """Poses along the shortest route on what is open or was not looked at."""
        if start == goal:
            return [start]
        _, before = dijkstra(self.length, indices=np.array([start]), return_predecessors=True)
        route = [goal]
        while before[0, route[-1]] >= 0:
            route.append(int(before[0, route[-1]]))
        return route[::-1] if route[-1] == start else None

    def _is_open(self, a: int, b: int) -> bool:
        """Whether a straight way is free; the way back is, then, as well."""
        if (a, b) not in self._pieces:
            piece = transfer(self._poses[a], self._poses[b], self._limits)
            if (b, a) not in self._pieces and not self._is_free(piece):
                self.length[a, b] = self.length[b, a] = 0.0  # no edge
                return False
            self._pieces[a, b] = piece
        return True
