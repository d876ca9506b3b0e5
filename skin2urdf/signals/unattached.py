"""SUs that move while no joint does: they are not on the robot, or hang on it freely.

A log of all topics holds the accelerometers of other things as well, such as those of a vehicle, a
camera in a hand or a second robot. What sits on a robot is still where all joints are, and so is
what sits on its base; what moves on its own changes as much then as at any other time.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.records import SuStream

_SHORTEST = 0.3
"""Length [s] of a rest from which its halves tell whether an SU changes in it."""
_CHANCE = 6.0
"""Standard deviations of noise that no difference of two means exceeds by chance."""
_OWN = 3e-3 * GRAVITY
"""Change [m/s^2] that a sensor may show by itself within seconds: ten times its usual flicker."""
_OF_MOTION = 0.2
"""Part of an SU's own usual change while joints move up to which it rests: links ring after a stop,
and give way to a hand."""
_COMMON = 3.0
"""Change of an SU over that of the others in the same rest, up to which it is the base that moves,
of which no SU feels more than all do, but for what its arm adds."""
_FEWEST = 5
"""Rests in which an SU changes, from which it is no hit."""
_AS_OFTEN = 0.5
"""How often an SU changes in rests over how often it does in stretches as long while joints move,
from which it has nothing to do with these."""


def unattached(
    sus: Sequence[SuStream], rests: Sequence[tuple[float, float]], noise: F64, digit: F64
) -> Bool:
    """(U,) True for SUs that move as often while all joints rest as while they move.

    Args:
        sus: U streams.
        rests: begin and end of the times at which all joints rest [s], in their order.
        noise: (U,) standard deviations of their noise [m/s^2].
        digit: (U,) their digits, 0 where they have none [m/s^2].
    """
    still = np.array([rest for rest in rests if rest[1] - rest[0] >= _SHORTEST]).reshape(-1, 2)
    if len(still) < _FEWEST or len(sus) < 2:
        return np.zeros(len(sus), dtype=bool)
    length = float(np.median(np.diff(still, axis=1)))
    moving = [
        (begin, begin + length)
        for (_, a), (b, _) in pairwise(rests)
        for begin in np.arange(a, b - length, length)
    ]
    at_rest, chance = _changes(sus, still, noise)
    in_motion, _ = _changes(sus, np.array(moving).reshape(-1, 2), noise)
    usual = np.array(
        [np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else 0 for c in in_motion]
    )
    least = np.maximum(_OWN + digit, _OF_MOTION * usual)[:, None]
    others = np.array([_median(np.delete(at_rest, u, axis=0)) for u in range(len(sus))])
    stirred = (at_rest > np.maximum(least, _CHANCE * chance)) & (at_rest > _COMMON * others)
    moved = in_motion > least
    often = stirred.sum(axis=1) / np.maximum(np.isfinite(at_rest).sum(axis=1), 1)
    as_often = moved.sum(axis=1) / np.maximum(np.isfinite(in_motion).sum(axis=1), 1)
    return np.asarray((stirred.sum(axis=1) >= _FEWEST) & (often > _AS_OFTEN * as_often))


def _changes(sus: Sequence[SuStream], spans: F64, noise: F64) -> tuple[F64, F64]:
    """(U, R) change between the means of both halves of R spans, and what noise makes of it.

    Changes are NaN where a half has no reading [m/s^2].

    Args:
        sus: U streams.
        spans: (R, 2) begin and end [s].
        noise: (U,) standard deviations of noise [m/s^2].
    """
    change = np.full((len(sus), len(spans)), np.nan)
    chance = np.zeros_like(change)
    middle = spans.mean(axis=1)
    for u, su in enumerate(sus):
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(su.specific_force, axis=0)])
        edges = [np.searchsorted(su.time, at) for at in (spans[:, 0], middle, spans[:, 1])]
        counts = [b - a for a, b in pairwise(edges)]
        known = (counts[0] > 0) & (counts[1] > 0)
        first, second = (
            (total[b] - total[a]) / np.maximum(n, 1)[:, None]
            for (a, b), n in zip(pairwise(edges), counts, strict=True)
        )
        change[u, known] = np.linalg.norm(second - first, axis=1)[known]
        chance[u] = noise[u] * np.sqrt(sum(1 / np.maximum(n, 1) for n in counts))
        su.put_away()
    return change, chance


def _median(changes: F64) -> F64:
    """(R,) median of the known ones of each column of (U, R); 0 where none is."""
    known = np.isfinite(changes)
    filled = np.where(known, changes, np.inf)
    order = np.sort(filled, axis=0)
    middle = np.maximum(known.sum(axis=0) - 1, 0) // 2
    out = np.take_along_axis(order, middle[None], axis=0)[0]
    return np.asarray(np.where(np.isfinite(out), out, 0.0))
