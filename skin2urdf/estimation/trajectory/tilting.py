"""A base that is tilted otherwise from time to time: it rolls on, is carried, or is leaned on.

What turns it is none of the robot's loads, so that nothing says how far but the readings: gravity
turns alike in all SUs, and in one on the base by nothing else. Turns about two horizontal axes are
found as splines in time. That they accelerate is not felt: a base may turn about any point and be
shifted besides, and what lengths are is told by joints alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.skeleton import turn
from skin2urdf.estimation.trajectory.slack import resting
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_OFTEN = 0.5
"""Time between knots at least [s]: what turns faster is a swing, and is felt to accelerate."""
_MOST = 300
"""Knots at most, of two numbers each, since time goes with their square."""
_ENTRIES = 40_000_000
"""Entries of splines at samples, at most, a third of a gigabyte: logs of hours have fewer knots."""
_CUBIC = 3


def tilts(tree: KinematicTree, logs: Sequence[Trajectory], up: F64) -> Unseen | None:
    """Turns of the base along the logs; None of logs that are too short for any.

    Args:
        tree: D joints.
        logs: trajectories.
        up: (G, 3) unit vectors opposite to gravity in the base frame, per log.
    """
    most = min(_MOST, _ENTRIES // max(1, sum(len(log.q) for log in logs))) // len(logs)
    shares = [_splines(log, _knots(log, most)) for log in logs]
    ends = np.cumsum([0, *(each.shape[1] for each in shares)])
    n = int(ends[-1])
    if n < 2:
        return None
    motions = [
        np.pad(each, ((0, 0), (first, n - last)))
        for each, first, last in zip(shares, ends[:-1], ends[1:], strict=True)
    ]
    # What is level in one log need not be in the next.
    level = np.repeat([frame_with_z(each)[:, :2] for each in up], np.diff(ends), axis=0)
    axis, which, number = (x.ravel() for x in np.indices((3, 2, n)))
    return Unseen(
        np.array([turn(tree, a) for a in axis]),
        tuple(motions),
        column=number,
        unit=level[number, axis, which],
        number=2 * number + which,
        slow=True,
    )


def _knots(log: Trajectory, most: int) -> F64:
    """(P,) grid samples at the ends of a log and of its rests, and as often between as may be.

    Where a robot begins or ends to rest, what moves its base may do so as well.
    """
    ends = log.kept[[0, -1, *(k for b, e in resting(log) for k in (b, e - 1))]]
    at = np.unique(ends).astype(np.float64)
    if len(at) > most:
        at = np.linspace(at[0], at[-1], most)
    often, gaps = _OFTEN * log.rate, np.diff(at)
    while (parts := np.maximum(1, (gaps / often).round())).sum() >= most and often < gaps.sum():
        often *= 1.25
    inner = [
        np.linspace(b, e, int(n), endpoint=False)
        for (b, e), n in zip(pairwise(at), parts, strict=True)
    ]
    return np.concatenate([*inner, at[-1:]])


def _splines(log: Trajectory, knots: F64) -> F64:
    """(N, P + 2) cubic splines on P knots, which add up to 1; constant beyond the ends."""
    if len(knots) < 2:
        return np.zeros((len(log.q), 0))
    grid = np.arange(len(log.q)).clip(knots[0], knots[-1])
    padded = np.concatenate([[knots[0]] * _CUBIC, knots, [knots[-1]] * _CUBIC])
    return np.asarray(BSpline.design_matrix(grid, padded, _CUBIC).toarray())
