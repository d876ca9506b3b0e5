"""Mutants: bytes, MCAP records or messages of a sound log, changed at random."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

import numpy as np

from fuzzing.messages import Message, messages_of, written

MAGIC = b"\x89MCAP0\r\n"
# Numbers that programs trip over.
ODD = (0.0, -0.0, 1e-308, 1e5, 1e30, 1e308, -1e308, float("nan"), float("inf"), 9.81)

Mutation = Callable[[bytes, np.random.Generator], bytes]


def mutated_bytes(log: bytes, rng: np.random.Generator) -> bytes:
    """Flip, cut, repeat or zero some bytes."""
    data = bytearray(log)
    for _ in range(int(rng.integers(1, 8))):
        at = int(rng.integers(len(data)))
        size = int(2 ** rng.uniform(0, 12))
        kind = rng.integers(5)
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at : at + size] = rng.bytes(min(size, len(data) - at))
        elif kind == 2:
            del data[at : at + size]
        elif kind == 3:
            data[at:at] = data[at : at + size]
        else:
            data[at : at + size] = bytes(min(size, len(data) - at))
    return bytes(data[: int(rng.integers(len(data)))]) if rng.random() < 0.1 else bytes(data)


def mutated_records(log: bytes, rng: np.random.Generator) -> bytes:
    """Leave out, double, exchange or damage whole records."""
    records, at = [], len(MAGIC)
    while at + 9 <= len(log) - len(MAGIC):
        (length,) = struct.unpack_from("<Q", log, at + 1)
        records.append(log[at : at + 9 + length])
        at += 9 + length
    for _ in range(int(rng.integers(1, 6))):
        a, b = (int(k) for k in rng.integers(len(records), size=2))
        kind = rng.integers(6)
        if kind == 0 and len(records) > 2:
            del records[a]
        elif kind == 1:
            records.insert(b, records[a])
        elif kind == 2:
            records[a], records[b] = records[b], records[a]
        elif kind == 3:
            length = int(2 ** rng.uniform(0, 64)) & (2**64 - 1)
            records[a] = records[a][:1] + struct.pack("<Q", length) + records[a][9:]
        elif kind == 4 and len(records[a]) > 41:
            # The size that a chunk claims to have once unpacked.
            claim = struct.pack("<Q", int(2 ** rng.uniform(0, 40)))
            records[a] = records[a][:25] + claim + records[a][33:]
        else:
            records[a] = bytes([int(rng.integers(16))]) + records[a][1:]
    return MAGIC + b"".join(records) + MAGIC


def mutated_messages(log: bytes, rng: np.random.Generator) -> bytes:
    """Change times, values, order and payloads of messages, and write them as a sound log."""
    messages = list(messages_of(log))
    for _ in range(int(rng.integers(1, 4))):
        messages = _MESSAGE_KINDS[int(rng.integers(len(_MESSAGE_KINDS)))](messages, rng)
    return written(messages)


def _span(messages: Sequence[Message], rng: np.random.Generator) -> tuple[int, int]:
    """First and last of some messages in a row."""
    begin = int(rng.integers(len(messages)))
    return begin, min(len(messages), begin + int(2 ** rng.uniform(0, 14)))


def _topic(messages: Sequence[Message], rng: np.random.Generator) -> str:
    return str(rng.choice(sorted({message.topic for message in messages})))


def _dropped(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    begin, end = _span(messages, rng)
    topic = _topic(messages, rng) if rng.random() < 0.5 else None
    kept = [
        m for k, m in enumerate(messages)
        if not (begin <= k < end and topic in (None, m.topic))
    ]  # fmt: skip
    return kept or messages


def _reordered(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    window = 2 ** rng.uniform(0, 8)
    order = np.argsort(np.arange(len(messages)) + window * rng.random(len(messages)))
    return [messages[k] for k in order]


def _doubled(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    begin, end = _span(messages, rng)
    return messages[:end] + messages[begin:end] + messages[end:]


def _restamped(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    """Stamps of one topic or all move from some message on, or scatter, or are not set."""
    begin, _ = _span(messages, rng)
    topic = _topic(messages, rng) if rng.random() < 0.5 else None
    jump = int(1e9 * float(rng.choice([-1.0, 1.0])) * 10 ** rng.uniform(-3, 5))
    kind = rng.integers(3)

    def moved(k: int, message: Message) -> Message:
        if k < begin or topic not in (None, message.topic) or len(message.payload) < 12:
            return message
        sec, nanosec = struct.unpack_from("<iI", message.payload, 4)
        stamp = sec * 10**9 + nanosec
        if kind == 0:
            stamp += jump
        elif kind == 1:
            stamp += int(rng.integers(-abs(jump), abs(jump) + 1))
        else:
            stamp = 0
        sec, nanosec = divmod(max(0, min(stamp, (2**31 - 1) * 10**9)), 10**9)
        payload = message.payload[:4] + struct.pack("<iI", sec, nanosec) + message.payload[12:]
        return message._replace(payload=payload)

    return [moved(k, message) for k, message in enumerate(messages)]


def _revalued(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    """Doubles at the end of some messages of a topic become odd, or get a factor."""
    topic, share = _topic(messages, rng), 10 ** rng.uniform(-4, 0)
    odd = float(rng.choice(ODD))
    back = 8 * int(rng.integers(1, 14))

    def changed(message: Message) -> Message:
        payload = message.payload
        if message.topic != topic or rng.random() > share or len(payload) < 24 + back:
            return message
        at = len(payload) - back
        return message._replace(payload=payload[:at] + struct.pack("<d", odd) + payload[at + 8 :])

    return [changed(message) for message in messages]


def _damaged(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    """Payloads are cut, flipped, or another topic's."""
    out = list(messages)
    for k in rng.integers(len(out), size=int(rng.integers(1, 20))):
        message = out[k]
        payload = bytearray(message.payload)
        if payload and rng.random() < 0.5:
            payload[int(rng.integers(len(payload)))] ^= 1 << int(rng.integers(8))
        elif rng.random() < 0.5:
            payload = payload[: int(rng.integers(len(payload) + 1))]
        else:
            payload = bytearray(out[int(rng.integers(len(out)))].payload)
        out[k] = message._replace(payload=bytes(payload))
    return out


_MESSAGE_KINDS = (_dropped, _reordered, _doubled, _restamped, _revalued, _damaged)
MUTATIONS: tuple[Mutation, ...] = (mutated_bytes, mutated_records, mutated_messages)
# What a mutant is made of: every other one is of messages, which get furthest.
PLAN: tuple[tuple[str, Mutation], ...] = (
    (".mcap", mutated_messages),
    (".mcap", mutated_bytes),
    (".mcap", mutated_messages),
    (".mcap", mutated_records),
    (".mcap", mutated_messages),
    (".bag", mutated_bytes),
    (".mcap", mutated_messages),
    (".db3", mutated_bytes),
    (".mcap", mutated_messages),
    (".csv", mutated_bytes),
    (".mcap", mutated_messages),
    (".mcap.zstd", mutated_bytes),
)
