"""MCAP records as they follow each other in a file or a chunk: opcode, length, content."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from skin2urdf.arrays import Int
from skin2urdf.recording.gather import U8, gather
from skin2urdf.recording.naming import printable

# Opcode, length and the fixed fields of a message record (https://mcap.dev/spec#message-op0x05).
MESSAGE_HEADER = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
# What every record starts with.
RECORD_HEADER = np.dtype([("opcode", "u1"), ("length", "<u8")])
# Content of a message record before the payload.
MESSAGE_FIELDS = MESSAGE_HEADER.itemsize - 9

BATCH = 1 << 15
NONE = np.zeros(0, np.int64)
# Records of one kind in a row after which the next are looked for many at a time, and the bytes
# that are then looked through at once: below these stepping is faster.
IN_A_ROW = 48
LEAST_PIECE, LARGEST_PIECE = 1 << 15, 1 << 20
# Message indexes of fewer bytes are: to step over one takes as long as to search some hundred.
SHORT = 256


class Record(NamedTuple):
    """Where the content of one record lies.

    Attributes:
        opcode: kind of record.
        start: first byte of the content.
        stop: first byte behind the content.
        indexes: (I,) first byte of the content of each message index that follows, a chunk's.
        end: first byte behind these.
    """

    opcode: int
    start: int
    stop: int
    indexes: Int
    end: int


class Batch(NamedTuple):
    """Records that follow each other.

    Attributes:
        messages: (N,) first byte (the opcode's) of each message record.
        others: all other records; message indexes stand with the chunk before them.
        stop: first byte behind the last of them.
    """

    messages: Int
    others: tuple[Record, ...]
    stop: int


def walk(buffer: memoryview, start: int, stop: int, size: int = BATCH) -> Iterator[Batch]:
    """Walk records by their headers up to the footer, the end, or the first damaged record.

    Args:
        buffer: bytes of a file or a chunk.
        start: first byte of the first record.
        stop: first byte behind the last record.
        size: messages per batch.

    Yields:
        Batches of whole records.
    """
    header = struct.Struct("<BQ").unpack_from
    message, index, footer = int(Opcode.MESSAGE), int(Opcode.MESSAGE_INDEX), int(Opcode.FOOTER)
    content = np.frombuffer(buffer, np.uint8)
    at = start
    more = True
    while more:
        found, indexes = array("q"), array("q")
        others: list[Record] = []
        more = False
        row, last, piece = 0, -1, LEAST_PIECE
        while at + 9 <= stop:
            opcode, length = header(buffer, at)
            behind = at + 9 + length
            if behind > stop or opcode == 0:
                break
            row, last = row + 1 if opcode == last else 0, opcode
            short = opcode == message or (opcode == index and length < SHORT)
            if row >= IN_A_ROW and short:
                most = size - len(found) if opcode == message else stop
                starts, behind = alike(content[: min(stop, at + piece)], at, opcode, most)
                if starts.size:
                    piece = min(2 * piece, LARGEST_PIECE)
                    if opcode == message:
                        found.frombytes(starts.tobytes())
                    else:
                        indexes.frombytes((starts + 9).tobytes())
                    at = behind
                    if len(found) == size:
                        more = True
                        break
                    continue
                # One that is larger than the piece, or damaged, is for stepping.
                row, piece, behind = 0, LEAST_PIECE, at + 9 + length
            if opcode == message:
                if length < MESSAGE_FIELDS:
                    break
                found.append(at)
                if len(found) == size:
                    at, more = behind, True
                    break
            elif opcode == index:
                indexes.append(at + 9)
            else:
                if indexes:
                    _attach(others, indexes, at)
                    indexes = array("q")
                others.append(Record(opcode, at + 9, behind, NONE, behind))
            at = behind
            if opcode == footer:
                break
        if indexes:
            _attach(others, indexes, at)
        yield Batch(np.array(found, np.int64), tuple(others), at)


def alike(buffer: U8, start: int, opcode: int, most: int) -> tuple[Int, int]:
    """Find records of one kind that follow each other.

    All places that can start such a record are found at once. Mostly these are the records, each
    of which ends where the next one starts; what else lies in between is stepped over.

    Args:
        buffer: bytes up to which records are whole.
        start: where the first one starts.
        opcode: their kind.
        most: how many to find.

    Returns:
        (N,) where whole records start, and the first byte behind the last of them.
    """
    least = MESSAGE_FIELDS if opcode == Opcode.MESSAGE else 0
    place = np.flatnonzero(buffer[start : buffer.size - 8] == opcode) + start
    length = gather(buffer, place + 1, "<u8")
    there = (length >= least) & (length <= buffer.size - 9 - place)
    place, length = place[there], length[there]
    behind = place + 9 + length.astype(np.int64)
    breaks = np.append(np.flatnonzero(place[1:] != behind[:-1]), place.size - 1)
    pieces: list[Int] = []
    at, found = start, 0
    while found < most:
        first = int(np.searchsorted(place, at))
        if first == place.size or place[first] != at:
            break
        last = int(breaks[np.searchsorted(breaks, first)])
        last = min(last, first + most - found - 1)
        pieces.append(place[first : last + 1])
        found += last + 1 - first
        at = int(behind[last])
    return (np.concatenate(pieces) if pieces else NONE), at


def _attach(records: list[Record], indexes: array[int], end: int) -> None:
    """Put message indexes to the chunk before them; without one they say nothing."""
    if records and records[-1].opcode == Opcode.CHUNK:
        records[-1] = records[-1]._replace(indexes=np.array(indexes, np.int64), end=end)


def text(content: memoryview, at: int) -> tuple[str, int]:
    """Read a string of a record.

    Args:
        content: content of the record.
        at: where the string's length stands.

    Returns:
        The string, what no terminal should be sent escaped, and where the next field stands.

    Raises:
        struct.error: the record is too short.
        UnicodeDecodeError: these bytes are no text.
    """
    (length,) = struct.unpack_from("<I", content, at)
    behind = at + 4 + length
    if behind > len(content):
        raise struct.error("a string is longer than its record")
    return printable(bytes(content[at + 4 : behind]).decode()), behind
