"""Gather the samples of a log by topic and source, as they were recorded."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.recording.blocks import Block, Channels
from skin2urdf.recording.cdr import Passed, accelerations
from skin2urdf.recording.credibility import real_rates
from skin2urdf.recording.gather import grouped
from skin2urdf.recording.joint_states import joint_positions
from skin2urdf.recording.messages import (
    ACCELERATION_LEAD,
    ACCELERATION_TAIL,
    ANGULAR_VELOCITY_LEAD,
    ENCODINGS,
    role_of,
)


class Samples(NamedTuple):
    """Samples of one source in the order of the log.

    Attributes:
        arrival: (N,) numbers that rise as the messages follow each other in the log.
        stamp: (N,) header stamps [ns], 0 where unset.
        log_time: (N,) times the messages were recorded [ns].
        values: (N, C) what was measured.
        rates: (N, 3) what a gyroscope measured beside it [rad/s], NaN where that is missing; None
            where there is none.
    """

    arrival: Int
    stamp: Int
    log_time: Int
    values: F64
    rates: F64 | None = None

    def at(self, keep: Int | Bool) -> Samples:
        """Return some of the samples."""
        rates = None if self.rates is None else self.rates[keep]
        return Samples(
            self.arrival[keep], self.stamp[keep], self.log_time[keep], self.values[keep], rates
        )


@dataclass(eq=False)
class Collector:
    """Takes in blocks of messages and keeps what a calibration needs of them.

    Attributes:
        channels: the channels of the log.
        passed: per topic, why messages were passed over (reason: messages).
    """

    channels: Channels
    passed: defaultdict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    _sources: dict[tuple[int, str], int] = field(default_factory=dict)
    _parts: list[_Part] = field(default_factory=list)
    _joints: dict[tuple[str, tuple[str, ...]], list[Samples]] = field(default_factory=dict)
    _arrived: int = 0

    def add(self, block: Block) -> None:
        """Take in the messages of one block.

        Args:
            block: messages of a type that `role_of` does not ignore.
        """
        if block.encoding not in ENCODINGS:
            reason = f"encoded as {block.encoding!r}, not as ROS does"
            passed: Passed = [(reason, np.arange(block.start.size))]
        elif role_of(block.ros_type) == "joints":
            passed = self._add_joints(block)
        else:
            passed = self._add_accelerations(block)
        self._arrived += block.start.size
        for reason, rows in passed:
            counts = np.bincount(block.channel[rows], minlength=1)
            for number in np.flatnonzero(counts):
                self.passed[self._topic(int(number))][reason] += int(counts[number])

    def _topic(self, number: int) -> str:
        return self.channels.known[number].topic

    def _add_joints(self, block: Block) -> Passed:
        """Take in JointState messages."""
        found, passed = joint_positions(block)
        for part in found:
            arrival = self._arrived + part.row
            samples = Samples(arrival, part.stamp, part.log_time, part.position)
            key = self._topic(part.channel), part.names
            self._joints.setdefault(key, []).append(samples)
        return passed

    def _add_accelerations(self, block: Block) -> Passed:
        """Take in messages that carry an acceleration."""
        ros_type = block.ros_type
        found, passed = accelerations(
            block,
            ACCELERATION_LEAD.get(ros_type, 0),
            ACCELERATION_TAIL[ros_type],
            ANGULAR_VELOCITY_LEAD.get(ros_type),
        )
        parts = []
        for part in found:
            pair = block.channel[part.row] * len(part.frames) + part.frame
            source = np.empty(pair.size, np.uint32)
            for rows in grouped(pair):
                number, frame = divmod(int(pair[rows[0]]), len(part.frames))
                key = number, part.frames[frame]
                source[rows] = self._sources.setdefault(key, len(self._sources))
            parts.append(
                _Part(part.row, source, part.stamp, part.log_time, part.vector, part.rates)
            )
        if len(parts) > 1:
            # Both byte orders in one block: back into the order of the log.
            order = np.argsort(np.concatenate([part.row for part in parts]))
            row, source, stamp, log_time, vector = (
                np.concatenate(arrays)[order]
                for arrays in zip(*(part[:5] for part in parts), strict=True)
            )
            rates = _joined_rates(parts)
            rates = None if rates is None else rates[order]
            parts = [_Part(row, source, stamp, log_time, vector, rates)]
        self._parts += parts
        return passed

    def accelerations(self) -> dict[tuple[str, str], Samples]:
        """Return the samples of every SU, by topic and frame_id."""
        # Channels of one topic and frame_id, of several files say, are one source.
        keys = [(self._topic(number), frame) for number, frame in self._sources]
        names = sorted(set(keys))
        place = {name: k for k, name in enumerate(names)}
        if not names:
            return {}
        small = np.uint16 if len(names) <= 1 << 16 else np.uint32
        rank = np.array([place[key] for key in keys], small)
        # NumPy sorts numbers of 16 bits by radix.
        source = rank[np.concatenate([part.source for part in self._parts])]
        order = np.argsort(source, kind="stable")
        ends = np.cumsum(np.bincount(source, minlength=len(names)))[:-1]
        columns = [
            np.split(np.concatenate([part[k] for part in self._parts])[order], ends)
            for k in range(2, 5)
        ]
        rates = _joined_rates(self._parts)
        turning: list[F64 | None] = [None] * len(names)
        if rates is not None:
            turning = [real_rates(each) for each in np.split(rates[order], ends)]
        self._parts = []
        return {
            name: Samples(np.arange(stamp.size), stamp, log_time, vector, own)
            for name, stamp, log_time, vector, own in zip(names, *columns, turning, strict=True)
        }

    def joints(self) -> dict[tuple[str, tuple[str, ...]], Samples]:
        """Return joint positions by topic and names.

        Joints that always come together share one entry, whatever the order in the messages, and
        joints that come in several companies are joined into one sequence.
        """
        merged: dict[tuple[str, tuple[str, ...]], Samples] = {}
        by_topic: dict[str, dict[tuple[str, ...], Samples]] = {}
        for (topic, names), parts in sorted(self._joints.items(), key=lambda item: item[0]):
            by_topic.setdefault(topic, {})[names] = _joined(parts)
        for topic, companies in by_topic.items():
            places: dict[str, dict[int, int]] = {}
            for company, names in enumerate(companies):
                for column, name in enumerate(names):
                    places.setdefault(name, {})[company] = column
            membership: dict[tuple[int, ...], list[str]] = {}
            for name in sorted(places):
                membership.setdefault(tuple(places[name]), []).append(name)
            samples = list(companies.values())
            for held_by, members in membership.items():
                parts = [
                    _columns(samples[company], [places[name][company] for name in members])
                    for company in held_by
                ]
                merged[topic, tuple(members)] = _joined(parts)
        return merged


class _Part(NamedTuple):
    """Accelerations out of one block.

    Attributes:
        row: (N,) number of each message within its block, rising.
        source: (N,) number of the pair of channel and frame_id.
        stamp: (N,) header stamps [ns].
        log_time: (N,) times the messages were recorded [ns].
        vector: (N, 3) accelerations.
        rates: (N, 3) angular velocities; None where there are none.
    """

    row: Int
    source: NDArray[np.uint32]
    stamp: Int
    log_time: Int
    vector: F64
    rates: F64 | None


def _joined_rates(parts: list[_Part]) -> F64 | None:
    """Angular velocities of several blocks, NaN for those without; None where none has any."""
    if all(part.rates is None for part in parts):
        return None
    return np.concatenate(
        [np.full(part.vector.shape, np.nan) if part.rates is None else part.rates for part in parts]
    )


def _columns(samples: Samples, columns: list[int]) -> Samples:
    """Return some columns, by reference where these are all."""
    if columns == list(range(samples.values.shape[1])):
        return samples
    return samples._replace(values=samples.values[:, columns])


def _joined(parts: list[Samples]) -> Samples:
    """Join samples of one source in the order of the log."""
    if len(parts) == 1:
        joined = parts[0]
    else:
        joined = Samples(
            *(np.concatenate(arrays) for arrays in zip(*(part[:4] for part in parts), strict=True))
        )
    if (np.diff(joined.arrival) < 0).any():
        joined = joined.at(np.argsort(joined.arrival, kind="stable"))
    return joined
