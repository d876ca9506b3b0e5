"""What a log holds, usable or not."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from skin2urdf.arrays import Int
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.blocks import Block, Channels
from skin2urdf.recording.messages import ENCODINGS, Role, role_of


@dataclass(frozen=True)
class TopicInventory:
    """One topic of a log.

    Attributes:
        name: the topic.
        ros_type: message type as ``package/msg/Type``.
        encoding: message encoding, "cdr" for ROS 2, "ros1" for ROS 1.
        messages: number of messages.
        used_as: "joints", "su" or "ignored".
    """

    name: str
    ros_type: str
    encoding: str
    messages: int
    used_as: Role


@dataclass(frozen=True)
class LogInventory:
    """What a log holds.

    Attributes:
        source: path of the log.
        topics: one entry per topic, sorted by name.
        duration: time from the first to the last message by log time [s].
        compression: compressions of the chunks, "none" for plain ones.
        profile: "ros2" or "ros1", as far as the file says.
        notes: what was damaged or missing.
    """

    source: str
    topics: tuple[TopicInventory, ...]
    duration: float
    compression: tuple[str, ...]
    profile: str
    notes: tuple[ReadingNote, ...] = ()

    @property
    def messages(self) -> int:
        """Number of messages on all topics."""
        return sum(topic.messages for topic in self.topics)


@dataclass(eq=False)
class Tally:
    """Counts messages as the blocks of a log go by.

    Attributes:
        channels: the channels of the log.
    """

    channels: Channels
    _messages: Int = field(default_factory=lambda: np.zeros(0, np.int64))
    _first: int | None = None
    _last: int = 0

    def add(self, block: Block) -> None:
        """Count the messages of one block."""
        first, last = int(block.log_time.min()), int(block.log_time.max())
        self._first = first if self._first is None else min(first, self._first)
        self._last = max(last, self._last)
        counts = np.bincount(block.channel, minlength=self._messages.size)
        counts[: self._messages.size] += self._messages
        self._messages = counts

    def inventory(
        self,
        *,
        source: str,
        profile: str,
        compressions: Iterable[str],
        notes: Iterable[ReadingNote],
    ) -> LogInventory:
        """Sum up.

        Args:
            source: path of the log.
            profile: MCAP profile.
            compressions: chunk compressions met.
            notes: notes for the user.

        Returns:
            The inventory; topics without messages are in it as well.
        """
        topics = [
            TopicInventory(
                name=channel.topic,
                ros_type=channel.ros_type,
                encoding=channel.encoding,
                messages=int(self._messages[k]) if k < self._messages.size else 0,
                used_as=role_of(channel.ros_type) if channel.encoding in ENCODINGS else "ignored",
            )
            for k, channel in enumerate(self.channels.known)
        ]
        return LogInventory(
            source=source,
            topics=tuple(sorted(topics, key=lambda t: (t.name, t.ros_type, t.encoding))),
            duration=0.0 if self._first is None else (self._last - self._first) / 1e9,
            compression=tuple(sorted(compressions)),
            profile=profile,
            notes=tuple(notes),
        )
