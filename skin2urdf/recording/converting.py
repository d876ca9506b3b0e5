"""Write what a calibration reads of a log, whatever its format, as one MCAP file."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.blocks import Block, Channel
from skin2urdf.recording.joint_states import in_radians
from skin2urdf.recording.log_files import LogFiles
from skin2urdf.recording.messages import role_of
from skin2urdf.recording.naming import shortened
from skin2urdf.recording.progress import Share
from skin2urdf.recording.writing import Compression, mcap_writer

if TYPE_CHECKING:
    from mcap.writer import Writer

# Messages that are put into the order of their times together.
SORTED = 1 << 16
# What a damaged ROS 1 message can end in as rosbags reads it.
UNREADABLE = (
    AssertionError, IndexError, KeyError, OverflowError, TypeError, ValueError, struct.error,
)  # fmt: skip


class Converted(NamedTuple):
    """What was converted.

    Attributes:
        topics: topics that were written, sorted.
        messages: how many messages on them.
        notes: what was left out or damaged.
    """

    topics: tuple[str, ...]
    messages: int
    notes: tuple[ReadingNote, ...]


def convert(
    path: str | Path,
    target: str | Path,
    *,
    compression: Compression = "zstd",
    units: Sequence[tuple[str, float]] = (),
    progress: Callable[[Share], None] | None = None,
) -> Converted:
    """Write the joint states and accelerations of a log as a ROS 2 log in MCAP.

    Messages of ROS 2 go on byte for byte, those of ROS 1 as ROS 2 would have sent them. The file
    appears only once it is complete.

    Args:
        path: a log of any format.
        target: the file to write.
        compression: compression of its chunks.
        units: names of joints, or patterns of these with ``*`` and ``?``, and what positions and
            velocities of these are multiplied by to be rad or m, and those per second. The last
            that fits a joint counts.
        progress: called now and then with the share that is done, up to 1.

    Raises:
        UnreadableInputError: the log can not be read, or holds no joint states or accelerations.
        UsageError: the file can not be written, or no joint has a name that is given a unit.
    """
    source = Path(path)
    log = LogFiles(source, _used, progress)
    joint_units = _JointUnits(units)
    with mcap_writer(Path(target), compression) as writer:
        output = _Output(log, writer)
        waiting: list[Block] = []
        for block in log.blocks():
            if units and role_of(block.ros_type) == "joints":
                block = in_radians(block, joint_units.factor)
            waiting.append(block)
            if sum(b.start.size for b in waiting) >= SORTED:
                output.write(waiting)
                waiting = []
        output.write(waiting)
        if not output.messages:
            raise UnreadableInputError(
                str(source),
                "no topic of joint states or accelerations to convert",
                "see what it holds with `skin2urdf info`",
            )
        joint_units.check()
    notes = list(log.notes)
    left = sorted({c.topic for c in log.channels.known if not _used(c)})
    if left:
        more = f" and {len(left) - 8} more" if len(left) > 8 else ""
        words = f"topics that a calibration does not read: {', '.join(left[:8])}{more}"
        notes.append(ReadingNote("not converted", words, tuple(left)))
    if output.damaged:
        words = f"{output.damaged} damaged messages were left out"
        notes.append(ReadingNote("damaged", words, number=output.damaged))
    return Converted(tuple(sorted(output.topics)), output.messages, tuple(notes))


def _used(channel: Channel) -> bool:
    return role_of(channel.ros_type) != "ignored"


class _JointUnits:
    """Which joint is given in which unit, and which joints there were.

    Args:
        units: names or patterns of joints, and the factor to rad or m.
    """

    def __init__(self, units: Sequence[tuple[str, float]]) -> None:
        self._units = units
        self._met: set[str] = set()

    def factor(self, name: str) -> float:
        """What positions of a joint are multiplied by."""
        self._met.add(name)
        return next((f for pattern, f in reversed(self._units) if fnmatchcase(name, pattern)), 1.0)

    def check(self) -> None:
        """Refuse units of joints that the log has not."""
        for pattern, _ in self._units:
            if not any(fnmatchcase(name, pattern) for name in self._met):
                raise UsageError(
                    f"no joint of the log fits {pattern!r}",
                    f"they are {shortened(sorted(self._met))}",
                )


class _Output:
    """Writes blocks of messages.

    Attributes:
        topics: topics written.
        messages: messages written.
        damaged: messages that can not be.
    """

    def __init__(self, log: LogFiles, writer: Writer) -> None:
        self.topics: set[str] = set()
        self.messages = 0
        self.damaged = 0
        self._log = log
        self._writer = writer
        self._ids: dict[int, int] = {}
        self._schemas: dict[str, int] = {}

    def write(self, blocks: list[Block]) -> None:
        """Write the messages of some blocks in the order of their times."""
        if not blocks:
            return
        which = np.repeat(np.arange(len(blocks)), [b.start.size for b in blocks])
        row = np.concatenate([np.arange(b.start.size) for b in blocks])
        times = np.concatenate([b.log_time for b in blocks])
        order = np.argsort(times, kind="stable")
        payloads = [_payloads(block) for block in blocks]
        for k, n, time in zip(
            which[order].tolist(), row[order].tolist(), times[order].tolist(), strict=True
        ):
            payload = payloads[k](n)
            if payload is None or time < 0:
                self.damaged += 1
                continue
            channel = self._channel(int(blocks[k].channel[n]))
            self._writer.add_message(channel, time, payload, time, self.messages & 0xFFFFFFFF)
            self.messages += 1

    def _channel(self, number: int) -> int:
        """The id of a channel in the file that is written, registered at first use."""
        if number not in self._ids:
            channel = self._log.channels.known[number]
            if channel.ros_type not in self._schemas:
                self._schemas[channel.ros_type] = self._writer.register_schema(
                    channel.ros_type, "ros2msg", _definition(channel.ros_type)
                )
            self._ids[number] = self._writer.register_channel(
                channel.topic, "cdr", self._schemas[channel.ros_type], {"offered_qos_profiles": ""}
            )
            self.topics.add(channel.topic)
        return self._ids[number]


def _payloads(block: Block) -> Callable[[int], bytes | memoryview | None]:
    """Gives the payload of a message of a block as ROS 2 writes it; None for damaged ones."""
    view = block.buffer.data

    def plain(n: int) -> memoryview:
        return view[int(block.start[n]) : int(block.end[n])]

    if block.encoding == "cdr":
        return plain
    if block.encoding != "ros1":
        return lambda _: None
    from rosbags.serde import SerdeError

    store = _store()

    def as_cdr(n: int) -> bytes | None:
        try:
            return bytes(store.ros1_to_cdr(bytes(plain(n)), block.ros_type))
        except (SerdeError, *UNREADABLE):
            return None

    return as_cdr


def _definition(ros_type: str) -> bytes:
    """The definition of a message type with all it refers to, as ROS 2 writes it."""
    text, _ = _store().generate_msgdef(ros_type, ros_version=2)
    return bytes(text.encode())


def _store() -> Any:
    """The message types of ROS 2, the standard ones of which are ROS 1's but for the header."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)
