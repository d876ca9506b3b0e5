"""Accelerations of messages that are laid out as earlier ones of their channel.

A topic's messages differ in their stamps and numbers alone: their size, representation and
frame_id repeat. What was found out about one message of a channel with care
(:mod:`skin2urdf.recording.cdr`) holds for every later one whose bytes say the same, so that these
are compared, all channels at once, and not made sense of again.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.recording.blocks import Block
from skin2urdf.recording.cdr import (
    ENCAPSULATION,
    FRAME_TEXT,
    REPRESENTATION,
    Accelerations,
    align,
)
from skin2urdf.recording.gather import gather
from skin2urdf.recording.messages import ACCELERATION_LEAD, ANGULAR_VELOCITY_LEAD

# Up to the text of frame_id: encapsulation, stamp, length of the text.
HEAD = ENCAPSULATION + FRAME_TEXT
# Texts of frame_id that are compared, in words of 8 bytes; longer ones are rare.
WORDS = 4
UNKNOWN = -1


class Repeated(NamedTuple):
    """Accelerations of a block's messages that repeat earlier ones.

    Attributes:
        source: (N,) number of each message's source, as it was learnt.
        rows: (N,) number of each message within its block; None for all of them.
        stamp: (N,) header.stamp [ns].
        log_time: (N,) when each message was recorded [ns].
        vector: (N, 3) accelerations.
        rates: (N, 3) angular velocities [rad/s], None where no message has any.
        others: (M,) numbers of the messages that do not repeat any.
    """

    source: Int
    rows: Int | None
    stamp: Int
    log_time: Int
    vector: F64
    rates: F64 | None
    others: Int


@dataclass(eq=False)
class Layouts:
    """What is known of the messages of each channel.

    Attributes:
        source: (C,) number of the source of each channel's messages, -1 where none is known.
    """

    source: Int = field(default_factory=lambda: np.zeros(0, np.int64))
    _size: Int = field(default_factory=lambda: np.zeros(0, np.int64))
    _vector: Int = field(default_factory=lambda: np.zeros(0, np.int64))
    _kind: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint32))
    _length: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint32))
    _text: np.ndarray = field(default_factory=lambda: np.zeros((WORDS, 0), np.uint64))
    _mask: np.ndarray = field(default_factory=lambda: np.zeros((WORDS, 0), np.uint64))
    _words: int = 0

    def learn(self, block: Block, found: Accelerations, numbers: Int) -> None:
        """Take in the layout of channels that have one source each.

        Args:
            block: the messages.
            found: what was found in them.
            numbers: (S,) number of each source.
        """
        channels = np.array([channel for channel, _ in found.sources])
        count = np.bincount(channels, minlength=self.source.size)
        self._grow(count.size)
        first = np.full(len(channels), UNKNOWN, np.int64)
        first[found.source[::-1]] = found.row[::-1]
        for number, channel, row in zip(numbers, channels, first, strict=True):
            # Several SUs on one topic are told apart message by message.
            if count[channel] > 1 or self.source[channel] not in (UNKNOWN, number):
                self.source[channel] = UNKNOWN
                self._size[channel] = UNKNOWN
                continue
            begin, end = int(block.start[row]), int(block.end[row])
            head = block.buffer[begin : begin + HEAD]
            layout = REPRESENTATION.get(int.from_bytes(head[:2].tobytes(), "big"))
            length = int(head[12:16].view("<u4")[0])
            if layout is None or layout.order != "<" or length > 8 * WORDS or self._size[channel]:
                continue
            text = np.zeros(8 * WORDS, np.uint8)
            mask = np.zeros(8 * WORDS, np.uint8)
            text[:length] = block.buffer[begin + HEAD : begin + HEAD + length]
            mask[:length] = 0xFF
            fields = align(np.array(FRAME_TEXT + length), min(8, layout.alignment))
            lead = ACCELERATION_LEAD.get(block.ros_type, 0)
            self.source[channel] = number
            self._size[channel] = end - begin
            self._vector[channel] = ENCAPSULATION + int(fields) + lead
            self._kind[channel] = head[:4].view("<u4")[0]
            self._length[channel] = length
            self._text[:, channel] = text.view(np.uint64)
            self._mask[:, channel] = mask.view(np.uint64)
            self._words = max(self._words, -(-length // 8))

    def _grow(self, count: int) -> None:
        """Make room for channels up to a number."""
        more = count - self.source.size
        if more <= 0:
            return
        self.source = np.append(self.source, np.full(more, UNKNOWN, np.int64))
        for name in ("_size", "_vector", "_kind", "_length"):
            old = getattr(self, name)
            setattr(self, name, np.append(old, np.zeros(more, old.dtype)))
        for name in ("_text", "_mask"):
            old = getattr(self, name)
            setattr(self, name, np.concatenate([old, np.zeros((WORDS, more), old.dtype)], axis=1))

    def repeated(self, block: Block) -> Repeated | None:
        """Read the messages of a block that repeat earlier ones.

        Args:
            block: messages of a type that carries an acceleration.

        Returns:
            Their accelerations; None where few are.
        """
        channel, start = block.channel, block.start
        count = start.size
        reach = HEAD + 8 * self._words
        if (
            block.encoding != "cdr"
            or not self._words
            or int(start[-1]) + reach > block.buffer.size
            or int(channel.max()) >= self.source.size
        ):
            return None
        size = block.end - start
        same = size == self._size[channel]
        if np.count_nonzero(same) < count // 2 or int(start.max()) + reach > block.buffer.size:
            return None
        head = gather(block.buffer, start, f"V{reach}").view(np.uint32).reshape(count, -1)
        same &= head[:, 0] == self._kind[channel]
        same &= head[:, 3] == self._length[channel]
        words = head.view(np.uint64)[:, 2:]
        for k in range(self._words):
            same &= (words[:, k] & self._mask[k][channel]) == self._text[k][channel]
        stamp = head.view(np.int32)[:, 1].astype(np.int64) * 1_000_000_000 + head[:, 2]
        log_time, at = block.log_time, start + self._vector[channel]
        rows, others = None, np.zeros(0, np.int64)
        if not same.all():
            rows, others = np.flatnonzero(same), np.flatnonzero(~same)
            if rows.size < max(1, count // 2):
                return None
            channel, stamp, log_time, at = channel[rows], stamp[rows], log_time[rows], at[rows]
        vector, rates = _vectors(block, at)
        return Repeated(self.source[channel], rows, stamp, log_time, vector, rates, others)


def _vectors(block: Block, at: Int) -> tuple[F64, F64 | None]:
    """Accelerations at (N,) places of a block, and the angular velocities before them."""
    turning = ANGULAR_VELOCITY_LEAD.get(block.ros_type)
    if turning is None:
        return gather(block.buffer, at, "V24").view("<f8").reshape(-1, 3), None
    before = ACCELERATION_LEAD[block.ros_type] - turning
    numbers = gather(block.buffer, at - before, f"V{before + 24}").view("<f8")
    numbers = numbers.reshape(at.size, -1)
    return numbers[:, -3:], _with_absent(numbers[:, :4])


def _with_absent(values: F64) -> F64 | None:
    """Angular velocities (N, 3); None where all are zero or said to be absent.

    Args:
        values: (N, 4) the velocities and the first element of their covariance, which is -1 where
            there is no estimate (sensor_msgs/Imu).
    """
    absent: Bool = values[:, 3] == -1
    if absent.all() or not values[:, :3].any():
        return None
    rates = values[:, :3].astype(np.float64)
    if absent.any():
        rates[absent] = np.nan
    return rates
