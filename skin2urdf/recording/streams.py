"""Gather the samples of a log by topic and source, as they were recorded."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, together
from skin2urdf.recording.blocks import Block, Channels
from skin2urdf.recording.cdr import Passed, accelerations
from skin2urdf.recording.credibility import real_rates
from skin2urdf.recording.joint_states import joint_positions
from skin2urdf.recording.messages import (
    ACCELERATION_LEAD,
    ACCELERATION_TAIL,
    ANGULAR_VELOCITY_LEAD,
    ENCODINGS,
    role_of,
)
from skin2urdf.recording.repeated import Layouts
from skin2urdf.recording.shelf import Shelf, put_away
from skin2urdf.recording.sorting import Part, SortedSamples


class Samples(NamedTuple):
    """Samples of one source in the order of the log.

    Attributes:
        stamp: (N,) header stamps [ns], 0 where unset.
        log_time: (N,) times the messages were recorded [ns].
        values: (N, C) what was measured.
        beside: (N, C) what was measured beside it, angular velocities of an SU with a gyroscope
            [rad/s] or efforts of joints [N m or N], NaN where that is missing; None where there is
            none.
    """

    stamp: Int
    log_time: Int
    values: F64
    beside: F64 | None = None

    def at(self, keep: Int | Bool) -> Samples:
        """Return some of the samples."""
        beside = None if self.beside is None else self.beside[keep]
        return Samples(self.stamp[keep], self.log_time[keep], self.values[keep], beside)


class Arrived(NamedTuple):
    """Samples that may have to be put between others of their source.

    Attributes:
        order: (N,) numbers that rise as the messages follow each other in the log.
        samples: the samples.
    """

    order: Int
    samples: Samples


@dataclass(eq=False)
class Collector:
    """Takes in blocks of messages and keeps what a calibration needs of them.

    Attributes:
        channels: the channels of the log.
        shelf: where samples are kept.
        passed: per topic, why messages were passed over (reason: messages).
    """

    channels: Channels
    shelf: Shelf
    passed: defaultdict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    _sources: dict[tuple[str, str], int] = field(default_factory=dict)
    _layouts: Layouts = field(default_factory=Layouts)
    _sorted: SortedSamples = field(init=False)
    _joints: dict[tuple[str, tuple[str, ...]], list[Arrived]] = field(default_factory=dict)
    _arrived: int = 0

    def __post_init__(self) -> None:
        self._sorted = SortedSamples(self.shelf)

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
            samples = Samples(part.stamp, part.log_time, part.position, part.effort)
            key = self._topic(part.channel), part.names
            self._joints.setdefault(key, []).append(Arrived(arrival, samples))
        return passed

    def _add_accelerations(self, block: Block) -> Passed:
        """Take in messages that carry an acceleration."""
        parts: list[Part] = []
        rows_of: list[Int] = []
        again = self._layouts.repeated(block)
        if again is not None:
            source = again.source.astype(np.uint32)
            parts.append(Part(source, again.stamp, again.log_time, again.vector, again.rates))
            if again.rows is None:
                self._sorted.add(parts[0])
                return []
            rows_of.append(again.rows)
            block = block.at(again.others)
        ros_type = block.ros_type
        found, passed = accelerations(
            block,
            ACCELERATION_LEAD.get(ros_type, 0),
            ACCELERATION_TAIL[ros_type],
            ANGULAR_VELOCITY_LEAD.get(ros_type),
        )
        for part in found:
            # Channels of one topic and frame_id, of several files say, are one source.
            keys = [(self._topic(number), frame) for number, frame in part.sources]
            numbers = np.array(
                [self._sources.setdefault(key, len(self._sources)) for key in keys], np.int64
            )
            self._layouts.learn(block, part, numbers)
            source = numbers.astype(np.uint32)[part.source]
            parts.append(Part(source, part.stamp, part.log_time, part.vector, part.rates))
            rows_of.append(part.row if again is None else again.others[part.row])
        if len(parts) > 1:
            parts = [_in_order(parts, rows_of)]
        for each in parts:
            self._sorted.add(each)
        return passed if again is None else [(why, again.others[rows]) for why, rows in passed]

    def accelerations(self) -> dict[tuple[str, str], Samples]:
        """Return the samples of every SU, by topic and frame_id; the collector keeps none."""
        columns = self._sorted.take(len(self._sources))
        found = {}
        for key in sorted(self._sources):
            stamp, log_time, vector, rates = columns[self._sources[key]]
            found[key] = Samples(
                stamp, log_time, vector, None if rates is None else real_rates(rates)
            )
            put_away(rates)
        return found

    def joints(self) -> dict[tuple[str, tuple[str, ...]], Samples]:
        """Return positions and efforts of joints by topic and names.

        Joints that always come together share one entry, whatever the order in the messages, and
        joints that come in several companies are joined into one sequence.
        """
        merged: dict[tuple[str, tuple[str, ...]], Samples] = {}
        by_topic: dict[str, dict[tuple[str, ...], Arrived]] = {}
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
                merged[topic, tuple(members)] = _joined(parts).samples
        return merged


def _in_order(parts: list[Part], rows: list[Int]) -> Part:
    """Join parts of one block, of both byte orders say, in the order of the log."""
    order = np.argsort(np.concatenate(rows))
    source, stamp, log_time, vector = (
        np.concatenate(arrays)[order] for arrays in zip(*(part[:4] for part in parts), strict=True)
    )
    rates = together([(part.rates, part.vector) for part in parts])
    return Part(source, stamp, log_time, vector, None if rates is None else rates[order])


def _columns(arrived: Arrived, columns: list[int]) -> Arrived:
    """Return some columns, by reference where these are all."""
    order, samples = arrived
    if columns == list(range(samples.values.shape[1])):
        return arrived
    beside = None if samples.beside is None else samples.beside[:, columns]
    return Arrived(order, samples._replace(values=samples.values[:, columns], beside=beside))


def _joined(parts: list[Arrived]) -> Arrived:
    """Join samples of one source in the order of the log."""
    if len(parts) == 1:
        order, samples = parts[0]
    else:
        order = np.concatenate([part.order for part in parts])
        samples = Samples(
            np.concatenate([part.samples.stamp for part in parts]),
            np.concatenate([part.samples.log_time for part in parts]),
            np.concatenate([part.samples.values for part in parts]),
            together([(part.samples.beside, part.samples.values) for part in parts]),
        )
    if (np.diff(order) < 0).any():
        rising = np.argsort(order, kind="stable")
        order, samples = order[rising], samples.at(rising)
    return Arrived(order, samples)
