"""Names, positions and efforts out of many JointState payloads at once.

sensor_msgs/msg/JointState is a Header, then sequences: names, positions, velocities, efforts. The
names have no fixed size, so they are stepped over one name at a time, all messages together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Int, together
from skin2urdf.recording.blocks import Block
from skin2urdf.recording.cdr import (
    FRAME_TEXT,
    MALFORMED,
    Passed,
    Payloads,
    stamped_payloads,
    text_at,
)
from skin2urdf.recording.gather import distinct, gather_rows, grouped, put_rows

# Humanoids with hands have a hundred joints; a message that names far more is damaged, or would
# take hours to make sense of.
MOST_JOINTS = 4096


class JointPositions(NamedTuple):
    """What the JointState messages of one block and channel that name the same joints hold.

    Attributes:
        channel: number of the channel.
        names: J joint names, sorted.
        row: (N,) number of each message within its block.
        stamp: (N,) header.stamp [ns].
        log_time: (N,) when each message was recorded [ns].
        position: (N, J) positions in the order of `names`.
        effort: (N, J) efforts in that order, NaN in messages without; None where none has any.
    """

    channel: int
    names: tuple[str, ...]
    row: Int
    stamp: Int
    log_time: Int
    position: F64
    effort: F64 | None


def joint_positions(block: Block) -> tuple[list[JointPositions], Passed]:
    """Read names, positions and efforts of JointState messages.

    Names are decoded once per distinct order of names, not once per message.

    Args:
        block: messages of sensor_msgs/msg/JointState.

    Returns:
        What they hold per channel and set of joints, and why messages were passed over.
    """
    groups, passed = stamped_payloads(block)
    found: dict[tuple[int, tuple[str, ...]], list[JointPositions]] = {}
    for group in groups:
        group, count, names_end = _whole_names(group, passed)
        group, values = _whole_positions(group, count, names_end, passed)
        text = group.body + FRAME_TEXT
        first, layout = distinct(group.buffer, text, values.names_end - FRAME_TEXT)
        for rows in grouped(layout + first.size * block.channel[group.row]):
            names = _names(group, int(rows[0]))
            if len(set(names)) < len(names):
                passed.append(("a joint is named twice", group.row[rows]))
                continue
            order = sorted(range(len(names)), key=names.__getitem__)
            at = group.body[rows] + values.offset[rows]
            position = gather_rows(group.buffer, at, len(names), f"{group.order}f8")
            effort = _efforts(group, rows, values.efforts[rows], len(names))
            batch = JointPositions(
                channel=int(block.channel[group.row[rows[0]]]),
                names=tuple(names[j] for j in order),
                row=group.row[rows],
                stamp=group.stamp[rows],
                log_time=group.log_time[rows],
                position=position[:, order].astype(np.float64),
                effort=None if effort is None else effort[:, order],
            )
            found.setdefault((batch.channel, batch.names), []).append(batch)
    return [_in_order(batches) for batches in found.values()], [p for p in passed if p[1].size]


def in_radians(block: Block, factor: Callable[[str], float]) -> Block:
    """JointState messages with positions and velocities in other units, all else as it was.

    Args:
        block: messages of sensor_msgs/msg/JointState.
        factor: what those of a joint, given by its name, are multiplied by.

    Returns:
        The same messages in a buffer of their own. Damaged ones stay as they are.
    """
    block = replace(block, buffer=block.buffer.copy())
    groups, passed = stamped_payloads(block)
    for group in groups:
        group, count, names_end = _whole_names(group, passed)
        group, values = _whole_positions(group, count, names_end, passed)
        text = group.body + FRAME_TEXT
        _, layout = distinct(group.buffer, text, values.names_end - FRAME_TEXT)
        for rows in grouped(layout):
            factors = np.array([factor(name) for name in _names(group, int(rows[0]))])
            for offset in (values.offset[rows], values.velocities[rows]):
                at = group.body[rows[offset > 0]] + offset[offset > 0]
                numbers = gather_rows(group.buffer, at, factors.size, f"{group.order}f8")
                put_rows(group.buffer, at, (numbers * factors).astype(numbers.dtype))
    return block


class _Fields(NamedTuple):
    """Where names end and what was measured starts in (N,) JointState bodies.

    Attributes:
        names_end: offsets behind the last name.
        offset: of the positions.
        velocities: of the velocities; 0 in messages without one for each joint.
        efforts: of the efforts; 0 in messages without one for each joint.
    """

    names_end: Int
    offset: Int
    velocities: Int
    efforts: Int


def _whole_names(group: Payloads, passed: Passed) -> tuple[Payloads, Int, Int]:
    """Step over the names of JointState messages, all messages at once.

    Returns:
        The messages whose names are whole, with (N,) number of names and (N,) body offset behind
        the last name.
    """
    at = group.aligned(FRAME_TEXT + group.frame_length, 4) + 4 * group.layout.sized
    whole = at + 4 <= group.size
    count = np.zeros(at.size, np.int64)
    count[whole] = group.at(whole).uint32(at[whole])
    # A name takes 4 bytes at least; this also bounds the loop for damaged messages.
    whole &= count * 4 <= group.size
    many = whole & (count > MOST_JOINTS)
    whole &= ~many
    passed.append((f"more than {MOST_JOINTS} joints are named", group.row[many]))
    at = at + 4
    for k in range(int(count[whole].max(initial=0))):
        some = np.flatnonzero(whole & (k < count))
        here = group.aligned(at[some], 4)
        fits = here + 4 <= group.size[some]
        whole[some[~fits]] = False
        some, here = some[fits], here[fits]
        at[some] = here + 4 + group.at(some).uint32(here)
        whole[some] &= at[some] <= group.size[some]
    passed.append((MALFORMED, group.row[~whole & ~many]))
    return group.at(whole), count[whole], at[whole]


def _whole_positions(
    group: Payloads, count: Int, names_end: Int, passed: Passed
) -> tuple[Payloads, _Fields]:
    """Find what lies behind the names, and keep the messages that have a position per name."""
    at = group.aligned(names_end, 4)
    offset = group.aligned(at + 4, 8)
    positions = np.full(at.size, -1, np.int64)
    readable = at + 4 <= group.size
    positions[readable] = group.at(readable).uint32(at[readable])
    empty = (positions == 0) | (count == 0)
    whole = (positions == count) & (offset + 8 * count <= group.size) & ~empty
    passed.append(("no positions", group.row[empty]))
    passed.append((MALFORMED, group.row[~whole & ~empty]))
    kept, count, offset = group.at(whole), count[whole], offset[whole]
    velocities, behind = _sequence_behind(kept, count, offset + 8 * count)
    efforts, _ = _sequence_behind(kept, count, behind)
    return kept, _Fields(names_end[whole], offset, velocities, efforts)


def _sequence_behind(group: Payloads, count: Int, end: Int) -> tuple[Int, Int]:
    """Where a sequence of doubles starts that follows another.

    Args:
        group: messages.
        count: (N,) number of joints.
        end: (N,) offsets where the one before ends.

    Returns:
        (N,) offsets of its numbers, 0 where there is not one for each joint, and (N,) where it
        ends; beyond the message where it has neither one for each joint nor none.
    """
    at = group.aligned(end, 4)
    there = at + 4 <= group.size
    number = np.full(at.size, -1, np.int64)
    number[there] = group.at(there).uint32(at[there])
    # Of an empty sequence only the number is there.
    offset = np.where(number > 0, group.aligned(at + 4, 8), at + 4)
    behind = offset + 8 * number
    known = (number == 0) | ((number == count) & (behind <= group.size))
    return np.where(known & (number > 0), offset, 0), np.where(known, behind, group.size)


def _efforts(group: Payloads, rows: Int, offset: Int, n_joints: int) -> F64 | None:
    """(N, J) efforts of some messages, NaN in those without; None where none has any."""
    there = offset > 0
    if not there.any():
        return None
    efforts = np.full((rows.size, n_joints), np.nan)
    at = group.body[rows[there]] + offset[there]
    efforts[there] = gather_rows(group.buffer, at, n_joints, f"{group.order}f8")
    return efforts


def _names(group: Payloads, k: int) -> list[str]:
    """Decode the joint names of one message whose names are known to be whole."""
    body = int(group.body[k])

    def uint32(offset: int) -> int:
        raw = group.buffer[body + offset : body + offset + 4].tobytes()
        return int.from_bytes(raw, "little" if group.order == "<" else "big")

    alignment = min(4, group.layout.alignment)
    at = _align_one(FRAME_TEXT + int(group.frame_length[k]), alignment) + 4 * group.layout.sized
    names = []
    count = uint32(at)
    at += 4
    for _ in range(count):
        at = _align_one(at, alignment)
        length = uint32(at)
        names.append(text_at(group.buffer, body + at + 4, length))
        at += 4 + length
    return names


def _in_order(batches: list[JointPositions]) -> JointPositions:
    """Join batches of the same joints in the order of their messages."""
    if len(batches) == 1:
        return batches[0]
    row, stamp, log_time, position = (
        np.concatenate([getattr(b, key) for b in batches])
        for key in ("row", "stamp", "log_time", "position")
    )
    order = np.argsort(row)
    effort = together([(b.effort, b.position) for b in batches])
    return JointPositions(
        batches[0].channel,
        batches[0].names,
        row[order],
        stamp[order],
        log_time[order],
        position[order],
        None if effort is None else effort[order],
    )


def _align_one(offset: int, size: int) -> int:
    """Round one body offset up to a multiple of ``size``."""
    return -(-offset // size) * size
