"""Find the files of a log and open them, or say in words why they are no log."""

from __future__ import annotations

import mmap
import os
import re
from pathlib import Path

import numpy as np

from skin2urdf.errors import UnreadableInputError
from skin2urdf.recording.framing import MAGIC
from skin2urdf.recording.gather import U8

RECORD_REMEDY = (
    "record with `ros2 bag record -s mcap TOPIC ...`, a topic of joint states and the topics of "
    "all accelerometers"
)
CONVERT_REMEDY = (
    "convert it to MCAP: write the lines `output_bags:`, `- uri: converted`, "
    "`  storage_id: mcap`, `  all: true` to out.yaml and run "
    "`ros2 bag convert -i {path} -o out.yaml`"
)
OTHER_FORMATS: tuple[tuple[bytes, str, str], ...] = (
    (b"SQLite format 3\0", "this is a rosbag2 of the sqlite3 storage (.db3)", CONVERT_REMEDY),
    (
        b"#ROSBAG V",
        "this is a ROS 1 bag",
        "convert it to a ROS 2 bag with `rosbags-convert --src {path} --dst converted "
        "--dst-storage mcap`",
    ),
    (
        b"\x28\xb5\x2f\xfd",
        "this file is compressed as a whole (zstd)",
        "unpack it with `zstd -d {path}`",
    ),
    (b"\x1f\x8b", "this file is compressed as a whole (gzip)", "unpack it with `gunzip {path}`"),
)


def log_files(path: Path) -> list[Path]:
    """List the MCAP files of a log.

    Args:
        path: an MCAP file, or a rosbag2 directory with one or more of them.

    Returns:
        The files, in the order rosbag2 numbers the parts of a split bag.

    Raises:
        UnreadableInputError: there is nothing there, or no MCAP file in the directory.
    """
    try:
        if not path.is_dir():
            return [path]
        names = sorted(path.iterdir(), key=_natural_order)
    except OSError as error:
        raise UnreadableInputError(str(path), _reason(error), _os_remedy(error)) from error
    files = [name for name in names if name.suffix == ".mcap"]
    if files:
        return files
    for name in names:
        if name.suffix == ".db3":
            raise UnreadableInputError(
                str(path), OTHER_FORMATS[0][1], CONVERT_REMEDY.format(path=path)
            )
        if name.name.endswith(".mcap.zstd"):
            raise UnreadableInputError(
                str(path),
                "its MCAP files are compressed as a whole (zstd)",
                f"unpack them with `zstd -d --rm {path}/*.mcap.zstd`",
            )
    raise UnreadableInputError(
        str(path), "the directory holds no .mcap file", f"give a log; {RECORD_REMEDY}"
    )


def open_bytes(path: Path) -> U8:
    """Map a file into memory.

    Args:
        path: a file that should be MCAP.

    Returns:
        (N,) the bytes of the file, read-only; read from disk as they are touched.

    Raises:
        UnreadableInputError: the file can not be read, is empty, or is of another format.
    """
    try:
        with path.open("rb") as stream:
            if os.fstat(stream.fileno()).st_size == 0:
                raise UnreadableInputError(
                    str(path), "the file is empty", f"nothing was recorded; {RECORD_REMEDY}"
                )
            data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        raise UnreadableInputError(str(path), _reason(error), _os_remedy(error)) from error
    if data[: len(MAGIC)] != MAGIC:
        raise _not_mcap(path, data[:32])
    return np.frombuffer(data, np.uint8)


def _not_mcap(path: Path, head: bytes) -> UnreadableInputError:
    """Say what a file is that does not start as MCAP does."""
    for magic, what, remedy in OTHER_FORMATS:
        if head.startswith(magic):
            return UnreadableInputError(str(path), what, remedy.format(path=path))
    if path.name == "metadata.yaml":
        return UnreadableInputError(
            str(path), "this describes a bag", f"give the directory it lies in: {path.parent}"
        )
    return UnreadableInputError(
        str(path),
        "this is not an MCAP file",
        f"give a .mcap file or a rosbag2 directory; {RECORD_REMEDY}",
    )


def _natural_order(path: Path) -> list[tuple[int, str]]:
    """Order bag_2 before bag_10."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _reason(error: Exception) -> str:
    """Say what the operating system said."""
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error)


def _os_remedy(error: Exception) -> str:
    """Say what to do about a file the operating system does not open."""
    if isinstance(error, PermissionError):
        return "give yourself the right to read it, e.g. with `chmod u+r`"
    if isinstance(error, FileNotFoundError):
        return "check the path"
    return "check that the path is a readable file"
