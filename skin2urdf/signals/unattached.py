"""SUs that move while no joint does: they are not on the robot, or hang on it freely.

A log of all topics holds the accelerometers of other things as well, such as those of a vehicle, a
camera in a hand or a second robot. What sits on a robot is still where all joints are, and so is
what sits on its base; what moves on its own changes as much then as at any other time.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.records import SuStream
from skin2urdf.signals.clocks import LARGEST_OFFSET

_SHORTEST = 0.3
"""Length [s] of a rest or a move from which its halves tell whether an SU changes in it."""
_CHANCE = 6.0
"""Standard deviations of noise that no difference of two means exceeds by chance."""
_OWN = 3e-3 * GRAVITY
"""Change [m/s^2] that a sensor may show by itself within seconds: ten times its usual flicker."""
_LARGE, _OF_MOTION = 0.9, 0.2
"""Quantile of an SU's changes while joints move that few of them need make, and the part of it up
to which the SU rests: links ring after a stop, and give way to a hand."""
_COMMON = 3.0
"""Change of an SU over that of the others in the same rest, up to which it is the base that moves,
which all SUs feel, some more and some less by their arms."""
_FEWEST = 5
"""Rests in which an SU changes, from which it is no hit."""
_AS_OFTEN = 0.5
"""How often an SU changes in rests over how often it does in moves, in the same time, from which it
has nothing to do with these."""


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
    still = _long(rests)
    moving = _long([(a, b) for (_, a), (b, _) in pairwise(rests)])
    if min(len(still), len(moving)) < _FEWEST or len(sus) < 2:
        return np.zeros(len(sus), dtype=bool)
    # What moves by itself changes by more in a longer time.
    length = min(float(np.median(np.diff(spans))) for spans in (still, moving))
    (still, rest), (moving, _) = _parts(still, length), _parts(moving, length)
    at_rest, chance = _changes(sus, still, noise)
    in_motion, _ = _changes(sus, moving, noise)
    least = np.maximum(_OWN + digit, _OF_MOTION * _quantile(in_motion.T, _LARGE))[:, None]
    # Of what counts only where an SU changes by more than these, it is none itself.
    others = _COMMON * _quantile(at_rest, 0.5, without=1)

    def move_as_often(at_rest: F64, chance: F64, in_motion: F64, least: F64) -> Bool:
        stirred = (at_rest > np.maximum(least, _CHANCE * chance)) & (at_rest > others)
        often, as_often = (
            moved.sum(axis=1) / np.maximum(np.isfinite(changes).sum(axis=1), 1)
            for moved, changes in ((stirred, at_rest), (in_motion > least, in_motion))
        )
        in_rests = np.array([len(np.unique(rest[each])) for each in stirred])
        return np.asarray((in_rests >= _FEWEST) & (often > _AS_OFTEN * as_often))

    found = move_as_often(at_rest, chance, in_motion, least)
    for u in np.flatnonzero(found).tolist():
        # On a clock of its own it may rest and move with the joints at other times than theirs.
        for late in np.arange(-LARGEST_OFFSET, LARGEST_OFFSET + 1e-9, 0.5 * length):
            there = _changes(sus[u : u + 1], still + late, noise[u : u + 1])
            then, _ = _changes(sus[u : u + 1], moving + late, noise[u : u + 1])
            if not move_as_often(*there, then, least[u : u + 1])[0]:
                found[u] = False
                break
    return found


def _long(spans: Sequence[tuple[float, float]]) -> F64:
    """(R, 2) begin and end of those spans that are long enough [s]."""
    chosen = [span for span in spans if span[1] - span[0] >= _SHORTEST]
    return np.array(chosen, dtype=np.float64).reshape(-1, 2)


def _parts(spans: F64, length: float) -> tuple[F64, Int]:
    """Spans (R, 2), those that are longer in parts of some length [s].

    Returns:
        (P, 2) begin and end of the parts [s], and (P,) number of the span that each is of.
    """
    parts = [
        (begin, min(begin + length, end), r)
        for r, (first, end) in enumerate(spans.tolist())
        for begin in np.arange(first, max(end - length, first) + 1e-9, length).tolist()
    ]
    found = np.array(parts)
    return found[:, :2], found[:, 2].astype(np.int64)


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


def _quantile(changes: F64, share: float, without: int = 0) -> F64:
    """(R,) quantile of the known ones of each column of (U, R); 0 where none is.

    Args:
        changes: NaN where not known.
        share: which quantile.
        without: how many, the largest ones of each column, are left out.
    """
    order = np.sort(np.where(np.isfinite(changes), changes, np.inf), axis=0)
    last = np.maximum(np.isfinite(changes).sum(axis=0) - 1 - without, 0)
    out = np.take_along_axis(order, (share * last).astype(np.int64)[None], axis=0)[0]
    return np.asarray(np.where(np.isfinite(out), out, 0.0))
