"""Sort the samples of many sources by source while they come in, without a second copy of all."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skin2urdf.arrays import F64, Int

# Samples that are sorted at once: some 20 MB, and hundreds of each of a thousand sources.
GROUP = 1 << 19


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
    """Takes in samples as they come, and gives back those of each source in their order."""

    _waiting: list[Part] = field(default_factory=list)
    _count: int = 0
    _bounds: list[Int] = field(default_factory=list)
    _groups: list[list[NDArray[np.generic] | None]] = field(default_factory=list)

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
        # One kind of numbers after the other, so that no more than the largest is there twice.
        kinds = [self._of_each_source(kind, sources) for kind in range(4)]
        self._bounds, self._groups = [], []
        return [Columns(*columns) for columns in zip(*kinds, strict=True)]

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
            [
                np.concatenate([part.stamp for part in parts])[order],
                np.concatenate([part.log_time for part in parts])[order],
                np.concatenate([part.vector for part in parts])[order],
                _sorted_rates(parts, order),
            ]
        )

    def _of_each_source(self, kind: int, sources: int) -> list[NDArray[np.generic] | None]:
        """One kind of numbers of each source, taken out of the groups."""
        columns = [group[kind] for group in self._groups]
        for group in self._groups:
            group[kind] = None
        if all(column is None for column in columns):
            return [None] * sources
        found: list[NDArray[np.generic] | None] = []
        for k in range(sources):
            pieces: list[NDArray[np.generic]] = []
            for column, bounds in zip(columns, self._bounds, strict=True):
                if k + 1 >= bounds.size or bounds[k] == bounds[k + 1]:
                    continue
                rows = slice(bounds[k], bounds[k + 1])
                pieces.append(_none(rows) if column is None else column[rows])
            found.append(pieces[0].copy() if len(pieces) == 1 else np.concatenate(pieces))
        return found


def _none(rows: slice) -> F64:
    """Angular velocities that are not there."""
    return np.full((rows.stop - rows.start, 3), np.nan)


def _sorted_rates(parts: list[Part], order: Int) -> F64 | None:
    """Angular velocities of some parts; those that never change take no memory."""
    if all(part.rates is None for part in parts):
        return None
    rates = np.concatenate(
        [np.full(part.vector.shape, np.nan) if part.rates is None else part.rates for part in parts]
    )
    if np.array_equal(rates, np.broadcast_to(rates[0], rates.shape), equal_nan=True):
        return np.broadcast_to(rates[0], rates.shape)
    return rates[order]
