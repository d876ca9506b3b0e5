"""Clocks and messages on the way from a sensor into a log."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.records import SuStream
from skin2urdf.simulation.defects.records import Defect


@dataclass(frozen=True)
class SuClock(Defect):
    """The SUs' clock is not that of the joints.

    Attributes:
        offset: how much later than the truth it stamps in the beginning [s].
        drift: how much later still with every second, as a part.
        common: one clock for all SUs; else each draws its own offset and drift, up to these.
    """

    offset: float = 0.0
    drift: float = 0.0
    common: bool = True

    def clock(self, time: F64, rng: np.random.Generator) -> F64:
        """Late, and later and later."""
        offset, drift = (1.0, 1.0) if self.common else rng.uniform(-1.0, 1.0, 2)
        return np.asarray(time + offset * self.offset + drift * self.drift * (time - time[0]))


@dataclass(frozen=True)
class Held(Defect):
    """A driver that sends every value several times.

    Attributes:
        times: how often.
    """

    times: int = 2

    def send(self, stream: SuStream, rng: np.random.Generator) -> SuStream:
        """Each value at its own time and at those after it."""
        first = np.arange(len(stream.time)) // self.times * self.times
        return replace(stream.at(first), time=stream.time)


@dataclass(frozen=True)
class Spikes(Defect):
    """Single readings that are far off.

    Attributes:
        share: part of the readings.
        size: how far off an axis of theirs is, at most [g].
    """

    share: float = 1e-3
    size: float = 2.0

    def send(self, stream: SuStream, rng: np.random.Generator) -> SuStream:
        """One axis of some readings off by up to the size."""
        force = np.array(stream.specific_force)
        struck = np.flatnonzero(rng.random(len(force)) < self.share)
        axis = rng.integers(3, size=len(struck))
        force[struck, axis] += self.size * GRAVITY * rng.uniform(-1.0, 1.0, len(struck))
        return replace(stream, specific_force=force)


@dataclass(frozen=True)
class Lost(Defect):
    """Messages that never arrive.

    Attributes:
        share: part of the messages.
    """

    share: float = 0.02

    def send(self, stream: SuStream, rng: np.random.Generator) -> SuStream:
        """What is left."""
        kept = rng.random(len(stream.time)) >= self.share
        return stream.at(kept)
