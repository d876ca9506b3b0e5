"""Clocks and messages on the way from a sensor into a log."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from skin2urdf.arrays import F64, frozen
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.records import JointStream, SuStream
from skin2urdf.simulation.defects.records import Defect
from skin2urdf.simulation.sensors import MIN_STAMP_STEP


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
class UnsteadyClock(Defect):
    """The SUs' common clock is slewed to and fro, or set anew in mid-log, as by the network's time.

    Attributes:
        slewed: amplitude of a wave of lateness [s].
        period: of that wave [s].
        stepped: by how much later it stamps after two thirds of the log [s].
    """

    slewed: float = 5e-3
    period: float = 60.0
    stepped: float = 0.0

    def clock(self, time: F64, rng: np.random.Generator) -> F64:
        """Now earlier, now later; all SUs alike."""
        since = time - time[0]
        wave = self.slewed * np.sin(2 * np.pi * since / self.period)
        return np.asarray(time + wave + self.stepped * (since > since[-1] / 1.5))


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
class HeldPositions(Defect):
    """A controller that publishes its joints more often than it reads them.

    Attributes:
        times: how often it sends the same positions.
    """

    times: int = 4

    def publish(
        self, joints: tuple[JointStream, ...], rng: np.random.Generator
    ) -> tuple[JointStream, ...]:
        """All positions at their own time and at those after it."""

        def held(joint: JointStream) -> JointStream:
            first = np.arange(len(joint.time)) // self.times * self.times
            return replace(joint.at(first), time=joint.time)

        return tuple(map(held, joints))


@dataclass(frozen=True)
class ReadInTurn(Defect):
    """Servos on a bus, of which each is read some time after the one before, under one stamp.

    Attributes:
        apart: that time [s]; the last of them is read when the message is stamped.
    """

    apart: float = 3e-3

    def publish(
        self, joints: tuple[JointStream, ...], rng: np.random.Generator
    ) -> tuple[JointStream, ...]:
        """Each joint where it was when it was read."""

        def earlier(joint: JointStream, by: float) -> JointStream:
            read = _read_times(joint)
            at = np.clip(read - by, 0.0, None)
            effort = joint.effort
            if effort is not None:
                effort = frozen(CubicSpline(read, effort)(at))
            position = CubicSpline(read, joint.position)(at)
            if step := _encoder_step(joint.position):
                position = step * np.rint(position / step)
            return replace(joint, position=frozen(position), effort=effort)

        turns = range(len(joints) - 1, -1, -1)
        return tuple(earlier(j, n * self.apart) for j, n in zip(joints, turns, strict=True))


@dataclass(frozen=True)
class SmoothedPositions(Defect):
    """A driver that publishes means of the positions that it has read last.

    Attributes:
        over: time that a mean goes over [s].
    """

    over: float = 0.1

    def publish(
        self, joints: tuple[JointStream, ...], rng: np.random.Generator
    ) -> tuple[JointStream, ...]:
        """Positions that lag behind, and have less of fast motion."""

        def smoothed(joint: JointStream) -> JointStream:
            # The mean of what goes from sample to sample in straight lines, by its integral.
            since = _read_times(joint)
            steps = 0.5 * (joint.position[1:] + joint.position[:-1]) * np.diff(since)
            integral = make_interp_spline(since, np.append(0.0, np.cumsum(steps)), k=3)
            begin = since - self.over
            before = np.where(begin < 0, begin * joint.position[0], integral(begin.clip(min=0.0)))
            return replace(joint, position=frozen((integral(since) - before) / self.over))

        return tuple(map(smoothed, joints))


@dataclass(frozen=True)
class OnChange(Defect):
    """A publisher that sends its joints where one of them has changed, and seldom else.

    Attributes:
        every: time after which it sends them all the same [s].
    """

    every: float = 1.0

    def publish(
        self, joints: tuple[JointStream, ...], rng: np.random.Generator
    ) -> tuple[JointStream, ...]:
        """Messages in which a position differs from the one before, and those of a timer."""
        positions = np.stack([joint.position for joint in joints])
        sent = np.append(True, (np.diff(positions, axis=1) != 0).any(axis=0))
        time = joints[0].time
        sent[np.searchsorted(time, np.arange(float(time[0]), float(time[-1]), self.every))] = True
        return tuple(joint.at(sent) for joint in joints)


@dataclass(frozen=True)
class Glitches(Defect):
    """Single positions that were read wrongly: as zero, or as what the encoder holds otherwise.

    Attributes:
        share: part of the positions of each joint.
    """

    share: float = 1e-3

    def publish(
        self, joints: tuple[JointStream, ...], rng: np.random.Generator
    ) -> tuple[JointStream, ...]:
        """Some positions of each joint replaced, by zero or by any within its range."""
        out = []
        for joint in joints:
            position = np.array(joint.position)
            struck = np.flatnonzero(rng.random(len(position)) < self.share)
            anywhere = rng.uniform(position.min(), position.max(), len(struck))
            position[struck] = np.where(rng.random(len(struck)) < 0.5, 0.0, anywhere)
            out.append(replace(joint, position=position))
        return tuple(out)


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


@dataclass(frozen=True)
class Bursts(Defect):
    """A driver that empties a buffer and stamps all that was in it then.

    Attributes:
        times: readings that fill it.
        late: mean time until it is emptied, exponentially distributed [s].
        lost: part of the messages that never arrive.
        apart: time that sending one of them takes [s].
    """

    times: int = 4
    late: float = 5e-4
    lost: float = 0.05
    apart: float = 2e-5

    def send(self, stream: SuStream, rng: np.random.Generator) -> SuStream:
        """Each reading with the time at which the last one of its buffer was sent."""
        n, first = len(stream.time), int(rng.integers(self.times))
        burst = (np.arange(n) + first) // self.times
        full = np.minimum((burst + 1) * self.times - 1 - first, n - 1)
        sent = stream.time[full] + rng.exponential(self.late, burst[-1] + 1)[burst]
        return replace(stream, time=_in_order(sent, self.apart)).at(rng.random(n) >= self.lost)


@dataclass(frozen=True)
class OwnRates(Defect):
    """SUs that send less often, each as seldom as it likes.

    Attributes:
        most: an SU sends every first to every so manieth of its samples.
    """

    most: int = 3

    def send(self, stream: SuStream, rng: np.random.Generator) -> SuStream:
        """Every so manieth sample."""
        return stream.at(slice(None, None, int(rng.integers(1, self.most + 1))))


class _Arriving(ABC):
    """Stamps made where messages arrive, of joints and of SUs; no message overtakes another."""

    @abstractmethod
    def arrival(self, time: F64, rng: np.random.Generator) -> F64:
        """(N,) times at which messages that were sent at (N,) times arrive [s]."""

    def send(self, stream: SuStream, rng: np.random.Generator) -> SuStream:
        """An SU's stream with the times of arrival."""
        return replace(stream, time=_in_order(self.arrival(stream.time, rng)))

    def publish(
        self, joints: tuple[JointStream, ...], rng: np.random.Generator
    ) -> tuple[JointStream, ...]:
        """The joints' streams; those in one message arrive together."""
        times = {id(joint.time): joint.time for joint in joints}
        arrived = {key: _in_order(self.arrival(time, rng)) for key, time in times.items()}
        return tuple(replace(joint, time=arrived[id(joint.time)]) for joint in joints)


@dataclass(frozen=True)
class OnArrival(_Arriving, Defect):
    """Messages that are on their way for a while: none early, some late.

    Attributes:
        late: mean of the times on the way, which are exponentially distributed [s].
    """

    late: float = 2e-3

    def arrival(self, time: F64, rng: np.random.Generator) -> F64:
        """Each late by itself."""
        return time + rng.exponential(self.late, len(time))


@dataclass(frozen=True)
class Stalls(_Arriving, Defect):
    """A way on which nothing moves for a moment, now and then: messages queue, and come at once.

    Attributes:
        every: mean time from one stall to the next [s].
        longest: a stall lasts for any part of it [s].
    """

    every: float = 5.0
    longest: float = 0.25

    def arrival(self, time: F64, rng: np.random.Generator) -> F64:
        """What is sent during a stall comes at its end."""
        n = 2 + int(2 * (time[-1] - time[0]) / self.every)
        begins = time[0] + np.cumsum(rng.exponential(self.every, n))
        ends = begins + self.longest * rng.random(n)
        stall = np.searchsorted(begins, time, side="right") - 1
        return np.where(stall >= 0, np.maximum(time, ends[stall]), time)


@dataclass(frozen=True)
class SecondPublisher(Defect):
    """Some joints come in messages of their own, stamped by another clock than the others'.

    Each publisher sends every other of the messages, so that no two stamps are alike.

    Attributes:
        late: how much later than the others' its clock stamps in the middle of the log [s].
        drift: by how much it gains [s/s].
        names: joints that it publishes; None for the second half of them in the order of their
            names.
    """

    late: float = 0.1
    drift: float = 0.0
    names: tuple[str, ...] | None = None

    def publish(
        self, joints: tuple[JointStream, ...], rng: np.random.Generator
    ) -> tuple[JointStream, ...]:
        """Two streams of messages, the second late."""
        names = self.names
        if names is None:
            names = tuple(joint.name for joint in joints[(len(joints) + 1) // 2 :])
        time = joints[0].time
        since_middle = time[1::2] - (time[0] + time[-1]) / 2
        stamps = frozen(time[1::2] + self.late + self.drift * since_middle)
        others = frozen(time[::2])

        def sent(joint: JointStream) -> JointStream:
            part, own = (
                (slice(1, None, 2), stamps) if joint.name in names else (slice(0, None, 2), others)
            )
            return replace(joint.at(part), time=own)

        return tuple(map(sent, joints))


def _in_order(late: F64, apart: float = MIN_STAMP_STEP) -> F64:
    """Increasing times of messages of which none overtakes another.

    Args:
        late: (N,) when each could arrive [s].
        apart: time between two that wait for each other, at least [s].
    """
    ramp = apart * np.arange(len(late))
    return frozen(np.maximum.accumulate(late - ramp) + ramp)


def _read_times(joint: JointStream) -> F64:
    """(M,) times since the first at which positions were read, at an even rate [s].

    What a driver makes of positions it makes of them as it has read them: stamps scatter after.
    """
    steps = np.diff(joint.time)
    usual = float(np.median(steps))
    # Where messages are lost, time goes on.
    return np.append(0.0, np.cumsum(usual * np.rint(steps / usual).clip(min=1.0)))


def _encoder_step(position: F64) -> float:
    """Step of the encoder that positions (M,) were read by [rad or m]; 0 where they are exact."""
    counted = np.unique(position)
    step = float(np.diff(counted).min(initial=np.inf))
    if not np.isfinite(step):
        return 0.0
    return step if np.abs(counted / step - np.rint(counted / step)).max() < 1e-3 else 0.0
