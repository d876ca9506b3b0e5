"""Walk an MCAP file and hand out where its messages lie, block by block.

Only record headers are walked in Python; messages stay bytes (https://mcap.dev/spec).
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from skin2urdf.arrays import Int
from skin2urdf.magic import MCAP_MAGIC
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.blocks import UNWANTED, Block, Channel, Channels
from skin2urdf.recording.chunks import (
    LARGEST_UNPACKED,
    DamagedChunkError,
    PackedChunk,
    packed_chunk,
)
from skin2urdf.recording.framing import (
    MESSAGE_FIELDS,
    MESSAGE_HEADER,
    RECORD_HEADER,
    Record,
    text,
    walk,
)
from skin2urdf.recording.gather import U8, gather
from skin2urdf.recording.inputs import LogFile
from skin2urdf.recording.messages import canonical_type
from skin2urdf.recording.regions import UNPARSABLE, Region, find_records, index_channels, regions
from skin2urdf.threads import WORKERS

# Bytes of a file that are in memory at a time: some chunks of rosbag2's 4 MB.
WINDOW = 1 << 24
# Channel ids of MCAP have 16 bits.
CHANNEL_IDS = 1 << 16
UNDEFINED = -1
# Regions that are unpacked ahead, and what they may claim together [byte].
AHEAD = 1
LARGEST_AHEAD = 1 << 26


class Found(NamedTuple):
    """Message records in one buffer: (N,) where they start, and their headers."""

    buffer: U8
    messages: Int
    header: NDArray[np.void]


@dataclass(eq=False)
class McapFile:
    """One MCAP file; what is known about it grows as its blocks are handed out.

    Attributes:
        file: the file.
        channels: the channels of the whole log, which this file's are added to.
        digest: takes all bytes of the file in their order, if given.
        profile: profile of the header, "ros2" for a ROS 2 log.
        compressions: chunk compressions met; "none" for plain chunks and for files without chunks.
        notes: what was damaged or missing.
        position: how far the file has been read [byte].
    """

    file: LogFile
    channels: Channels
    digest: Callable[[U8], None] | None = None
    profile: str = ""
    compressions: set[str] = field(default_factory=set)
    notes: list[ReadingNote] = field(default_factory=list)
    position: int = len(MCAP_MAGIC)
    _schemas: dict[int, str] = field(default_factory=dict)
    _digested: int = 0
    _numbers: Int = field(default_factory=lambda: np.full(CHANNEL_IDS, UNDEFINED, np.int64))
    _pool: ThreadPoolExecutor = field(init=False)

    def blocks(self) -> Iterator[Block]:
        """Hand out the messages of all wanted channels.

        Damage never raises: what is whole is handed out, and `notes` tells what was not.

        Yields:
            Blocks in the order of the file.

        Raises:
            UnreadableInputError: the file was shortened while it was read.
        """
        # Decompression and checksums leave Python's lock, so that they run beside all that is done
        # with the messages of the chunk before.
        with ThreadPoolExecutor(WORKERS) as self._pool:
            yield from self._all_blocks()

    def _all_blocks(self) -> Iterator[Block]:
        """Hand out all messages; chunks are unpacked in other threads meanwhile."""
        closed = False
        size = WINDOW
        while not closed and self.position < self.file.size:
            begin = self.position
            window = self._read(begin, size)
            last = begin + window.size == self.file.size
            stop = 0
            for batch in walk(window.data, 0, window.size):
                records, stop = batch.others, batch.stop
                closed = bool(records) and records[-1].opcode == Opcode.FOOTER
                if not (closed or last):
                    records, stop = _without_open_chunk(records, stop)
                self._define(window, records, begin)
                for found in self._chunks(window, records, begin):
                    yield from self._split(found)
                if batch.messages.size:
                    self.compressions.add("none")
                    header = gather(window, batch.messages, MESSAGE_HEADER)
                    yield from self._split(Found(window, batch.messages, header))
                self.position = begin + stop
            size = WINDOW
            if not stop:
                if last or self._damaged(window):
                    break
                # One record, or a chunk with its indexes, is larger than the window.
                size = self._past_large_record(window)
        left = self.file.size - self.position
        while self.digest is not None and self._digested < self.file.size:
            self._read(self._digested, WINDOW)
        if not closed:
            words = (
                "the file has no closing records, as after a crash or a copy that was cut; "
                f"all whole records were read, the last {left} bytes were not"
                if left
                else "the file has no closing records, as after a crash; all of it was read"
            )
            self.notes.append(ReadingNote("cut short", words, number=left))

    def _read(self, start: int, size: int) -> U8:
        """Read part of the file, and take the digest of what was not read before."""
        while self.digest is not None and self._digested < start:
            between = self.file.read(self._digested, min(WINDOW, start - self._digested))
            self.digest(between)
            self._digested += between.size
        window = self.file.read(start, size)
        if self.digest is not None:
            self.digest(window[self._digested - start :])
            self._digested = start + window.size
        return window

    def _past_large_record(self, window: U8) -> int:
        """Return the size of the window that holds a record, or skip one that is too large."""
        opcode, length = gather(window, np.zeros(1, np.int64), RECORD_HEADER)[0]
        behind = self.position + 9 + int(length)
        if window.size >= 9 + int(length):
            return 2 * window.size
        if opcode in (Opcode.CHUNK, Opcode.MESSAGE) and length <= LARGEST_UNPACKED:
            return 9 + int(length) + WINDOW
        if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
            words = (
                f"the record of {int(length) >> 20} MiB at byte {self.position} was left out: "
                f"those of up to {LARGEST_UNPACKED >> 20} MiB are read"
            )
            self.notes.append(ReadingNote("too large", words))
        self.position = behind
        return WINDOW

    def _damaged(self, window: U8) -> bool:
        """Tell whether no record can start where the window does."""
        opcode, length = gather(window, np.zeros(1, np.int64), RECORD_HEADER)[0]
        short = opcode == Opcode.MESSAGE and length < MESSAGE_FIELDS
        return bool(opcode == 0 or short or self.position + 9 + int(length) > self.file.size)

    def _chunks(self, window: U8, records: Sequence[Record], begin: int) -> Iterator[Found]:
        """Unpack the chunks among some records, those of the next region meanwhile."""
        waiting: deque[Region] = deque()
        for region in regions(window, self._wanted(window, records, begin)):
            while waiting and sum(each.size for each in waiting) + region.size > LARGEST_AHEAD:
                yield from self._found(window, waiting.popleft(), begin)
            region.unpack(self._pool)
            waiting.append(region)
            if len(waiting) > AHEAD:
                yield from self._found(window, waiting.popleft(), begin)
        while waiting:
            yield from self._found(window, waiting.popleft(), begin)

    def _wanted(
        self, window: U8, records: Sequence[Record], begin: int
    ) -> Iterator[tuple[Record, PackedChunk]]:
        """The chunks among some records that may hold something wanted."""
        for record in records:
            if record.opcode != Opcode.CHUNK:
                continue
            try:
                chunk = packed_chunk(window[record.start : record.stop])
            except (*UNPARSABLE, DamagedChunkError) as error:
                self._left_out(begin + record.start, error)
                continue
            numbers = self._numbers[index_channels(window, record.indexes)]
            if chunk.size and not (numbers.size and (numbers == UNWANTED).all()):
                yield record, chunk

    def _found(self, window: U8, region: Region, begin: int) -> Iterator[Found]:
        """Take in what the chunks of a region define, and hand on their messages."""
        self.position = begin + region.chunks[-1].record.stop
        sound = []
        for placed, error in zip(region.chunks, region.errors(), strict=True):
            if error is not None:
                self._left_out(begin + placed.record.start, error)
                continue
            self.compressions.add(placed.chunk.compression or "none")
            sound.append(placed)
        if not sound or region.buffer is None:
            return
        found = find_records(window, region.buffer, sound)
        self.notes += [note for note in found.notes if note not in self.notes]
        self._define(region.buffer, found.others, 0)
        yield Found(region.buffer, found.messages, found.header)

    def _left_out(self, position: int, error: Exception) -> None:
        words = (
            f"the chunk at byte {position} is damaged ({error or 'cut short'}); its messages were "
            "left out"
        )
        self.notes.append(ReadingNote("damaged", words))

    def _define(self, buffer: U8, records: Sequence[Record], begin: int) -> None:
        """Take in the definitions among some records."""
        view = buffer.data
        for record in records:
            try:
                if record.opcode == Opcode.CHANNEL:
                    number, schema, topic, encoding = _channel(view[record.start : record.stop])
                    self._numbers[number] = self.channels.number(
                        Channel(topic, self._schemas.get(schema, ""), encoding)
                    )
                elif record.opcode == Opcode.SCHEMA:
                    number, name = _schema(view[record.start : record.stop])
                    self._schemas[number] = canonical_type(name)
                elif record.opcode == Opcode.HEADER:
                    self.profile, _ = text(view[record.start : record.stop], 0)
            except UNPARSABLE:
                words = f"the definition at byte {begin + record.start} is damaged"
                self.notes.append(ReadingNote("damaged", words))

    def _split(self, found: Found) -> Iterator[Block]:
        """Sort message records by what they hold."""
        header, messages = found.header, found.messages
        if not messages.size:
            return
        numbers = self._numbers[header["channel"]]
        lowest = int(numbers.min())
        if lowest <= UNDEFINED and (numbers == UNDEFINED).any():
            words = "some messages belong to a channel the file does not define; left out"
            note = ReadingNote("undefined channel", words)
            if note not in self.notes:
                self.notes.append(note)
        kinds = np.array([*self.channels.kind, -1, -1])[numbers]
        log_time = header["log_time"].astype(np.int64)
        length = header["length"].astype(np.int64)
        for k in np.flatnonzero(np.bincount(kinds + 1)[1:]):
            some = kinds == k
            rows: slice | Int = slice(None) if some.all() else np.flatnonzero(some)
            start = messages[rows]
            yield Block(
                *self.channels.kinds[k],
                channel=numbers[rows],
                buffer=found.buffer,
                start=start + MESSAGE_HEADER.itemsize,
                end=start + 9 + length[rows],
                log_time=log_time[rows],
            )


def _without_open_chunk(records: tuple[Record, ...], stop: int) -> tuple[tuple[Record, ...], int]:
    """Leave a chunk at the end for later, as more of its message indexes may follow."""
    # The chunk is open only if nothing but its indexes lies behind it.
    if records and records[-1].opcode == Opcode.CHUNK and records[-1].end == stop:
        return records[:-1], records[-1].start - 9
    return records, stop


def _channel(content: memoryview) -> tuple[int, int, str, str]:
    """Read a channel record: its id, that of its schema, topic and message encoding."""
    number, schema = struct.unpack_from("<HH", content)
    topic, at = text(content, 4)
    encoding, _ = text(content, at)
    return number, schema, topic, encoding


def _schema(content: memoryview) -> tuple[int, str]:
    """Read a schema record: its id and name."""
    return struct.unpack_from("<H", content)[0], text(content, 2)[0]
