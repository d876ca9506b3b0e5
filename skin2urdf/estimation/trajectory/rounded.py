"""What encoders round off along the way, drawn anew.

An encoder is off by up to half a step. In a swing of many steps that is noise of high frequencies.
In one of few it is not: while one joint swings, others yield to it by a step or less, and what
their encoders make of that repeats with every swing, as if lever arms were longer. The readings
can not tell the two apart. The positions with another share of a step added, and rounded once more,
show what else it might have been (a parametric bootstrap: Efron and Tibshirani 1993).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import filtered
from skin2urdf.signals.trajectory import Trajectory

DRAWS = 16
"""Draws, of which the variance of a coordinate is known to a third; the larger of two is stated."""


def rounded_off_again(logs: Sequence[Trajectory]) -> Unseen | None:
    """Motion of links beyond their encoders, one number for each draw; None without a step.

    Args:
        logs: trajectories of the D joints.
    """
    if not any(log.resolution.any() for log in logs):
        return None
    rng = np.random.default_rng(0)
    D = logs[0].q.shape[1]
    motions = tuple(np.empty((len(log.q), DRAWS * D)) for log in logs)
    for log, drawn in zip(logs, motions, strict=True):
        for first in range(0, DRAWS * D, D):
            drawn[:, first : first + D] = _off(log, rng)
        drawn.flags.writeable = False  # of which the record then needs no copy
    joint, number = np.tile(np.arange(D), DRAWS), np.repeat(np.arange(DRAWS), D)
    return Unseen(joint, motions, number=number)


def _off(log: Trajectory, rng: np.random.Generator) -> F64:
    """(N, D) by how much rounded positions are off, low-passed as these."""
    step = log.resolution if len(log.resolution) else np.zeros(log.q.shape[1])
    size = np.where(step > 0, step, 1.0)
    share = log.q / size + rng.uniform(size=len(size))
    return filtered(step * (np.round(share) - share), log.taps)
