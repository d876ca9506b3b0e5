"""Unpack an MCAP chunk and find its messages, by its index where it has one."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Chunk

from skin2urdf.arrays import Int
from skin2urdf.recording.framing import (
    BATCH,
    MESSAGE_FIELDS,
    MESSAGE_HEADER,
    RECORD_HEADER,
    Record,
    walk,
)
from skin2urdf.recording.gather import U8, gather

INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


class DamagedChunkError(Exception):
    """A chunk whose content can not be trusted; the text says why."""


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


def unpack_chunk(chunk: Chunk, indexes: Sequence[U8] = ()) -> ChunkContent:
    """Decompress a chunk, check it, and find its records.

    Args:
        chunk: the chunk record.
        indexes: contents of the message index records that follow it in the file.

    Returns:
        Where the chunk's records lie.

    Raises:
        DamagedChunkError: decompression fails, or size or checksum differ from the record's.
    """
    raw = _decompress(chunk)
    if len(raw) != chunk.uncompressed_size:
        raise DamagedChunkError(f"{len(raw)} bytes instead of {chunk.uncompressed_size}")
    if chunk.uncompressed_crc and zlib.crc32(raw) != chunk.uncompressed_crc:
        raise DamagedChunkError("its checksum (CRC) does not match")
    buffer = np.frombuffer(raw, np.uint8)
    note = ""
    if indexes:
        indexed = _by_index(buffer, indexes)
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
        if count >= BATCH:
            yield _concatenated(buffers), np.concatenate(starts)
            buffers, starts, size, count = [], [], 0, 0
    if count:
        yield _concatenated(buffers), np.concatenate(starts)


def _concatenated(buffers: Sequence[U8]) -> U8:
    """Concatenate, without a copy where there is nothing to join."""
    return buffers[0] if len(buffers) == 1 else np.concatenate(buffers)


def _decompress(chunk: Chunk) -> bytes:
    """Return the content of a chunk as plain bytes."""
    if chunk.compression == "":
        as_is: bytes = chunk.data
        return as_is
    if chunk.compression == "zstd":
        import zstandard

        try:
            declared = zstandard.frame_content_size(chunk.data)
            # A damaged frame header can declare any size; allocate only what the record says.
            if declared not in (-1, chunk.uncompressed_size):
                raise DamagedChunkError("the zstd frame and the chunk disagree about its size")
            unpacked: bytes = zstandard.ZstdDecompressor().decompress(
                chunk.data, max_output_size=chunk.uncompressed_size
            )
        except (zstandard.ZstdError, MemoryError, OverflowError) as error:
            raise DamagedChunkError(f"zstd: {error}") from error
        return unpacked
    if chunk.compression == "lz4":
        import lz4.frame

        try:
            plain: bytes = lz4.frame.decompress(chunk.data)
        except (RuntimeError, MemoryError, OverflowError, ValueError) as error:
            raise DamagedChunkError(f"lz4: {error}") from error
        return plain
    raise DamagedChunkError(f"unknown compression {chunk.compression!r}")


def _by_walk(buffer: U8, note: str) -> ChunkContent:
    """Find the records of a chunk by their headers."""
    batch = next(walk(buffer.data, 0, buffer.size, size=buffer.size + 1))
    if batch.stop != buffer.size:
        note = "a chunk ends in damaged records; those before them were read"
    return ChunkContent(buffer, batch.messages, batch.others, note)


def _by_index(buffer: U8, indexes: Sequence[U8]) -> ChunkContent | None:
    """Find the records of a chunk by its message indexes.

    Returns:
        The records, those between indexed messages included; None if an index is wrong.
    """
    # Content of a message index: channel (2 bytes), length of the entries (4 bytes), entries.
    if any(index.size < 6 or (index.size - 6) % INDEX_ENTRY.itemsize for index in indexes):
        return None
    entries = [np.frombuffer(index[6:], INDEX_ENTRY)["offset"] for index in indexes]
    offsets = np.concatenate(entries)
    if offsets.size and int(offsets.max()) > buffer.size - MESSAGE_HEADER.itemsize:
        return None
    messages = np.sort(offsets.astype(np.int64))
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
