"""Gather the samples of a log by topic and source, as they were recorded."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.recording.cdr import accelerations
from skin2urdf.recording.container import Block
from skin2urdf.recording.joint_states import joint_positions
from skin2urdf.recording.messages import ACCELERATION_LEAD, ACCELERATION_TAIL, role_of


class Samples(NamedTuple):
    """Samples of one source in the order of the log.

    Attributes:
        arrival: (N,) number of each message among those of its topic.
        stamp: (N,) header stamps [ns], 0 where unset.
        log_time: (N,) times the messages were recorded [ns].
        values: (N, C) what was measured.
    """

    arrival: Int
    stamp: Int
    log_time: Int
    values: F64

    def at(self, keep: Int | Bool) -> Samples:
        """Return some of the samples."""
        return Samples(self.arrival[keep], self.stamp[keep], self.log_time[keep], self.values[keep])


@dataclass(eq=False)
class Collector:
    """Takes in blocks of messages and keeps what a calibration needs of them.

    Attributes:
        passed: per topic, why messages were passed over (reason: messages).
    """

    passed: defaultdict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    _accelerations: dict[tuple[str, str], list[Samples]] = field(default_factory=dict)
    _joints: dict[tuple[str, tuple[str, ...]], list[Samples]] = field(default_factory=dict)
    _arrived: Counter[str] = field(default_factory=Counter)

    def add(self, block: Block) -> None:
        """Take in the messages of one block.

        Args:
            block: messages of a channel that `role_of` does not ignore.
        """
        channel = block.channel
        first = self._arrived[channel.topic]
        self._arrived[channel.topic] += block.start.size
        if channel.encoding != "cdr":
            reason = f"encoded as {channel.encoding!r}, not as ROS 2's cdr"
            self.passed[channel.topic][reason] += block.start.size
            return
        if role_of(channel.ros_type) == "joints":
            passed = self._add_joints(block, first)
        else:
            passed = self._add_accelerations(block, first)
        if passed:
            self.passed[channel.topic].update(passed)

    def _add_joints(self, block: Block, first: int) -> Counter[str]:
        """Take in JointState messages."""
        found, passed = joint_positions(block)
        for part in found:
            samples = Samples(first + part.row, part.stamp, part.log_time, part.position)
            self._joints.setdefault((block.channel.topic, part.names), []).append(samples)
        return passed

    def _add_accelerations(self, block: Block, first: int) -> Counter[str]:
        """Take in messages that carry an acceleration."""
        ros_type = block.channel.ros_type
        found, passed = accelerations(
            block, ACCELERATION_LEAD.get(ros_type, 0), ACCELERATION_TAIL[ros_type]
        )
        for part in found:
            samples = Samples(first + part.row, part.stamp, part.log_time, part.vector)
            for k, frame in enumerate(part.frames):
                some = samples if len(part.frames) == 1 else samples.at(part.frame == k)
                self._accelerations.setdefault((block.channel.topic, frame), []).append(some)
        return passed

    def accelerations(self) -> dict[tuple[str, str], Samples]:
        """Return the samples of every SU, by topic and frame_id."""
        return {key: _joined(parts) for key, parts in sorted(self._accelerations.items())}

    def joints(self) -> dict[tuple[str, tuple[str, ...]], Samples]:
        """Return joint positions by topic and names.

        Joints that always come together share one entry, whatever the order in the messages, and
        joints that come in several companies are joined into one sequence.
        """
        merged: dict[tuple[str, tuple[str, ...]], Samples] = {}
        by_topic: dict[str, dict[tuple[str, ...], Samples]] = {}
        for (topic, names), parts in sorted(self._joints.items()):
            by_topic.setdefault(topic, {})[names] = _joined(parts)
        for topic, companies in by_topic.items():
            membership: dict[tuple[tuple[str, ...], ...], list[str]] = {}
            for name in sorted({name for names in companies for name in names}):
                held_by = tuple(names for names in companies if name in names)
                membership.setdefault(held_by, []).append(name)
            for held_by, members in membership.items():
                parts = [_columns(companies[names], names, members) for names in held_by]
                merged[topic, tuple(members)] = _joined(parts)
        return merged


def _columns(samples: Samples, names: tuple[str, ...], members: list[str]) -> Samples:
    """Return the columns of some joints."""
    if list(names) == members:
        return samples
    return samples._replace(values=samples.values[:, [names.index(m) for m in members]])


def _joined(parts: list[Samples]) -> Samples:
    """Join samples of one source in the order of the log."""
    if len(parts) == 1:
        joined = parts[0]
    else:
        joined = Samples(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    if (np.diff(joined.arrival) < 0).any():
        joined = joined.at(np.argsort(joined.arrival, kind="stable"))
    return joined
