"""Parts of the time whose errors may go together: those at one place of the robot, and neighbours.

What a model lacks is the same whenever the robot does the same. In a motion that repeats, errors
far from each other in time then add up as one, and spans of time taken as independent would show
too little of them by the number of repetitions. Covariances that allow for it are made of whole
clusters (Liang and Zeger 1986), which are right as long as errors of different clusters are
independent, whatever they are within one. Where errors go together in either of two ways, what
clusters of each way show is added, less what those show that are alike in both (Cameron, Gelbach
and Miller 2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, ward

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.estimation.trajectory.slack import LEVER
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

CLUSTERS = 16
"""Clusters of either kind, at most. Fewer hold more of what goes together, more tell its size
better: from 16 that scatters by the root of 2 / 16, a third."""
_MOMENT = 0.5
"""Length of what is at one place [s]: longer than the low-pass remembers, so that noise of
different clusters is independent, and shorter than most moves."""
_MOST = 1000
"""Moments in all logs at most; those of longer logs are longer, as time goes with their square."""


@dataclass(frozen=True, eq=False)
class Clusters(Record):
    """S parts of the time, at one place in one stretch of time each.

    Attributes:
        members: per log (K,) the part that each sample is in.
        place: (S,) number of each part's place, and
        stretch: (S,) of its stretch of time.
        moments: per log (K,) the moment that each sample is in, of which places are made: noise of
            one has nothing to do with that of another.
    """

    members: tuple[Int, ...]
    place: Int
    stretch: Int
    moments: tuple[Int, ...]


def clusters(tree: KinematicTree, logs: Sequence[Trajectory]) -> Clusters:
    """Clusters by place and by time.

    Args:
        tree: D joints.
        logs: G trajectories of K samples each.
    """
    seconds = [float(log.time[-1] - log.time[0]) for log in logs]
    moment = max(_MOMENT, sum(seconds) / _MOST)
    first = [
        np.linspace(0, len(log.kept), max(1, round(length / moment)) + 1).astype(int)[:-1]
        for log, length in zip(logs, seconds, strict=True)
    ]
    unit = np.where(tree.prismatic, LEVER, 1.0)
    means = [
        np.add.reduceat(log.q[log.kept] / unit, at, axis=0) / _lengths(log, at)[:, None]
        for log, at in zip(logs, first, strict=True)
    ]
    place = _alike(np.concatenate(means))
    each = max(1, CLUSTERS // len(logs))
    by_log = np.split(place, np.cumsum([len(at) for at in first])[:-1])
    of_place = [
        np.repeat(here, _lengths(log, at))
        for log, at, here in zip(logs, first, by_log, strict=True)
    ]
    of_stretch = [
        g * each + np.arange(len(log.kept)) * each // len(log.kept) for g, log in enumerate(logs)
    ]
    both = np.stack([np.concatenate(of_place), np.concatenate(of_stretch)])
    (places, stretches), members = np.unique(both, axis=1, return_inverse=True)
    ends = np.cumsum([len(log.kept) for log in logs])[:-1]
    before = np.cumsum([0, *(len(at) for at in first)])
    moments = tuple(
        start + np.repeat(np.arange(len(at)), _lengths(log, at))
        for log, at, start in zip(logs, first, before.tolist(), strict=False)
    )
    return Clusters(tuple(np.split(members.ravel(), ends)), places, stretches, moments)


def _alike(places: F64) -> Int:
    """(M,) clusters of places (M, D) that are near each other."""
    if len(places) <= CLUSTERS:
        return np.arange(len(places))
    # Ward's clusters are of about one size, so that none speaks for most of a log.
    labels = fcluster(ward(places), CLUSTERS, "maxclust")
    return np.asarray(np.unique(labels, return_inverse=True)[1], dtype=np.int64)


def _lengths(log: Trajectory, first: Int) -> Int:
    """Samples from each of some first ones to the next."""
    return np.diff(np.append(first, len(log.kept)))
