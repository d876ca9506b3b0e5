"""What every container of a log hands out: blocks of messages whose bytes lie in one buffer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Protocol

from skin2urdf.arrays import Int
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.gather import U8

UNWANTED = -2


@dataclass(frozen=True)
class Channel:
    """One topic of a file; channels of several files that are alike are one.

    Attributes:
        topic: ROS topic.
        ros_type: message type as ``package/msg/Type``, empty where the file does not say.
        encoding: message encoding, "cdr" for ROS 2 and "ros1" for ROS 1.
    """

    topic: str
    ros_type: str
    encoding: str


@dataclass(frozen=True, eq=False)
class Block:
    """Messages of one type and encoding that lie in one buffer, in the order of the file.

    Attributes:
        ros_type: type of all N messages.
        encoding: their encoding.
        channel: (N,) number of each message's channel among :attr:`Channels.known`.
        buffer: the bytes the messages lie in.
        start: (N,) where each payload starts [byte].
        end: (N,) where each payload ends [byte].
        log_time: (N,) when each message was recorded [ns].
    """

    ros_type: str
    encoding: str
    channel: Int
    buffer: U8
    start: Int
    end: Int
    log_time: Int

    def at(self, rows: Int) -> Block:
        """The block with some of its messages."""
        return replace(
            self,
            channel=self.channel[rows],
            start=self.start[rows],
            end=self.end[rows],
            log_time=self.log_time[rows],
        )


@dataclass(eq=False)
class Channels:
    """All channels of a log, numbered as they are met.

    Attributes:
        wanted: tells which channels' messages are handed out; others may be skipped unread.
        known: the channels by number.
        kinds: pairs of type and encoding by number.
        kind: for each channel the number of its pair.
    """

    wanted: Callable[[Channel], bool]
    known: list[Channel] = field(default_factory=list)
    kinds: list[tuple[str, str]] = field(default_factory=list)
    kind: list[int] = field(default_factory=list)
    _number: dict[Channel, int] = field(default_factory=dict)
    _kind_number: dict[tuple[str, str], int] = field(default_factory=dict)

    def number(self, channel: Channel) -> int:
        """Return the number of a channel, or `UNWANTED`; a new one is taken in."""
        if channel not in self._number:
            pair = channel.ros_type, channel.encoding
            if pair not in self._kind_number:
                self._kind_number[pair] = len(self.kinds)
                self.kinds.append(pair)
            self._number[channel] = len(self.known)
            self.known.append(channel)
            self.kind.append(self._kind_number[pair])
        return self._number[channel] if self.wanted(channel) else UNWANTED


class Container(Protocol):
    """A file of a log; what is known about it grows as its blocks are handed out.

    Attributes:
        profile: "ros2" or "ros1", as far as the file says.
        compressions: how its messages were compressed, "none" for plain ones.
        notes: what was damaged or missing.
        position: how far the file has been read [byte].
    """

    profile: str
    compressions: set[str]
    notes: list[ReadingNote]
    position: int

    def blocks(self) -> Iterator[Block]:
        """Hand out the messages of all wanted channels; damage ends in notes, not in errors."""
        ...
