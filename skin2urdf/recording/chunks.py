"""Unpack an MCAP chunk and find its messages, by its index where it has one."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import Int
from skin2urdf.recording.framing import (
    BATCH,
    text,
)
from skin2urdf.recording.gather import U8

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


def unpack(chunk: PackedChunk, target: U8 | None = None) -> U8:
    """Decompress a chunk and check it.

    Args:
        chunk: the chunk record.
        target: where its bytes are wanted, as many as it claims to have; anywhere if None.

    Returns:
        The bytes: the target, where there is one, but those of a plain chunk are its own.

    Raises:
        DamagedChunkError: decompression fails, or size or checksum differ from the record's.
    """
    plain = _decompressed(chunk, target)
    if plain.size != chunk.size:
        raise DamagedChunkError(f"{plain.size} bytes instead of {chunk.size}")
    if chunk.crc and zlib.crc32(plain.data) != chunk.crc:
        raise DamagedChunkError("its checksum (CRC) does not match")
    if target is None or chunk.compression == "" or plain.base is target:
        return plain
    target[:] = plain
    return target


def _decompressed(chunk: PackedChunk, target: U8 | None) -> U8:
    """The content of a chunk, no more than it claims and one; in the target where that is easy."""
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "lz4":
        return unpack_lz4(chunk.data, chunk.size)
    if chunk.compression != "zstd":
        raise DamagedChunkError(f"unknown compression {chunk.compression!r}")
    import zstandard

    try:
        declared = zstandard.frame_content_size(chunk.data.data)
        # A damaged frame header can declare any size; allocate only what the record says.
        if declared not in (-1, chunk.size):
            raise DamagedChunkError("the zstd frame and the chunk disagree about its size")
        unpacker = zstandard.ZstdDecompressor()
        if target is None or declared == -1:
            plain: bytes = unpacker.decompress(chunk.data.data, max_output_size=chunk.size)
            return np.frombuffer(plain, np.uint8)
        # In one go, straight to where it is wanted: without a window or a copy.
        size = unpacker.stream_reader(chunk.data.data).readinto(target.data)
        return target[:size]
    except (zstandard.ZstdError, MemoryError, OverflowError) as error:
        raise DamagedChunkError(f"zstd: {error}") from error


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
