"""Gravity's direction over time in a base that tilts by itself, as an SU on it feels it.

What turns a base turns gravity in all SUs, and in one on the base by nothing else. Which SU that is
follows from no name: it is the one in which gravity turns least, if there is one, and whether a
tree explains more of all others with what this one feels than without is seen of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.signals.sampling import Sampled

_SPAN = 0.5
"""Length of the spans of time in each of which gravity has one direction [s]: what shakes a base
averages out, and one that sways within seconds hardly turns."""
_LEAST = 2e-3
"""Turn of gravity [rad], rms, below which a base stands: trees are grown with windows that may be
off by as much."""
_MOST = 0.25
"""The same above which an SU is not on the base: bases that roll by more are those of vehicles."""
_HEARD = 0.5
"""Share of the samples of a span that an SU has to have for its mean to count."""


@dataclass(frozen=True, eq=False)
class Tilted(Record):
    """Directions of gravity in P spans of time of all logs.

    Attributes:
        su: number of the SU that felt them.
        up: (P, 3) unit vectors opposite to gravity in the frame of a base that is upright in the
            mean of the first log.
        log: (P,) log of each span.
        span: per log (N,) number of the span of each sample of its grid.
    """

    su: int
    up: F64
    log: Int
    span: tuple[Int, ...]


def tilts_of_base(sampled: Sequence[Sampled]) -> Tilted | None:
    """What the SU feels in which gravity turns least within logs.

    Args:
        sampled: the logs on their grids, with the same SUs.

    Returns:
        None where gravity stands still in it, and where it turns more than a base may.
    """
    spans, means = zip(*(_means(s) for s in sampled), strict=True)
    n = np.cumsum([0, *map(len, means)])
    log = np.repeat(np.arange(len(means)), np.diff(n))
    felt = np.concatenate(means)
    felt = felt / np.linalg.norm(felt, axis=2, keepdims=True)
    centre = np.stack([_mean(each / np.linalg.norm(each, axis=2, keepdims=True)) for each in means])
    away = np.linalg.norm(np.cross(felt, centre[log]), axis=2)
    heard = np.isfinite(away)
    turned = np.sqrt(np.where(heard, away**2, 0.0).sum(axis=0) / heard.sum(axis=0).clip(1))
    turned = np.where(2 * heard.sum(axis=0) > len(felt), turned, np.inf)
    su = int(np.argmin(turned))
    if not _LEAST < turned[su] < _MOST:
        return None
    there = np.flatnonzero(heard[:, su])
    nearest = there[np.abs(np.arange(len(felt))[:, None] - there).argmin(axis=1)]
    up = felt[nearest, su] @ frame_with_z(centre[0, su])
    return Tilted(su, up, log, tuple(k + each for k, each in zip(n, spans, strict=False)))


def _means(s: Sampled) -> tuple[Int, F64]:
    """(N,) number of the span of each sample, and (P, U, 3) mean readings; NaN where too few."""
    N = len(s.readings)
    count = max(1, int(N / (_SPAN * s.motion.grid.rate)))
    edges = np.linspace(0, N, count + 1).astype(np.int64)
    valid = s.valid.astype(np.float64)
    of_span = np.add.reduceat(valid, edges[:-1], axis=0)
    total = np.add.reduceat(np.nan_to_num(s.readings) * valid[:, :, None], edges[:-1], axis=0)
    enough = of_span > _HEARD * np.diff(edges)[:, None]
    mean = np.where(enough[:, :, None], total / of_span.clip(1)[:, :, None], np.nan)
    return np.repeat(np.arange(count), np.diff(edges)), mean


def _mean(directions: F64) -> F64:
    """(U, 3) mean of directions (P, U, 3), of which some may be NaN."""
    known = np.isfinite(directions)
    total = np.where(known, directions, 0.0).sum(axis=0)
    return np.asarray(total / np.linalg.norm(total, axis=1, keepdims=True).clip(1e-12))
