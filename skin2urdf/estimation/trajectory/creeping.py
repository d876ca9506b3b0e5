"""Zeros of encoders that creep along a log, and are others in the next one.

Potentiometers that warm up go apart from their links evenly or ever more slowly, counters that lose
counts and couplings that slip with every way that their joint goes: two polynomials of time and the
way gone follow that. Before a further log encoders may have been homed again. Zeros are those that
joints have where the first log begins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.slack import LEVER
from skin2urdf.estimation.trajectory.unseen import MOST_NUMBERS, Unseen
from skin2urdf.signals.filters import filtered
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree


def creeping(tree: KinematicTree, logs: Sequence[Trajectory]) -> Unseen | None:
    """Changes of every joint's zero since its log began; None of more than are looked for.

    A robot of 7 joints may have 14 logs, one of 50 two.

    Args:
        tree: D joints.
        logs: trajectories.
    """
    return (
        _of_each_log(tree, logs, _time_and_way)
        if 3 * _n_zeros(tree, logs) <= MOST_NUMBERS
        else None
    )


def homed_anew(tree: KinematicTree, logs: Sequence[Trajectory]) -> Unseen | None:
    """Zeros of all joints that are others in every further log; None without any, or of too many.

    Args:
        tree: D joints.
        logs: trajectories.
    """
    if len(logs) < 2 or _n_zeros(tree, logs[1:]) > MOST_NUMBERS:
        return None
    first = logs[0]
    return _of_each_log(tree, logs, lambda log: np.ones((*log.q.shape, int(log is not first))))


def _n_zeros(tree: KinematicTree, logs: Sequence[Trajectory]) -> int:
    return tree.n_joints * len(logs)


def _of_each_log(
    tree: KinematicTree, logs: Sequence[Trajectory], motions: Callable[[Trajectory], F64]
) -> Unseen:
    """Motions (N, D, n) of a log's own, whose numbers move no joint in another one."""
    own = [motions(log) for log in logs]
    ends = np.cumsum([0, *(each.shape[2] for each in own)])
    n = int(ends[-1])
    return Unseen(
        np.repeat(np.arange(tree.n_joints), n),
        tuple(
            np.pad(each, ((0, 0), (0, 0), (begin, n - end))).reshape(len(each), -1)
            for each, begin, end in zip(own, ends[:-1], ends[1:], strict=True)
        ),
        unit=np.repeat(np.where(tree.prismatic, LEVER, 1.0), n),
    )


def _time_and_way(log: Trajectory) -> F64:
    """(N, D, 3) time, its square, and the way gone: from 0 where samples compared begin to 1."""
    begin, end = int(log.kept[0]), int(log.kept[-1])
    grid = np.arange(len(log.q)).clip(begin, end)
    time = (grid - begin) / max(1, end - begin)
    way = np.cumsum(np.abs(np.diff(log.q, axis=0, prepend=log.q[:1])), axis=0)[grid]
    way -= way[0]
    way /= np.maximum(way[-1], 1e-12)
    time = np.broadcast_to(time[:, None], way.shape)
    return np.stack([time, time**2, filtered(way, log.taps)], axis=2)
