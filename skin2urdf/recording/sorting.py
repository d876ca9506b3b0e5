"""Sort the samples of many sources by source while they come in, without a second copy of all.

What is sorted is put on a shelf, so that it need not stay in memory.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.shelf import Shelf

# Samples that are sorted at once: some 10 MB, and hundreds of each of a thousand sources.
GROUP = 1 << 18


class Part(NamedTuple):
    """Samples out of one block, in the order of the log.

    Attributes:
        source: (N,) number of each sample's source.
        stamp: (N,) header stamps [ns].
        log_time: (N,) times the messages were recorded [ns].
        vector: (N, 3) accelerations.
        rates: (N, 3) angular velocities [rad/s]; None where the messages have none.
    """

    source: NDArray[np.uint32]
    stamp: Int
    log_time: Int
    vector: F64
    rates: F64 | None = None


class Columns(NamedTuple):
    """All samples of one source: stamps, log times, accelerations and angular velocities."""

    stamp: Int
    log_time: Int
    vector: F64
    rates: F64 | None


@dataclass(eq=False)
class SortedSamples:
    """Takes in samples as they come, and gives back those of each source in their order.

    Attributes:
        shelf: where they are kept.
    """

    shelf: Shelf = field(default_factory=Shelf)
    _waiting: list[Part] = field(default_factory=list)
    _count: int = 0
    _bounds: list[Int] = field(default_factory=list)
    _groups: list[Columns] = field(default_factory=list)

    def add(self, part: Part) -> None:
        """Take in some samples."""
        self._waiting.append(part)
        self._count += part.stamp.size
        if self._count >= GROUP:
            self._sort()

    def take(self, sources: int) -> list[Columns]:
        """Give all samples back; nothing is kept.

        Args:
            sources: how many sources there are.
        """
        self._sort()
        counts = np.zeros(sources, np.int64)
        for bounds in self._bounds:
            counts[: bounds.size - 1] += np.diff(bounds)
        constant = _constant([group.rates for group in self._groups])
        # Pages that nothing was written to take no memory: these fill as the groups are given up.
        found = [self._empty(int(count), constant) for count in counts]
        done = np.zeros(sources, np.int64)
        for bounds in self._bounds:
            group = self._groups.pop(0)
            for k in np.flatnonzero(np.diff(bounds)):
                rows = slice(bounds[k], bounds[k + 1])
                here = slice(done[k], done[k] + bounds[k + 1] - bounds[k])
                whole = found[k]
                whole.stamp[here] = group.stamp[rows]
                whole.log_time[here] = group.log_time[rows]
                whole.vector[here] = group.vector[rows]
                if constant is None and whole.rates is not None:
                    whole.rates[here] = np.nan if group.rates is None else group.rates[rows]
                done[k] = here.stop
            self.shelf.put_away()
        self._bounds = []
        return found

    def _sort(self) -> None:
        """Sort what is waiting by source."""
        parts, self._waiting, self._count = self._waiting, [], 0
        if not parts:
            return
        source = np.concatenate([part.source for part in parts])
        if int(source.max()) < 1 << 16:
            source = source.astype(np.uint16)  # NumPy sorts numbers of 16 bits by radix.
        order = np.argsort(source, kind="stable")
        self._bounds.append(np.concatenate([[0], np.cumsum(np.bincount(source))]))
        self._groups.append(
            Columns(
                self.shelf.put(np.concatenate([part.stamp for part in parts])[order]),
                self.shelf.put(np.concatenate([part.log_time for part in parts])[order]),
                self.shelf.put(np.concatenate([part.vector for part in parts])[order]),
                self._sorted_rates(parts, order),
            )
        )
        self.shelf.put_away()

    def _sorted_rates(self, parts: list[Part], order: Int) -> F64 | None:
        """Angular velocities of some parts; those that never change take no memory."""
        if all(part.rates is None for part in parts):
            return None
        rates = np.concatenate(
            [
                np.full(part.vector.shape, np.nan) if part.rates is None else part.rates
                for part in parts
            ]
        )
        if np.array_equal(rates, np.broadcast_to(rates[0], rates.shape), equal_nan=True):
            return np.broadcast_to(rates[0], rates.shape)
        return self.shelf.put(rates[order])

    def _empty(self, count: int, constant: F64 | None) -> Columns:
        """Room for so many samples; rates that never change (none if NaN) take none."""
        if constant is None:
            rates = self.shelf.empty((count, 3))
        elif np.isnan(constant).all():
            rates = None
        else:
            rates = np.broadcast_to(constant, (count, 3))
        stamp, log_time = (self.shelf.empty((count,), np.int64) for _ in range(2))
        return Columns(stamp, log_time, self.shelf.empty((count, 3)), rates)


def _constant(rates: list[F64 | None]) -> F64 | None:
    """The (3,) angular velocities that all groups have, NaN for none; None where they differ."""
    rows = [np.full(3, np.nan) if some is None else some[0] for some in rates]
    constant = all(some is None or some.strides[0] == 0 for some in rates)
    if not rows:
        return np.full(3, np.nan)
    if constant and all(np.array_equal(row, rows[0], equal_nan=True) for row in rows):
        return rows[0]
    return None
