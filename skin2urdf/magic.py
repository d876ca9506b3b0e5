"""What a file is by its first bytes: a log of some format, or what is taken for one."""

from __future__ import annotations

from typing import Literal, TypeAlias

Kind: TypeAlias = Literal["mcap", "sqlite3", "ros1", "zstd", "parquet"]

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of every file (https://mcap.dev/spec#magic)."""
ROS1_MAGIC = b"#ROSBAG V2.0\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""What a zstd frame starts with (RFC 8878, section 3.1.1). As the head of a payload it would name a
representation that does not exist."""
LOGS: tuple[tuple[bytes, Kind, str], ...] = (
    (MCAP_MAGIC, "mcap", "an MCAP file"),
    (b"SQLite format 3\0", "sqlite3", "an SQLite database, as a rosbag2 has it"),
    (ROS1_MAGIC, "ros1", "a ROS 1 bag"),
    (ZSTD_MAGIC, "zstd", "a file that is compressed as a whole (zstd)"),
    (b"PAR1", "parquet", "a Parquet table"),
)
"""First bytes of logs, what they are called, and that in words."""
HEAD = 32
"""Bytes that suffice."""


def log_kind(head: bytes) -> Kind | None:
    """The format of a log that begins with some bytes; None where it is no log that has any."""
    return next((kind for magic, kind, _ in LOGS if head.startswith(magic)), None)


def log_in_words(head: bytes) -> str:
    """What a log is that begins with some bytes; empty where it is no log that has any."""
    return next((words for magic, _, words in LOGS if head.startswith(magic)), "")


def text_in_words(head: bytes) -> str:
    """What a file is that begins as XML or JSON; empty where it is neither."""
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if start.startswith(b"<"):
        return "XML, such as a URDF"
    return "JSON" if start.startswith(b"{") else ""
