"""Unpack an MCAP chunk and find its messages, by its index where it has one."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from skin2urdf.arrays import Int
from skin2urdf.recording.framing import (
    BATCH,
    MESSAGE_FIELDS,
    MESSAGE_HEADER,
    RECORD_HEADER,
    Record,
    text,
    walk,
)
from skin2urdf.recording.gather import U8, gather

# An entry of a message index: log time and offset, 8 bytes each.
INDEX_ENTRY = 16
# Chunks have 1 to 4 MB, by the defaults of all recorders. A few hundred bytes can claim to be any
# size, so what is unpacked at once is bounded by what every machine has.
LARGEST_UNPACKED = 1 << 28
# Chunks are joined up to this size: what is done at once should stay small beside the grid.
LARGEST_JOINED = 1 << 25


class DamagedChunkError(Exception):
    """A chunk whose content can not be trusted; the text says why."""


class PackedChunk(NamedTuple):
    """A chunk record (https://mcap.dev/spec#chunk-op0x06).

    Attributes:
        compression: "zstd", "lz4", or empty.
        size: bytes that it claims to have once unpacked.
        crc: CRC-32 of the unpacked bytes, 0 where it was not taken.
        data: the packed bytes.
    """

    compression: str
    size: int
    crc: int
    data: U8


class MessageIndex:
    """The message index records of a chunk (https://mcap.dev/spec#message-index-op0x07).

    Each has the channel (2 bytes), the length of its entries (4 bytes), and the entries.
    """

    def __init__(self, window: U8, starts: Int) -> None:
        """Take the records, the content of which starts at ``starts`` in ``window``, unread."""
        self._window = window
        self._start = starts
        # The length of a record stands before its content; all of it lies in the window.
        self._size = gather(window, starts - 8, "<u8").astype(np.int64)

    def __bool__(self) -> bool:
        """Tell whether there is any."""
        return bool(self._start.size)

    def channels(self) -> Int:
        """Return the channels of all records that are long enough to hold one."""
        start = self._start[self._size >= 6]
        return gather(self._window, start, "<u2").astype(np.int64)

    def offsets(self) -> Int | None:
        """Return where all messages start in the chunk, or None if a record is malformed."""
        if ((self._size < 6) | ((self._size - 6) % INDEX_ENTRY != 0)).any():
            return None
        count = (self._size - 6) // INDEX_ENTRY
        before = np.cumsum(count) - count
        first = np.repeat(self._start + 6 + 8 - INDEX_ENTRY * before, count)
        entry = first + INDEX_ENTRY * np.arange(first.size)
        offsets = gather(self._window, entry, "<u8")
        # As signed numbers what lies beyond any chunk is negative.
        return None if (offsets >> 63).any() else offsets.astype(np.int64)


def packed_chunk(content: U8) -> PackedChunk:
    """Read the fields of a chunk record.

    Raises:
        DamagedChunkError: it is cut short, or claims more than is unpacked at once.
        UnicodeDecodeError: the name of its compression is no text.
    """
    try:
        _, _, size, crc = struct.unpack_from("<QQQI", content.data)
        compression, at = text(content.data, 28)
        (length,) = struct.unpack_from("<Q", content.data, at)
    except struct.error as error:
        raise DamagedChunkError("cut short") from error
    data = content[at + 8 : at + 8 + length]
    if data.size < length:
        raise DamagedChunkError("cut short")
    if size > LARGEST_UNPACKED:
        raise DamagedChunkError(
            f"it claims {size / (1 << 20):.3g} MiB unpacked, and up to {LARGEST_UNPACKED >> 20} "
            "MiB are"
        )
    return PackedChunk(compression, size, crc, data)


class ChunkContent(NamedTuple):
    """Records inside a chunk.

    Attributes:
        buffer: the unpacked bytes.
        messages: (N,) first byte of each message record, in the order of the chunk.
        others: schemas, channels and whatever else lies in the chunk.
        note: what was mended, empty if nothing.
    """

    buffer: U8
    messages: Int
    others: tuple[Record, ...]
    note: str


def unpack_chunk(chunk: PackedChunk, index: MessageIndex) -> ChunkContent:
    """Decompress a chunk, check it, and find its records.

    Args:
        chunk: the chunk record.
        index: the message index records that follow it in the file, if any.

    Returns:
        Where the chunk's records lie.

    Raises:
        DamagedChunkError: decompression fails, or size or checksum differ from the record's.
    """
    buffer = _decompress(chunk)
    if buffer.size != chunk.size:
        raise DamagedChunkError(f"{buffer.size} bytes instead of {chunk.size}")
    if chunk.crc and zlib.crc32(buffer.data) != chunk.crc:
        raise DamagedChunkError("its checksum (CRC) does not match")
    note = ""
    if index:
        indexed = _by_index(buffer, index)
        if indexed is not None:
            return indexed
        note = "the message index of a chunk contradicts its content; the content was walked"
    return _by_walk(buffer, note)


def joined(contents: Iterable[tuple[U8, Int]]) -> Iterator[tuple[U8, Int]]:
    """Join small chunks, since what is done once per buffer costs more than copying it.

    Args:
        contents: bytes of each chunk and where its messages start.

    Yields:
        The same for several chunks in a row; the last may be small.
    """
    buffers: list[U8] = []
    starts: list[Int] = []
    size = count = 0
    for buffer, messages in contents:
        starts.append(messages + size)
        buffers.append(buffer)
        size += buffer.size
        count += messages.size
        if count >= BATCH // 2 or size >= LARGEST_JOINED:
            yield _concatenated(buffers), np.concatenate(starts)
            buffers, starts, size, count = [], [], 0, 0
    if count:
        yield _concatenated(buffers), np.concatenate(starts)


def _concatenated(buffers: Sequence[U8]) -> U8:
    """Concatenate, without a copy where there is nothing to join."""
    return buffers[0] if len(buffers) == 1 else np.concatenate(buffers)


def _decompress(chunk: PackedChunk) -> U8:
    """Return the content of a chunk as plain bytes, no more than it claims and one."""
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "zstd":
        import zstandard

        try:
            declared = zstandard.frame_content_size(chunk.data.data)
            # A damaged frame header can declare any size; allocate only what the record says.
            if declared not in (-1, chunk.size):
                raise DamagedChunkError("the zstd frame and the chunk disagree about its size")
            unpacked: bytes = zstandard.ZstdDecompressor().decompress(
                chunk.data.data, max_output_size=chunk.size
            )
        except (zstandard.ZstdError, MemoryError, OverflowError) as error:
            raise DamagedChunkError(f"zstd: {error}") from error
        return np.frombuffer(unpacked, np.uint8)
    if chunk.compression == "lz4":
        return unpack_lz4(chunk.data, chunk.size)
    raise DamagedChunkError(f"unknown compression {chunk.compression!r}")


def unpack_lz4(packed: U8, size: int) -> U8:
    """Return the content of an lz4 frame as plain bytes, no more than ``size`` and one.

    Raises:
        DamagedChunkError: this is no such frame, or it is damaged.
    """
    import lz4.frame

    try:
        with lz4.frame.LZ4FrameDecompressor() as decompressor:
            plain: bytes = decompressor.decompress(packed.data, max_length=size + 1)
    except (RuntimeError, MemoryError, OverflowError, ValueError, EOFError) as error:
        raise DamagedChunkError(f"lz4: {error}") from error
    return np.frombuffer(plain, np.uint8)


def _by_walk(buffer: U8, note: str) -> ChunkContent:
    """Find the records of a chunk by their headers."""
    batch = next(walk(buffer.data, 0, buffer.size, size=buffer.size + 1))
    if batch.stop != buffer.size:
        note = "a chunk ends in damaged records; those before them were read"
    return ChunkContent(buffer, batch.messages, batch.others, note)


def _by_index(buffer: U8, index: MessageIndex) -> ChunkContent | None:
    """Find the records of a chunk by its message indexes.

    Returns:
        The records, those between indexed messages included; None if an index is wrong.
    """
    offsets = index.offsets()
    if offsets is None:
        return None
    if offsets.size and int(offsets.max()) > buffer.size - MESSAGE_HEADER.itemsize:
        return None
    messages = np.sort(offsets)
    header = gather(buffer, messages, RECORD_HEADER)
    length = header["length"]
    sound = (
        (header["opcode"] == int(Opcode.MESSAGE))
        & (length >= MESSAGE_FIELDS)
        & (length <= buffer.size)
    )
    if not sound.all():
        return None
    gap_start = np.concatenate([[0], messages + 9 + length.astype(np.int64)])
    gap_stop = np.concatenate([messages, [buffer.size]])
    if (gap_start > gap_stop).any():
        return None
    # Whatever the indexes do not cover (definitions, unindexed messages) is walked.
    others: list[Record] = []
    missed: list[Int] = []
    for k in np.flatnonzero(gap_start < gap_stop):
        start, stop = int(gap_start[k]), int(gap_stop[k])
        batch = next(walk(buffer.data, start, stop, size=buffer.size + 1))
        if batch.stop != stop:
            return None
        others.extend(batch.others)
        missed.append(batch.messages)
    if any(extra.size for extra in missed):
        messages = np.sort(np.concatenate([messages, *missed]))
    return ChunkContent(buffer, messages, tuple(others), "")
