"""Activity that no tree has: closed loops, coupled DoFs, missed reactions (paper II-A.2, II-B.3).

In a tree the sets of SUs beyond any two joints nest or are disjoint. Two sets that cross violate
a constraint. What explains the crossings is searched among three causes, each of which says how
the matrix would look without it; the cause that leaves the fewest crossings is the one reported.

Not every violation makes sets cross: a DoF that drags along all that hangs beside it looks like its
parent, and DoFs that always move together look like one joint.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skin2urdf.arrays import Bool, Int

Cause = Literal["coupled DoFs", "missed reaction", "closed loop"]
_PAIRS_WEIGHED = 24
"""Crossing pairs looked at in each step; a matrix with many more is beyond explanation anyway."""

_PREFERENCE: tuple[Cause, ...] = ("coupled DoFs", "missed reaction", "closed loop")


@dataclass(frozen=True, eq=False)
class Crossing:
    """An explanation of joints whose sets of SUs cross.

    Attributes:
        cause: what it is.
        joints: columns concerned. Closed loop: the joints that the segments hang on. Coupled:
            the joint that drives, then the joint that is dragged along. Missed reaction: the
            joint not reacted to, then the joint beyond it.
        segments: rows concerned: the segments on the loop, those dragged along, or those that
            missed the reaction.
    """

    cause: Cause
    joints: tuple[int, ...]
    segments: tuple[int, ...]


def crossing_pairs(merged: Bool) -> list[tuple[int, int]]:
    """Pairs of columns whose sets of rows neither nest nor are disjoint.

    Args:
        merged: (S, J) merged activity matrix.
    """
    M = merged.astype(np.int64)
    both = M.T @ M
    size = np.diagonal(both)
    cross = (both > 0) & (both < size[:, None]) & (both < size[None, :])
    return [(int(a), int(b)) for a, b in np.argwhere(np.triu(cross))]


def explain_crossings(merged: Bool, weights: Int) -> tuple[Crossing, ...]:
    """What makes the columns of a matrix cross; empty for the matrix of a tree.

    Args:
        merged: (S, J) merged activity matrix.
        weights: (S,) number of SUs on each segment.
    """
    found: list[Crossing] = []
    matrix = merged.copy()
    while pairs := crossing_pairs(matrix):
        options = [
            _Option(len(pairs) + change.more_crossings(matrix), change)
            for pair in pairs[:: 1 + len(pairs) // _PAIRS_WEIGHED]
            for change in _explanations(matrix, weights, *pair)
        ]
        best = _best(options, len(pairs)).change
        found.append(best.crossing)
        matrix[:, best.column] = best.entries
    return tuple(_joined(found))


@dataclass(frozen=True, eq=False)
class _Change:
    """An explanation, the column that would be different without it, and the SUs it would change.

    Of a closed loop the number of SUs is not counted.
    """

    crossing: Crossing
    column: int
    entries: Bool
    weight: int = 0

    @property
    def key(self) -> tuple[int, bytes]:
        """The same for the same change."""
        return self.column, self.entries.tobytes()

    def more_crossings(self, M: Bool) -> int:
        """Number of crossing columns with the change, less that without it."""
        others = np.delete(M, self.column, axis=1)
        return _n_crossing(self.entries, others) - _n_crossing(M[:, self.column], others)


@dataclass(frozen=True)
class _Option:
    """A change and the number of crossings left after it."""

    left: int
    change: _Change

    def effort(self) -> tuple[int, int]:
        """What to keep small: crossings left, and SUs changed."""
        return self.left, self.change.weight


def _n_crossing(column: Bool, others: Bool) -> int:
    both = (others & column[:, None]).any(axis=0)
    only_column = (~others & column[:, None]).any(axis=0)
    only_other = (others & ~column[:, None]).any(axis=0)
    return int((both & only_column & only_other).sum())


def _best(options: list[_Option], n_pairs: int) -> _Option:
    """The explanation that leaves the fewest crossings."""
    by_cause = {
        cause: [o for o in options if o.change.crossing.cause == cause] for cause in _PREFERENCE
    }
    # To take only what helps also ends the search: the other causes clear entries, none sets any.
    # Different pairs can ask for the same change.
    missed = {o.change.key: o for o in by_cause["missed reaction"][::-1] if o.left < n_pairs}
    first = min(missed.values(), key=_Option.effort, default=None)
    # A missed reaction is only one where it is clear who missed what.
    clear = [o for o in missed.values() if first and o.effort() == first.effort()]
    # That a few SUs err is likelier than that many are dragged along.
    coupled = [
        o
        for o in by_cause["coupled DoFs"]
        if not first or first.left > o.left or 2 * first.change.weight > o.change.weight
    ]
    candidates = coupled + (clear if len(clear) == 1 else []) + by_cause["closed loop"]
    return min(candidates, key=lambda o: (o.left, _PREFERENCE.index(o.change.crossing.cause)))


def _explanations(M: Bool, weights: Int, a: int, b: int) -> Iterator[_Change]:
    """Explanations of one crossing pair."""
    both = M[:, a] & M[:, b]
    # What is beyond the segment that closes a loop hangs on its joints too, but does not close it.
    closing = [s for s in _rows(both) if not any(_within(M[r], M[s]) for r in _rows(both))]
    yield _Change(Crossing("closed loop", (a, b), tuple(closing)), b, M[:, b] & ~both)
    for d, e in ((a, b), (b, a)):
        missing = M[:, e] & ~M[:, d]
        weight = int(weights[missing].sum())
        if 2 * weight <= weights[both].sum():
            crossing = Crossing("missed reaction", (d, e), _rows(missing))
            yield _Change(crossing, d, M[:, d] | missing, weight)
        only = M[:, d] & ~M[:, e]
        for y in range(M.shape[1]):
            dragged = M[:, y]
            # Without what it drags along, d must not cross e any more: one side of it is left.
            if y not in (a, b) and (np.array_equal(dragged, both) or np.array_equal(dragged, only)):
                crossing = Crossing("coupled DoFs", (d, y), _rows(dragged))
                yield _Change(crossing, d, M[:, d] & ~dragged, int(weights[dragged].sum()))


def _within(inner: Bool, outer: Bool) -> bool:
    """True where a row's ones are a true subset of another's."""
    return bool((outer | ~inner).all()) and bool((outer & ~inner).any())


def _rows(mask: Bool) -> tuple[int, ...]:
    return tuple(int(r) for r in np.flatnonzero(mask))


def _joined(crossings: list[Crossing]) -> Iterator[Crossing]:
    """Loops through the same segments as one."""
    loops: dict[tuple[int, ...], list[int]] = {}
    for c in crossings:
        if c.cause == "closed loop":
            loops.setdefault(c.segments, []).extend(c.joints)
        else:
            yield c
    for segments, joints in loops.items():
        yield Crossing("closed loop", tuple(sorted(set(joints))), segments)
