"""Walk an MCAP file and hand out where its messages lie, block by block.

Only record headers are walked in Python; messages stay bytes (https://mcap.dev/spec).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import IO, cast

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, Header, Schema

from skin2urdf.arrays import Int
from skin2urdf.recording.chunks import DamagedChunkError, joined, unpack_chunk
from skin2urdf.recording.framing import MAGIC, MESSAGE_HEADER, Record, walk
from skin2urdf.recording.gather import U8, gather
from skin2urdf.recording.messages import canonical_type

# What parsing a damaged record can end in: too short, not text, an absurd length.
UNPARSABLE = (McapError, UnicodeDecodeError, struct.error, OverflowError, MemoryError)


@dataclass(frozen=True)
class Channel:
    """One MCAP channel.

    Attributes:
        topic: ROS topic.
        ros_type: message type as ``package/msg/Type``, empty where the file does not say.
        encoding: message encoding, "cdr" for ROS 2.
    """

    topic: str
    ros_type: str
    encoding: str


@dataclass(frozen=True, eq=False)
class Block:
    """Messages of one channel that lie in one buffer, in the order of the file.

    Attributes:
        channel: the channel of all N messages.
        buffer: the bytes the messages lie in.
        start: (N,) where each payload starts [byte].
        end: (N,) where each payload ends [byte].
        log_time: (N,) when each message was recorded [ns].
    """

    channel: Channel
    buffer: U8
    start: Int
    end: Int
    log_time: Int


@dataclass(eq=False)
class McapFile:
    """One MCAP file; what is known about it grows as its blocks are handed out.

    Attributes:
        data: the whole file.
        wanted: tells which channels' messages are handed out; others may be skipped unread.
        profile: profile of the header, "ros2" for a ROS 2 log.
        compressions: chunk compressions met; "none" for plain chunks and for files without chunks.
        channels: channels by id.
        notes: what was damaged or missing, in words for the user.
        position: how far the file has been read [byte].
    """

    data: U8
    wanted: Callable[[Channel], bool]
    profile: str = ""
    compressions: set[str] = field(default_factory=set)
    channels: dict[int, Channel] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    position: int = len(MAGIC)
    _schemas: dict[int, str] = field(default_factory=dict)

    def blocks(self) -> Iterator[Block]:
        """Hand out the messages of all wanted channels.

        Damage never raises: what is whole is handed out, and `notes` tells what was not.

        Yields:
            Blocks in the order of the file.
        """
        closed = False
        for batch in walk(self.data.data, len(MAGIC), self.data.size):
            closed = closed or any(r.opcode == Opcode.FOOTER for r in batch.others)
            self._define(self.data, batch.others)
            for buffer, messages in joined(self._chunks(batch.others)):
                yield from self._split(buffer, messages)
            if batch.messages.size:
                self.compressions.add("none")
                yield from self._split(self.data, batch.messages)
            self.position = batch.stop
        left = self.data.size - self.position
        if not closed:
            self.notes.append(
                "the file has no closing records, as after a crash or a copy that was cut; "
                f"all whole records were read, the last {left} bytes were not"
                if left
                else "the file has no closing records, as after a crash; all of it was read"
            )

    def _chunks(self, records: tuple[Record, ...]) -> Iterator[tuple[U8, Int]]:
        """Unpack the chunks among the records of the file: bytes, and where messages start."""
        for k, record in enumerate(records):
            if record.opcode != Opcode.CHUNK:
                continue
            self.position = record.stop
            indexes = []
            for follower in records[k + 1 :]:
                if follower.opcode != Opcode.MESSAGE_INDEX:
                    break
                indexes.append(self.data[follower.start : follower.stop])
            if self._all_unwanted(indexes):
                continue
            try:
                chunk = Chunk.read(_stream(self.data, record))
                content = unpack_chunk(chunk, indexes)
            except (*UNPARSABLE, DamagedChunkError) as error:
                self.notes.append(
                    f"the chunk at byte {record.start} is damaged ({error or 'cut short'}); "
                    "its messages were left out"
                )
                continue
            self.compressions.add(chunk.compression or "none")
            if content.note and content.note not in self.notes:
                self.notes.append(content.note)
            self._define(content.buffer, content.others)
            yield content.buffer, content.messages

    def _all_unwanted(self, indexes: list[U8]) -> bool:
        """Tell from its indexes that a chunk need not be unpacked."""
        ids = [int.from_bytes(index[:2].tobytes(), "little") for index in indexes]
        return bool(ids) and all(
            (channel := self.channels.get(i)) is not None and not self.wanted(channel) for i in ids
        )

    def _define(self, buffer: U8, records: tuple[Record, ...]) -> None:
        """Take in the definitions among some records."""
        for record in records:
            try:
                if record.opcode == Opcode.HEADER:
                    self.profile = Header.read(_stream(buffer, record)).profile
                elif record.opcode == Opcode.SCHEMA:
                    schema = Schema.read(_stream(buffer, record))
                    self._schemas[schema.id] = canonical_type(schema.name)
                elif record.opcode == Opcode.CHANNEL:
                    channel = ChannelRecord.read(_stream(buffer, record))
                    self.channels[channel.id] = Channel(
                        channel.topic,
                        self._schemas.get(channel.schema_id, ""),
                        channel.message_encoding,
                    )
            except UNPARSABLE:
                self.notes.append(f"the definition at byte {record.start} is damaged")

    def _split(self, buffer: U8, messages: Int) -> Iterator[Block]:
        """Sort message records by channel."""
        header = gather(buffer, messages, MESSAGE_HEADER)
        start = messages + MESSAGE_HEADER.itemsize
        end = messages + 9 + header["length"].astype(np.int64)
        log_time = header["log_time"].astype(np.int64)
        ids = np.ascontiguousarray(header["channel"])
        order = np.argsort(ids, kind="stable")
        bounds = np.flatnonzero(np.diff(ids[order])) + 1
        for rows in np.split(order, bounds) if order.size else ():
            channel = self.channels.get(int(ids[rows[0]]))
            if channel is None:
                note = "some messages belong to a channel the file does not define; left out"
                if note not in self.notes:
                    self.notes.append(note)
            elif self.wanted(channel):
                yield Block(channel, buffer, start[rows], end[rows], log_time[rows])


class _Window:
    """Reads part of a buffer as if it were a file; a chunk is copied once, not twice."""

    def __init__(self, view: memoryview) -> None:
        self._view = view
        self._at = 0

    def read(self, size: int) -> bytes:
        """Return the next ``size`` bytes, fewer at the end."""
        piece = self._view[self._at : self._at + size].tobytes()
        self._at += len(piece)
        return piece


def _stream(buffer: U8, record: Record) -> ReadDataStream:
    """Open a record's content for mcap's record classes."""
    return ReadDataStream(cast("IO[bytes]", _Window(buffer.data[record.start : record.stop])))
