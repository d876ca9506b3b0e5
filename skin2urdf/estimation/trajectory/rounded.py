"""What encoders round off along the way, drawn anew.

An encoder is off by up to half a step. In a swing of many steps that is noise of high frequencies.
In one of few it is not: while one joint swings, others yield to it by a step or less, and what
their encoders make of that repeats with every swing, as if lever arms were longer. The readings
can not tell the two apart. The positions with another share of a step added, and rounded once more,
show what else it might have been (a parametric bootstrap: Efron and Tibshirani 1993).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.coarser import passed_at_kept
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import Spline
from skin2urdf.signals.trajectory import Trajectory

DRAWS = 16
"""Draws, of which the variance of a coordinate is known to a third; the larger of two is stated."""


def rounded_off_again(logs: Sequence[Trajectory]) -> Unseen | None:
    """Motion of links beyond their encoders, one number for each draw; None without a step.

    It is known at the samples compared only: draws of all would be many times the log.

    Args:
        logs: trajectories of the D joints.
    """
    if not any(log.resolution.any() for log in logs):
        return None
    D = logs[0].q.shape[1]
    kept = tuple(np.empty((3, DRAWS, D, len(log.kept))) for log in logs)
    for draw, off_of_logs in enumerate(drawn_anew(logs)):
        for log, drawn, off in zip(logs, kept, off_of_logs, strict=True):
            drawn[:, draw] = passed_at_kept(off, 1, log, np.float64)
    flat = tuple(each.reshape(3, DRAWS * D, -1) for each in kept)
    joint, number = np.tile(np.arange(D), DRAWS), np.repeat(np.arange(DRAWS), D)
    return Unseen(joint, (), number=number, kept=flat)


def drawn_anew(logs: Sequence[Trajectory]) -> Iterator[tuple[F64, ...]]:
    """Per draw, by how much rounded positions (N, D) of each log are off, as it is sampled.

    Args:
        logs: trajectories of the D joints.
    """
    rng = np.random.default_rng(0)
    yield from zip(*(log.as_sampled(_off(log, rng)) for log in logs), strict=True)


def lost_in_averages(logs: Sequence[Trajectory]) -> Unseen | None:
    """What averages took off positions of joints that stay, one number for each joint.

    It is what encoders toggle, or what joints do within a step: the readings rule out neither. None
    where nothing was taken off.

    Args:
        logs: trajectories of the D joints.
    """
    if not any(log.averaged.any() for log in logs):
        return None
    D = logs[0].q.shape[1]
    motions = tuple(
        log.averaged if len(log.averaged) else np.zeros((len(log.q), D)) for log in logs
    )
    return Unseen(np.arange(D), motions)


def _off(log: Trajectory, rng: np.random.Generator) -> Iterator[F64]:
    """(N, D) by how much rounded positions are off before they are low-passed, in every draw.

    Encoders round at their own rate. The grid holds low-passed samples of what is read more often,
    of which noise is less, and curves through what is read more seldom, of which it is more.
    """
    D = log.q.shape[1]
    if not len(log.resolution):
        yield from [np.zeros((len(log.q), D))] * DRAWS
        return
    raw, path = log.raw_rate if len(log.raw_rate) else np.full(D, log.rate), log.path
    for _ in range(DRAWS):
        off = np.zeros((len(log.q), D))
        for rate in np.unique(raw):
            some = np.flatnonzero(raw == rate)
            drawn, q = _Rounding(log.resolution[some], rng.uniform(size=len(some))), path[:, some]
            if rate < log.rate:
                off[:, some] = drawn.seldom(q, log.rate, float(rate), float(rng.uniform()))
            else:
                off[:, some] = drawn.often(q, log.rate, float(rate))
        yield off


@dataclass(frozen=True, eq=False)
class _Rounding:
    """What encoders make of positions.

    Attributes:
        step: (J,) of each [rad or m], 0 for none.
        turned: (J,) shares of a step by which they are turned.
    """

    step: F64
    turned: F64

    def often(self, q: F64, rate: float, raw: float) -> F64:
        """(N, J) by how much positions (N, J) are off that are read as often as that, or more.

        Args:
            q: positions.
            rate: samples of them per second [Hz].
            raw: the encoders' [Hz].
        """
        times = max(1, round(raw / rate))
        further = np.gradient(q, axis=0) / times
        # The mean of what is read around a sample lets nothing through that the grid would alias.
        ahead = np.arange(times) - 0.5 * (times - 1)
        return np.asarray(np.mean([self._off(q + each * further) for each in ahead], axis=0))

    def seldom(self, q: F64, rate: float, raw: float, later: float) -> F64:
        """(N, J) the same of encoders that are read more seldom.

        A curve through readings has whole steps where these were taken, so that rounding it there
        once more would leave nothing off.

        Args:
            q: positions.
            rate: samples of them per second [Hz].
            raw: the encoders' [Hz].
            later: share of the time between two readings by which they are read later.
        """
        grid = np.arange(len(q)) / rate
        read = (np.arange(int(grid[-1] * raw) + 3) - 1 + later) / raw
        there = np.stack([np.interp(read, grid, column) for column in q.T], axis=1)
        return Spline(self._off(there)).within(grid * raw + 1 - later)

    def _off(self, q: F64) -> F64:
        share = q / np.where(self.step > 0, self.step, 1.0) + self.turned
        return np.asarray(self.step * (np.round(share) - share))
