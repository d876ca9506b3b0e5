"""The robot's description that a bag holds: the text on a topic such as /robot_description."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from skin2urdf.recording.cdr import ENCAPSULATION
from skin2urdf.recording.log_files import LogFiles

_TYPE = "std_msgs/msg/String"
_TOPIC = "robot_description"


def robot_descriptions(path: str | Path) -> dict[str, bytes]:
    """The last description on every topic whose name ends in ``robot_description``.

    Args:
        path: a log, as for :func:`skin2urdf.recording.reading.read`.

    Returns:
        The text as it was sent (UTF-8), by topic; empty where the log holds none.

    Raises:
        UnreadableInputError: the log can not be read.
    """
    log = LogFiles(
        Path(path), lambda channel: channel.ros_type == _TYPE and channel.topic.endswith(_TOPIC)
    )
    found: dict[str, bytes] = {}
    for block in log.blocks():
        for channel, start, end in zip(block.channel, block.start, block.end, strict=True):
            text = _string(np.asarray(block.buffer[int(start) : int(end)]).tobytes())
            if text is not None:
                found[log.channels.known[int(channel)].topic] = text
    return found


def _string(payload: bytes) -> bytes | None:
    """The text of a CDR string message; None where it is cut short."""
    if len(payload) < ENCAPSULATION + 4:
        return None
    # The lowest bit of the representation says which end comes first.
    order = "<" if payload[1] & 1 else ">"
    (length,) = struct.unpack_from(f"{order}I", payload, ENCAPSULATION)
    text = payload[ENCAPSULATION + 4 : ENCAPSULATION + 4 + length]
    return text.rstrip(b"\0") if len(text) == length else None
