"""MCAP records as they follow each other in a file or a chunk: opcode, length, content."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from skin2urdf.arrays import Int
from skin2urdf.recording.naming import printable

# First and last bytes of every file (https://mcap.dev/spec#magic).
MAGIC = b"\x89MCAP0\r\n"

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

BATCH = 16384
NONE = np.zeros(0, np.int64)


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
    at = start
    more = True
    while more:
        found, indexes = array("q"), array("q")
        others: list[Record] = []
        more = False
        while at + 9 <= stop:
            opcode, length = header(buffer, at)
            behind = at + 9 + length
            if behind > stop or opcode == 0:
                break
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
