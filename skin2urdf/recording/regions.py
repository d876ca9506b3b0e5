"""Regions: chunks that lie in one buffer, and all their messages found at once.

What is done once per chunk costs more than its messages where chunks are small, and a copy of all
bytes costs as much as unpacking them. So chunks are unpacked side by side into one buffer, and
plain ones stay where they were read.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from skin2urdf.arrays import Bool, Int
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.chunks import (
    INDEX_ENTRY,
    DamagedChunkError,
    PackedChunk,
    unpack,
)
from skin2urdf.recording.framing import (
    MESSAGE_FIELDS,
    MESSAGE_HEADER,
    NONE,
    Record,
    walk,
)
from skin2urdf.recording.gather import U8, gather

# Bytes that are unpacked side by side: little enough to stay in a processor's cache until they are
# read, and tens of thousands of messages. A larger chunk is a region of its own.
REGION = 1 << 23
# What a thread unpacks at a time, as handing over costs as much as some thousand bytes.
TASK, MOST_IN_TASK = 1 << 20, 256
# What parsing a damaged record can end in: too short, not text, an absurd length.
UNPARSABLE = (UnicodeDecodeError, struct.error, MemoryError)

CONTRADICTED = ReadingNote(
    "contradicted index",
    "the message index of a chunk contradicts its content; the content was walked",
)
DAMAGED_END = ReadingNote("damaged", "a chunk ends in damaged records; those before them were read")


class Placed(NamedTuple):
    """A chunk in a region.

    Attributes:
        record: the chunk's record in the window, with its message indexes.
        chunk: what the record says.
        start: its first byte in the region's buffer.
    """

    record: Record
    chunk: PackedChunk
    start: int


@dataclass(eq=False)
class Region:
    """Chunks that lie in one buffer, in the order of the file.

    Attributes:
        buffer: the bytes; plain chunks lie in the window of the file. None for a single packed
            chunk that is not unpacked yet.
        chunks: the chunks.
        size: bytes that they have together.
    """

    buffer: U8 | None
    chunks: list[Placed]
    size: int
    _unpacked: list[Future[list[Exception | None]]] = field(default_factory=list)

    def unpack(self, pool: Executor) -> None:
        """Begin to unpack all chunks, in other threads."""
        begin = size = 0
        for k, placed in enumerate(self.chunks):
            size += placed.chunk.size
            if size >= TASK or k + 1 - begin == MOST_IN_TASK or k + 1 == len(self.chunks):
                self._unpacked.append(pool.submit(self._unpack, self.chunks[begin : k + 1]))
                begin, size = k + 1, 0

    def errors(self) -> list[Exception | None]:
        """Wait until all chunks are unpacked, and tell for each why it was not; None if it was."""
        return [error for some in self._unpacked for error in some.result()]

    def _unpack(self, chunks: Sequence[Placed]) -> list[Exception | None]:
        """Unpack some of the chunks."""
        found: list[Exception | None] = []
        for _, chunk, start in chunks:
            try:
                if self.buffer is None:  # of a single chunk, whose bytes need no other place
                    self.buffer = unpack(chunk)
                else:
                    unpack(chunk, self.buffer[start : start + chunk.size])
                found.append(None)
            except (*UNPARSABLE, DamagedChunkError) as error:
                found.append(error)
        return found


class RegionContent(NamedTuple):
    """Records inside a region.

    Attributes:
        messages: (N,) first byte of each message record, in the order of the file.
        header: (N,) their headers.
        others: schemas, channels and whatever else lies in the chunks, in that order.
        notes: what was mended.
    """

    messages: Int
    header: NDArray[np.void]
    others: tuple[Record, ...]
    notes: tuple[ReadingNote, ...]


def regions(window: U8, chunks: Iterable[tuple[Record, PackedChunk]]) -> Iterator[Region]:
    """Place chunks in regions.

    Args:
        window: the bytes that the records lie in.
        chunks: chunk records.

    Yields:
        The regions, nothing of which is unpacked yet.
    """
    here: list[Placed] = []
    size = 0
    for record, chunk in chunks:
        plain = chunk.compression == ""
        alike = not here or plain == (here[0].chunk.compression == "")
        if here and not (alike and (plain or size + chunk.size <= REGION)):
            yield _region(window, here, size)
            here, size = [], 0
        # The data of a chunk ends where its record does, or before where bytes follow it.
        start = _place(window, chunk.data) if plain else size
        here.append(Placed(record, chunk, start))
        size += chunk.size
    if here:
        yield _region(window, here, size)


def _region(window: U8, chunks: list[Placed], size: int) -> Region:
    """A region, in the window itself where its chunks are plain."""
    if chunks[0].chunk.compression == "":
        return Region(window, chunks, size)
    return Region(None if len(chunks) == 1 else np.empty(size, np.uint8), chunks, size)


def _place(window: U8, data: U8) -> int:
    """Where some bytes lie in the window that they are a part of."""
    return int(data.__array_interface__["data"][0] - window.__array_interface__["data"][0])


def find_records(window: U8, buffer: U8, chunks: Sequence[Placed]) -> RegionContent:
    """Find the records of chunks by their message indexes, or by walking them.

    Args:
        window: the bytes that the message indexes lie in.
        buffer: the bytes of a region.
        chunks: those of its chunks that were unpacked, at least one.

    Returns:
        The records; those between indexed messages included.
    """
    base = np.array([placed.start for placed in chunks], np.int64)
    stop = base + np.array([placed.chunk.size for placed in chunks], np.int64)
    messages, header, contradicted = _by_index(buffer, window, chunks, base, stop)
    indexed = np.array([placed.record.indexes.size > 0 for placed in chunks], np.bool_)
    notes: list[ReadingNote] = []
    others: list[Record] = []
    missed: list[Int] = []
    # Whatever the indexes do not cover (definitions, unindexed messages) is walked.
    for begin, end, k in _gaps(messages, header, base, stop, indexed & ~contradicted):
        batch = next(walk(buffer.data, begin, end, size=buffer.size + 1))
        if batch.stop != end:
            contradicted[k] = True
            continue
        others.extend(batch.others)
        missed.append(batch.messages)
    if contradicted.any():
        notes.append(CONTRADICTED)
        inside = _chunk_of(messages, base)
        messages = messages[~contradicted[inside]]
        spans = list(zip(base[contradicted], stop[contradicted], strict=True))
        missed = [some[~contradicted[_chunk_of(some, base)]] for some in missed]
        others = [other for other in others if not contradicted[int(_chunk_of(other.start, base))]]
    else:
        spans = []
    spans += list(zip(base[~indexed], stop[~indexed], strict=True))
    for begin, end in spans:
        batch = next(walk(buffer.data, int(begin), int(end), size=buffer.size + 1))
        if batch.stop != end:
            notes.append(DAMAGED_END)
        others.extend(batch.others)
        missed.append(batch.messages)
    if contradicted.any() or any(some.size for some in missed):
        messages = np.sort(np.concatenate([messages, *missed]))
        header = gather(buffer, messages, MESSAGE_HEADER)
    # A channel is of a schema that stands before it.
    others.sort(key=lambda record: record.start)
    return RegionContent(messages, header, tuple(others), tuple(dict.fromkeys(notes)))


def index_channels(window: U8, starts: Int) -> Int:
    """The channels of the message index records, the content of which starts at (N,) places."""
    long_enough = gather(window, starts - 8, "<u8") >= 2
    return gather(window, starts[long_enough], "<u2").astype(np.int64)


def _by_index(
    buffer: U8, window: U8, chunks: Sequence[Placed], base: Int, stop: Int
) -> tuple[Int, NDArray[np.void], Bool]:
    """Find messages by the message indexes of (K,) chunks.

    An index record has the channel (2 bytes), the length of its entries (4 bytes), and the entries
    (https://mcap.dev/spec#message-index-op0x07).

    Returns:
        (N,) where messages start, their headers, and (K,) True for chunks whose index is wrong,
        of which there are no messages.
    """
    wrong = np.zeros(len(chunks), np.bool_)
    starts = np.concatenate([NONE, *(placed.record.indexes for placed in chunks)])
    if not starts.size:
        return NONE, np.empty(0, MESSAGE_HEADER), wrong
    of_chunk = np.repeat(np.arange(len(chunks)), [p.record.indexes.size for p in chunks])
    # The length of a record stands before its content; all of it lies in the window.
    size = gather(window, starts - 8, "<u8").astype(np.int64)
    malformed = (size < 6) | ((size - 6) % INDEX_ENTRY != 0)
    if malformed.any():
        wrong[of_chunk[malformed]] = True
        sound = ~wrong[of_chunk]
        starts, size, of_chunk = starts[sound], size[sound], of_chunk[sound]
    count = (size - 6) // INDEX_ENTRY
    before = np.cumsum(count) - count
    first = np.repeat(starts + 6 + 8 - INDEX_ENTRY * before, count)
    offset = gather(window, first + INDEX_ENTRY * np.arange(first.size), "<u8")
    of_chunk = np.repeat(of_chunk, count)
    # As unsigned numbers, those beyond any chunk are no smaller than others.
    room = (stop - base - MESSAGE_HEADER.itemsize).clip(-1)
    outside = (offset > room.clip(0).astype(np.uint64)[of_chunk]) | (room < 0)[of_chunk]
    if outside.any():
        wrong[of_chunk[outside]] = True
        inside = ~wrong[of_chunk]
        offset, of_chunk = offset[inside], of_chunk[inside]
    # A buffer is far smaller than 2 GB, and numbers of 32 bits sort twice as fast.
    messages = np.sort((offset.astype(np.int64) + base[of_chunk]).astype(np.int32)).astype(np.int64)
    header = gather(buffer, messages, MESSAGE_HEADER)
    length = header["length"]
    sound = (
        (header["opcode"] == int(Opcode.MESSAGE))
        & (length >= MESSAGE_FIELDS)
        & (length <= buffer.size)
    )
    # One that reaches beyond the next, or beyond its chunk, is none either.
    behind = messages + 9 + np.where(sound, length, 0).astype(np.int64)
    limit = np.minimum(np.append(messages[1:], stop[-1]), stop[_chunk_of(messages, base)])
    sound &= behind <= limit
    if not sound.all():
        wrong[_chunk_of(messages[~sound], base)] = True
        kept = ~wrong[_chunk_of(messages, base)]
        messages, header = messages[kept], header[kept]
    return messages, header, wrong


def _chunk_of(place: Int | int, base: Int) -> Int:
    """Number of the chunk that each of (N,) places lies in."""
    return np.asarray(np.searchsorted(base, place, side="right") - 1)


def _gaps(
    messages: Int, header: NDArray[np.void], base: Int, stop: Int, covered: Bool
) -> Iterator[tuple[int, int, int]]:
    """What no message covers of the chunks that are `covered` by indexes: begin, end, chunk."""
    if not covered.any():
        return
    behind = messages + 9 + header["length"].astype(np.int64)
    chunk = np.flatnonzero(covered)
    # Of each chunk the first message, and the one after its last.
    first, last = np.searchsorted(messages, base[chunk]), np.searchsorted(messages, stop[chunk])
    for k in np.flatnonzero(messages[1:] > behind[:-1]):
        if k + 1 not in first:
            yield int(behind[k]), int(messages[k + 1]), int(_chunk_of(int(behind[k]), base))
    for c, one, other in zip(chunk.tolist(), first.tolist(), last.tolist(), strict=True):
        begin, end = int(base[c]), int(stop[c])
        if one == other:
            yield begin, end, c
            continue
        if begin < messages[one]:
            yield begin, int(messages[one]), c
        if behind[other - 1] < end:
            yield int(behind[other - 1]), end, c
