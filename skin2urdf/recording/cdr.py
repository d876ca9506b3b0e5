"""Take fixed-layout fields out of many payloads at once.

ROS 2 payloads are plain CDR (XCDR1, OMG formal/02-06-51 section 15.3): 4 bytes of encapsulation
(representation, options), then the fields, each aligned to its own size counted from behind the
encapsulation. Offsets below are relative to that point, called the body. In XCDR2 (OMG DDS-XTypes
1.3, section 7.4.3) no field is aligned to more than 4 bytes, and a sequence of strings has its size
before it. ROS 1 aligns nothing and closes no string with a zero; its header begins with a sequence
number of 4 bytes, so that its body, too, starts with the stamp 4 bytes into the payload.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.recording.blocks import Block
from skin2urdf.recording.gather import U8, distinct, gather, gather_rows
from skin2urdf.recording.naming import printable

ENCAPSULATION = 4
# Body offset behind stamp (8 bytes) and length of frame_id (4 bytes): where its text starts.
FRAME_TEXT = 12

ByteOrder: TypeAlias = Literal["<", ">"]
Passed: TypeAlias = list[tuple[str, Int]]
"""Why messages were passed over, and their numbers within the block."""

# Names are shorter; what is longer is not kept [byte].
LONG_TEXT = 256

MALFORMED = "cut short or malformed"


class Layout(NamedTuple):
    """How the fields of a payload are laid out.

    Attributes:
        order: byte order, "<" little or ">" big.
        alignment: what fields are aligned to at most [byte].
        sized: whether a sequence of strings has its size before it.
    """

    order: ByteOrder
    alignment: int
    sized: bool = False


# By the two bytes that a payload starts with (DDS-XTypes 1.3, table 59; in 1.1 XCDR2 had others).
REPRESENTATION = {
    0x0000: Layout(">", 8),
    0x0001: Layout("<", 8),
    0x0006: Layout(">", 4, sized=True),
    0x0007: Layout("<", 4, sized=True),
    0x0010: Layout(">", 4, sized=True),
    0x0011: Layout("<", 4, sized=True),
}
ROS1 = Layout("<", 1)


class Payloads(NamedTuple):
    """Payloads of one layout that lie in one buffer.

    Attributes:
        buffer: the bytes.
        layout: how their fields are laid out.
        row: (N,) number of each message within its block.
        body: (N,) first byte behind the encapsulation.
        size: (N,) bytes of each body.
        log_time: (N,) when each message was recorded [ns].
        stamp: (N,) header.stamp [ns].
        frame_length: (N,) bytes of header.frame_id, its closing zero included.
    """

    buffer: U8
    layout: Layout
    row: Int
    body: Int
    size: Int
    log_time: Int
    stamp: Int
    frame_length: Int

    def at(self, keep: Int | Bool) -> Payloads:
        """Return some of the payloads."""
        arrays = (self.row, self.body, self.size, self.log_time, self.stamp, self.frame_length)
        return Payloads(self.buffer, self.layout, *(a[keep] for a in arrays))

    @property
    def order(self) -> ByteOrder:
        """Byte order, "<" little or ">" big."""
        return self.layout.order

    def aligned(self, offset: Int, size: int) -> Int:
        """Round (N,) body offsets up to where a field of ``size`` bytes may start."""
        return align(offset, min(size, self.layout.alignment))

    def uint32(self, offset: Int) -> Int:
        """Read an unsigned 32-bit number at (N,) body offsets."""
        return gather(self.buffer, self.body + offset, f"{self.order}u4").astype(np.int64)


class Accelerations(NamedTuple):
    """Accelerations out of one block.

    Attributes:
        sources: S pairs of a channel's number and a frame_id, no two alike.
        source: (N,) index of each message's pair.
        row: (N,) number of each message within its block.
        stamp: (N,) header.stamp [ns].
        log_time: (N,) when each message was recorded [ns].
        vector: (N, 3) the acceleration as the message holds it.
        rates: (N, 3) the angular velocity likewise [rad/s], NaN in messages that say to have none;
            None where no message has any.
    """

    sources: tuple[tuple[int, str], ...]
    source: Int
    row: Int
    stamp: Int
    log_time: Int
    vector: F64
    rates: F64 | None


def stamped_payloads(block: Block) -> tuple[list[Payloads], Passed]:
    """Sort the messages of a block by layout and read their std_msgs/Header up to frame_id.

    Args:
        block: messages of a type that starts with a Header.

    Returns:
        The payloads of each layout met, and why others were passed over.
    """
    header_size = ENCAPSULATION + FRAME_TEXT
    long_enough = block.end - block.start >= header_size
    rows = np.flatnonzero(long_enough)
    passed: Passed = []
    if rows.size < block.start.size:
        passed.append((MALFORMED, np.flatnonzero(~long_enough)))
    if not rows.size:
        return [], passed
    raw = gather(block.buffer, block.start[rows], np.dtype((np.void, header_size)))
    kinds = raw.view([("representation", ">u2"), ("rest", "V14")])["representation"]
    payloads: list[Payloads] = []
    if block.encoding == "ros1":
        kinds = np.zeros(rows.size, np.uint16)
    for kind in kinds[:1] if (kinds == kinds[0]).all() else np.unique(kinds):
        some: slice | Bool = slice(None) if (kinds == kind).all() else kinds == kind
        form = ROS1 if block.encoding == "ros1" else REPRESENTATION.get(int(kind))
        if form is None:
            reason = f"not plain CDR (representation 0x{int(kind):04x})"
            passed.append((reason, rows[some]))
            continue
        order = form.order
        layout = np.dtype(
            [
                ("encapsulation", "V4"),
                ("sec", f"{order}i4"),
                ("nanosec", f"{order}u4"),
                ("frame_length", f"{order}u4"),
            ]
        )
        fields = raw[some].view(layout)
        start = block.start[rows[some]]
        stamp = fields["sec"].astype(np.int64) * 1_000_000_000 + fields["nanosec"]
        found = Payloads(
            buffer=block.buffer,
            layout=form,
            row=rows[some],
            body=start + ENCAPSULATION,
            size=block.end[rows[some]] - start - ENCAPSULATION,
            log_time=block.log_time[rows[some]],
            stamp=stamp,
            frame_length=fields["frame_length"].astype(np.int64),
        )
        whole = found.frame_length <= found.size - FRAME_TEXT
        payloads.append(found if whole.all() else found.at(whole))
        if not whole.all():
            passed.append((MALFORMED, found.row[~whole]))
    return payloads, passed


def accelerations(
    block: Block, lead: int, tail: int, turning: int | None = None
) -> tuple[list[Accelerations], Passed]:
    """Read a vector of 3 doubles at a fixed place behind the header.

    Args:
        block: messages of one type.
        lead: bytes between the header and the vector.
        tail: bytes from the vector to the end of the message, the vector included.
        turning: bytes between the header and an angular velocity, where the type has one, which
            its covariance follows.

    Returns:
        The vectors, and why messages were passed over.
    """
    groups, passed = stamped_payloads(block)
    found = []
    for group in groups:
        fields = group.aligned(FRAME_TEXT + group.frame_length, 8)
        slack = group.size - (fields + lead + tail)
        # Some writers pad a payload to a multiple of 4 or 8 bytes.
        sound = (slack >= 0) & (slack < 8)
        if not sound.all():
            passed.append((MALFORMED, group.row[~sound]))
            group, fields = group.at(sound), fields[sound]
        if not group.row.size:
            continue
        vector = gather_rows(group.buffer, group.body + fields + lead, 3, f"{group.order}f8")
        sources, source = _sources(group, block.channel[group.row])
        rates = None if turning is None else _rates(group, fields + turning)
        found.append(
            Accelerations(
                sources,
                source,
                group.row,
                group.stamp,
                group.log_time,
                vector.astype(np.float64, copy=False),
                rates,
            )
        )
    return found, passed


def _sources(group: Payloads, channel: Int) -> tuple[tuple[tuple[int, str], ...], Int]:
    """Tell messages apart by channel and frame_id.

    Args:
        group: N messages.
        channel: (N,) numbers of their channels.

    Returns:
        S pairs of channel and frame_id, and (N,) the pair of each message.
    """
    text = group.body + FRAME_TEXT
    there = np.flatnonzero(np.bincount(channel))
    place = np.zeros(int(there[-1]) + 1, np.int64)
    place[there] = np.arange(there.size)
    source = place[channel]
    first = np.zeros(there.size, np.int64)
    first[source[::-1]] = np.arange(source.size)[::-1]
    # Mostly a channel has one frame_id: comparing with its first message is faster than sorting.
    if not _alike(group, text, first[source]):
        one, frame = distinct(group.buffer, text, group.frame_length)
        pair = source * one.size + frame
        _, first, source = np.unique(pair, return_index=True, return_inverse=True)
    sources = tuple(
        (int(channel[k]), text_at(group.buffer, int(text[k]), int(group.frame_length[k])))
        for k in first
    )
    return sources, source.reshape(-1)


def _alike(group: Payloads, text: Int, other: Int) -> bool:
    """Whether the frame_id of each message is that of another, given by (N,) numbers."""
    length = group.frame_length
    if not (length == length[other]).all():
        return False
    for size in np.unique(length):
        rows = slice(None) if (length == size).all() else np.flatnonzero(length == size)
        mine = gather_rows(group.buffer, text[rows], int(size), np.uint8)
        theirs = gather_rows(group.buffer, text[other[rows]], int(size), np.uint8)
        if not np.array_equal(mine, theirs):
            return False
    return True


def _rates(group: Payloads, offset: Int) -> F64 | None:
    """Angular velocities (N, 3) at body offsets; None where all are zero or said to be absent.

    The first element of a covariance is -1 where there is no estimate (sensor_msgs/Imu).
    """
    values = gather_rows(group.buffer, group.body + offset, 4, f"{group.order}f8")
    absent = values[:, 3] == -1
    if absent.all() or not values[:, :3].any():
        return None
    rates = values[:, :3].astype(np.float64)
    rates[absent] = np.nan
    return rates


def align(offset: Int, size: int) -> Int:
    """Round (N,) body offsets up to a multiple of ``size``, a power of two."""
    return (offset + (size - 1)) & ~np.int64(size - 1)


def text_at(buffer: U8, start: int, length: int) -> str:
    """Decode a string of ``length`` bytes, its closing zero left out, as it can be printed."""
    raw = buffer[start : start + length].tobytes()
    return _decoded(raw) if length < LONG_TEXT else _decoded.__wrapped__(raw)


@lru_cache(maxsize=1 << 14)
def _decoded(raw: bytes) -> str:
    """A string as it can be printed; a log has few, and each in every block."""
    return printable(raw.split(b"\0")[0].decode(errors="replace"))
