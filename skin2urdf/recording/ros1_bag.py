"""Walk a ROS 1 bag and hand out where its messages lie, block by block.

Format 2.0 (https://wiki.ros.org/Bags/Format/2.0): records of a header, which holds fields
``name=value``, and data, each with its length before it. The index is not used, so a bag that was
never closed reads as far as it goes.
"""

from __future__ import annotations

import bz2
import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from skin2urdf.arrays import Bool, Int
from skin2urdf.magic import ROS1_MAGIC
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.blocks import Block, Channel, Channels
from skin2urdf.recording.chunks import LARGEST_UNPACKED, DamagedChunkError, joined, unpack_lz4
from skin2urdf.recording.gather import U8, gather, gather_rows, grouped
from skin2urdf.recording.inputs import LogFile
from skin2urdf.recording.messages import canonical_type
from skin2urdf.recording.naming import printable
from skin2urdf.recording.regions import DAMAGED_END

MESSAGE, BAG_HEADER, CHUNK, CONNECTION = 2, 3, 5, 7
UNKNOWN = -1
# Bytes that are read at a time, some forty chunks of rosbag's 768 KiB.
WINDOW = 1 << 25
# Records outside of chunks that are taken together [byte].
PLAIN = 1 << 22
# A header holds a topic and a few numbers; one that is longer is damage.
LONGEST_HEADER = 1 << 16
# Orders of fields that headers of one length may have; a recorder writes one.
MOST_LAYOUTS = 8

Fields = dict[str, tuple[int, int]]
"""Where the value of each field of a header begins and ends."""


@dataclass(eq=False)
class Ros1Bag:
    """One ROS 1 bag; what is known about it grows as its blocks are handed out.

    Attributes:
        file: the file.
        channels: the channels of the whole log, which this file's are added to.
        profile: "ros1".
        compressions: chunk compressions met; "none" for plain chunks.
        notes: what was damaged or missing.
        position: how far the file has been read [byte].
    """

    file: LogFile
    channels: Channels
    profile: str = "ros1"
    compressions: set[str] = field(default_factory=set)
    notes: list[ReadingNote] = field(default_factory=list)
    position: int = len(ROS1_MAGIC)
    _numbers: dict[int, int] = field(default_factory=dict)
    _window: U8 = field(default_factory=lambda: np.zeros(0, np.uint8))
    _begin: int = 0

    def blocks(self) -> Iterator[Block]:
        """Hand out the messages of all wanted channels.

        Damage never raises: what is whole is handed out, and `notes` tells what was not.

        Yields:
            Blocks in the order of the file.

        Raises:
            UnreadableInputError: the file was shortened while it was read.
        """
        for buffer, starts in joined(self._records()):
            yield from self._split(buffer, starts)

    def _records(self) -> Iterator[tuple[U8, Int]]:
        """Buffers, and where message records start in them."""
        at = begin = self.position
        while at < self.file.size:
            header = self._piece(at, 4)
            length = int.from_bytes(header[:4].tobytes(), "little")
            if header.size < 4 or length > LONGEST_HEADER:
                break
            header = self._piece(at + 4, length + 4)
            if header.size < length + 4:
                break
            size = int.from_bytes(header[length : length + 4].tobytes(), "little")
            data = at + 8 + length
            if data + size > self.file.size:
                break
            fields = _fields(header[:length].tobytes())
            op = _number(header, fields, "op")
            plain = op in (MESSAGE, CONNECTION) and size <= LARGEST_UNPACKED
            if begin < at and not (plain and at - begin < PLAIN):
                yield from self._sorted(self._piece(begin, at - begin).copy())
                begin = at
            if not plain:
                begin = data + size
            if op == CHUNK:
                yield from self._chunk(at, header, fields, size)
            elif op == BAG_HEADER and "encryptor" in fields and np.diff(fields["encryptor"])[0]:
                words = "the bag is encrypted, and was not read"
                self.notes.append(ReadingNote("encrypted", words))
                return
            elif op == BAG_HEADER and _number(header, fields, "index_pos", "<u8") == 0:
                words = "the bag was not closed, as after a crash; it has no index"
                self.notes.append(ReadingNote("cut short", words, number=0))
            at = data + size
            self.position = at
        if begin < at:
            yield from self._sorted(self._piece(begin, at - begin).copy())
        if at < self.file.size:
            left = self.file.size - at
            words = (
                f"the record at byte {at} is damaged or cut; the last {left} bytes were not read"
            )
            self.notes.append(ReadingNote("cut short", words, number=left))

    def _piece(self, start: int, size: int) -> U8:
        """Bytes of the file, fewer at its end."""
        stop = min(start + size, self.file.size)
        if not (self._begin <= start and stop <= self._begin + self._window.size):
            self._window = self.file.read(start, max(size, WINDOW))
            self._begin = start
        return self._window[start - self._begin : stop - self._begin]

    def _chunk(self, at: int, header: U8, fields: Fields, size: int) -> Iterator[tuple[U8, Int]]:
        """Unpack a chunk record."""
        try:
            compression, claim = _of_chunk(header, fields, size)
            plain = _unpacked(compression, self._piece(at + 4 + len(header), size), claim)
        except (DamagedChunkError, MemoryError) as error:
            words = (
                f"the chunk at byte {at} is damaged ({error or 'too large'}); its messages were "
                "left out"
            )
            self.notes.append(ReadingNote("damaged", words))
            return
        self.compressions.add(compression)
        yield from self._sorted(plain)

    def _sorted(self, buffer: U8) -> Iterator[tuple[U8, Int]]:
        """Take in the connections of a buffer of records, and hand on its messages."""
        starts, stop = _walk(buffer)
        if stop < buffer.size:
            self._note(DAMAGED_END)
        op, connection, _ = _headers(buffer, starts)
        for k in np.flatnonzero(op == CONNECTION):
            self._define(buffer, int(starts[k]), int(connection[k]))
        messages = starts[op == MESSAGE]
        if (op == UNKNOWN).any():
            self._note(ReadingNote("damaged", "some records are damaged; left out"))
        if messages.size:
            yield buffer, messages

    def _define(self, buffer: U8, start: int, connection: int) -> None:
        """Take in a connection record."""
        header, data = _parts(buffer, start)
        fields, described = _fields(header), _fields(data)
        if connection < 0 or "topic" not in fields or "type" not in described:
            self._note(
                ReadingNote("damaged", "a connection is damaged; its messages were left out")
            )
            return
        topic = header[slice(*fields["topic"])].decode(errors="replace")
        ros_type = data[slice(*described["type"])].decode(errors="replace")
        self._numbers[connection] = self.channels.number(
            Channel(printable(topic), canonical_type(printable(ros_type)), "ros1")
        )

    def _split(self, buffer: U8, starts: Int) -> Iterator[Block]:
        """Sort message records by what they hold."""
        _, connection, log_time = _headers(buffer, starts)
        known, where = np.unique(connection, return_inverse=True)
        numbers = np.array([self._numbers.get(int(c), UNKNOWN) for c in known])[where.reshape(-1)]
        if (numbers == UNKNOWN).any():
            words = "some messages belong to a connection the bag does not define; left out"
            self._note(ReadingNote("undefined channel", words))
        if (numbers < 0).all():
            return
        data = starts + 4 + gather(buffer, starts, "<u4")
        end = data + 4 + gather(buffer, data, "<u4")
        kinds = np.where(numbers < 0, -1, np.array(self.channels.kind)[numbers])
        for rows in grouped(kinds):
            if kinds[rows[0]] >= 0:
                ros_type, encoding = self.channels.kinds[int(kinds[rows[0]])]
                yield Block(
                    ros_type,
                    encoding,
                    channel=numbers[rows],
                    buffer=buffer,
                    start=data[rows] + 4,
                    end=end[rows],
                    log_time=log_time[rows],
                )

    def _note(self, note: ReadingNote) -> None:
        if note not in self.notes:
            self.notes.append(note)


def _of_chunk(header: U8, fields: Fields, size: int) -> tuple[str, int]:
    """The compression of a chunk of ``size`` bytes, and what it claims to unpack to [byte].

    Raises:
        DamagedChunkError: it does not say, or is larger than what is unpacked at once.
    """
    if "compression" not in fields:
        raise DamagedChunkError("its compression is not said")
    claim = _number(header, fields, "size", "<u4")
    if not 0 <= claim <= LARGEST_UNPACKED or size > LARGEST_UNPACKED:
        raise DamagedChunkError(
            f"it claims {max(claim, size) / (1 << 20):.3g} MiB, and up to "
            f"{LARGEST_UNPACKED >> 20} MiB are unpacked"
        )
    compression = header[slice(*fields["compression"])].tobytes()
    return printable(compression.decode(errors="replace")), claim


def _unpacked(compression: str, packed: U8, claim: int) -> U8:
    """The plain bytes of a chunk, no more than it claims and one.

    Raises:
        DamagedChunkError: they can not be unpacked, or are more or fewer than claimed.
    """
    if compression == "none":
        plain = packed
    elif compression == "lz4":
        plain = unpack_lz4(packed, claim)
    elif compression == "bz2":
        try:
            unpacked = bz2.BZ2Decompressor().decompress(packed.tobytes(), max_length=claim + 1)
        except (OSError, ValueError, EOFError) as error:
            raise DamagedChunkError(f"bz2: {error}") from error
        plain = np.frombuffer(unpacked, np.uint8)
    else:
        raise DamagedChunkError(f"unknown compression {compression!r}")
    if plain.size != claim:
        raise DamagedChunkError(f"{plain.size} bytes instead of {claim}")
    return plain


def _walk(buffer: U8) -> tuple[Int, int]:
    """Where each whole record of a buffer starts, and the first byte behind the last of them."""
    length = struct.Struct("<I").unpack_from
    view, found, at = buffer.data, array("q"), 0
    while at + 8 <= buffer.size:
        data = at + 4 + length(view, at)[0]
        if data + 4 > buffer.size:
            break
        behind = data + 4 + length(view, data)[0]
        if behind > buffer.size:
            break
        found.append(at)
        at = behind
    return np.array(found, np.int64), at


def _headers(buffer: U8, starts: Int) -> tuple[Int, Int, Int]:
    """Read the headers of records, all that are laid out alike at once.

    Args:
        buffer: the bytes.
        starts: (N,) where whole records start.

    Returns:
        (N,) kind of record, number of the connection and time [ns]; -1 where a header lacks it.
    """
    op, connection, time = (np.full(starts.size, UNKNOWN, np.int64) for _ in range(3))
    length = gather(buffer, starts, "<u4").astype(np.int64)
    if not starts.size:
        return op, connection, time
    for rows in grouped(length):
        if length[rows[0]] > LONGEST_HEADER:
            continue
        text = gather_rows(buffer, starts[rows] + 4, int(length[rows[0]]), np.uint8)
        for _ in range(MOST_LAYOUTS):
            fields = _fields(text[0].tobytes())
            same = (text == text[0])[:, _names(fields, text.shape[1])].all(axis=1)
            some = rows[same]
            if _has(fields, "op", 1):
                op[some] = text[same, fields["op"][0]]
            if _has(fields, "conn", 4):
                connection[some] = _values(text[same], fields["conn"], "<u4").reshape(-1)
            if _has(fields, "time", 8):
                sec, nanosec = _values(text[same], fields["time"], "<u4").astype(np.int64).T
                time[some] = sec * 1_000_000_000 + nanosec
            rows, text = rows[~same], text[~same]
            if not rows.size:
                break
    # What is a message without a connection or a time is none.
    op[(op == MESSAGE) & ((connection < 0) | (time < 0))] = UNKNOWN
    return op, connection, time


def _fields(header: bytes) -> Fields:
    """Where the fields of a header lie; without those behind a damaged one."""
    found: Fields = {}
    at = 0
    while at + 4 <= len(header):
        behind = at + 4 + int.from_bytes(header[at : at + 4], "little")
        equal = header.find(b"=", at + 4, behind)
        if behind > len(header) or equal < 0:
            break
        found[header[at + 4 : equal].decode(errors="replace")] = equal + 1, behind
        at = behind
    return found


def _names(fields: Fields, length: int) -> Bool:
    """(length,) True for the bytes of a header that are no values."""
    mask = np.ones(length, np.bool_)
    for begin, end in fields.values():
        mask[begin:end] = False
    return mask


def _has(fields: Fields, name: str, size: int) -> bool:
    return name in fields and fields[name][1] - fields[name][0] == size


def _values(text: U8, place: tuple[int, int], dtype: str) -> Int:
    """Numbers at one place of each row."""
    return np.ascontiguousarray(text[:, slice(*place)]).view(dtype)


def _number(header: U8, fields: Fields, name: str, dtype: str = "") -> int:
    """The number that a field holds, -1 without it."""
    place = fields.get(name)
    if place is None or (dtype and not _has(fields, name, np.dtype(dtype).itemsize)):
        return UNKNOWN
    return int.from_bytes(header[slice(*place)].tobytes(), "little")


def _parts(buffer: U8, start: int) -> tuple[bytes, bytes]:
    """Header and data of one whole record."""
    length = int.from_bytes(buffer[start : start + 4].tobytes(), "little")
    data = start + 4 + length
    size = int.from_bytes(buffer[data : data + 4].tobytes(), "little")
    return buffer[start + 4 : data].tobytes(), buffer[data + 4 : data + 4 + size].tobytes()
