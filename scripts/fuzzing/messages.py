"""The messages of a sound log, and a log of messages that may not be sound."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from io import BytesIO
from typing import NamedTuple

from mcap.reader import make_reader
from mcap.writer import Writer


class Message(NamedTuple):
    """A message of a log: topic, type, when it was recorded [ns], payload."""

    topic: str
    ros_type: str
    log_time: int
    payload: bytes


@lru_cache(maxsize=4)
def messages_of(log: bytes) -> tuple[Message, ...]:
    """All messages of a sound log, in the order of their log times."""
    return tuple(
        Message(channel.topic, schema.name if schema else "", message.log_time, message.data)
        for schema, channel, message in make_reader(BytesIO(log)).iter_messages()
    )


def written(messages: Sequence[Message]) -> bytes:
    """A log of these messages in this order."""
    stream = BytesIO()
    writer = Writer(stream, chunk_size=1 << 18)
    writer.start(profile="ros2")
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for topic, ros_type, log_time, payload in messages:
        if ros_type not in schemas:
            schemas[ros_type] = writer.register_schema(ros_type, "ros2msg", b"")
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "cdr", schemas[ros_type])
        writer.add_message(channels[topic], log_time, payload, log_time)
    writer.finish()
    return stream.getvalue()
