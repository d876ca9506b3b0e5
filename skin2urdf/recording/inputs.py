"""Find the files of a log and open them, or say in words why they are no log."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import FileIO
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from skin2urdf import magic
from skin2urdf.errors import UnreadableInputError
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.gather import U8
from skin2urdf.recording.naming import printable

Kind: TypeAlias = magic.Kind | Literal["csv"]

RECORD_REMEDY = (
    "record with `ros2 bag record -s mcap TOPIC ...`, a topic of joint states and the topics of "
    "all accelerometers"
)
# Text has no first bytes of its own.
TABLES = (".csv", ".tsv")
# What the files of a folder are called; the first kind that is there is the log.
SUFFIXES = (
    (".mcap", ".mcap.zstd"),
    (".db3", ".db3.zstd"),
    (".bag", ".bag.active"),
    (*TABLES, ".parquet"),
)
OTHER_FORMATS: tuple[tuple[bytes, str, str], ...] = (
    (
        b"#ROSBAG V",
        "this is a ROS 1 bag of another version than 2.0",
        "migrate it with `rosbag fix {path} fixed.bag`",
    ),
    (b"\x1f\x8b", "this file is compressed as a whole (gzip)", "unpack it with `gunzip {path}`"),
)


@dataclass(frozen=True)
class LogFile:
    """A file of a log that is read piece by piece.

    Pieces are read, not mapped into memory: a mapped file that someone shortens ends the process.

    Attributes:
        path: the file.
        size: bytes it had when it was opened.
        stream: the open file.
        kind: what it is, by its first bytes.
    """

    path: Path
    size: int
    stream: FileIO
    kind: Kind = "mcap"

    def read(self, start: int, size: int) -> U8:
        """Read bytes from ``start`` on, fewer than ``size`` at the end of the file.

        Raises:
            UnreadableInputError: the file can not be read, or was shortened since it was opened.
        """
        size = min(size, self.size - start)
        buffer = np.empty(size, np.uint8)
        done = 0
        while done < size:
            try:
                self.stream.seek(start + done)
                got = self.stream.readinto(buffer.data[done:])
            except OSError as error:
                raise UnreadableInputError(
                    str(self.path), _reason(error), _os_remedy(error)
                ) from error
            if not got:
                raise UnreadableInputError(
                    str(self.path),
                    "the file was shortened while it was read",
                    "wait until nothing writes to it any more, then try again",
                    "shortened",
                )
            done += got
        return buffer


class Part(NamedTuple):
    """A file of a log and its size [byte]."""

    path: Path
    size: int


def bag_parts(path: Path) -> tuple[list[Part], list[ReadingNote]]:
    """List the files of a log.

    Args:
        path: a file, or a rosbag2 directory with one or more of them.

    Returns:
        The files, in the order in which rosbag2's ``metadata.yaml`` names them, else in that in
        which it numbers the parts of a split bag; and notes on what of the directory was left out.

    Raises:
        UnreadableInputError: there is nothing there, or no file that can be read, or several
            of which nothing says that they belong together.
    """
    try:
        if not path.is_dir():
            with opened(path) as file:
                return [Part(path, file.size)], []
        names = sorted(path.iterdir(), key=_natural_order)
    except (OSError, ValueError) as error:
        raise UnreadableInputError(str(path), _reason(error), _os_remedy(error)) from error
    files = [name for name in names if name.name.endswith(tuple(itertools.chain(*SUFFIXES)))]
    if not files:
        raise UnreadableInputError(
            str(path),
            "the directory holds no .mcap, .db3, .bag, .csv or .parquet file",
            f"give a log; {RECORD_REMEDY}",
            "no log",
        )
    files, notes = _as_described(path, files)
    parts: list[Part] = []
    first: UnreadableInputError | None = None
    for file_path in files:
        try:
            with opened(file_path) as file:
                parts.append(Part(file_path, file.size))
        except UnreadableInputError as error:
            first = first or error
            why = str(error).removeprefix(f"{file_path}: ")
            words = f"{printable(file_path.name)} was left out: {why}"
            notes.append(ReadingNote("part left out", words, (file_path.name,)))
    if not parts and first is not None:
        raise first
    return parts, notes


def _as_described(folder: Path, files: list[Path]) -> tuple[list[Path], list[ReadingNote]]:
    """The files of a bag as its metadata.yaml names them, and notes on where the two differ."""
    described = folder / "metadata.yaml"
    try:
        # rosbag2 writes the folder's name before the file's in its first versions.
        names = [Path(name).name for name in listed_files(described.read_text(errors="replace"))]
    except OSError:
        return _undescribed(folder, files)
    present = {file.name: file for file in files}
    chosen = [present[name] for name in dict.fromkeys(names) if name in present]
    if not chosen:
        return _undescribed(folder, files)
    missing = [name for name in names if name not in present]
    others = [name for name in present if name not in names]
    notes = [
        ReadingNote(
            "part missing",
            f"{printable(name)} is missing, which metadata.yaml names as a part of the bag",
            (name,),
        )
        for name in missing
    ]
    if others:
        words = f"left out, as metadata.yaml does not name it: {', '.join(map(printable, others))}"
        notes.append(ReadingNote("part left out", words, tuple(others)))
    return chosen, notes


def _undescribed(folder: Path, files: list[Path]) -> tuple[list[Path], list[ReadingNote]]:
    """The files of a folder without a usable metadata.yaml: one log, or the parts of one.

    Raises:
        UnreadableInputError: they have the names of several logs.
    """
    files = _of_one_kind(files)
    if files[0].name.endswith(SUFFIXES[-1]):
        # Tables have no other way to be one log.
        return files, []
    logs = sorted({_PART.sub("", file.name) for file in files})
    if len(logs) > 1:
        names = ", ".join(printable(file.name) for file in files[:4])
        raise UnreadableInputError(
            str(folder),
            f"this folder is no bag (no metadata.yaml lists its files) and holds {len(files)} "
            f"logs: {names}{' and others' if len(files) > 4 else ''}",
            f"give one of them, such as {folder / files[0].name}",
        )
    what = f"{len(files)} parts of {printable(logs[0])}" if len(files) > 1 else files[0].name
    words = f"took {printable(what)}: this folder is no bag that lists its files"
    return files, [ReadingNote("no list of parts", words, tuple(file.name for file in files))]


_PART = re.compile(rf"(_\d+)?({'|'.join(map(re.escape, itertools.chain(*SUFFIXES)))})$")
"""What rosbag2 adds to a bag's name for each of its files."""


def _of_one_kind(files: list[Path]) -> list[Path]:
    """The files of the first kind that is there: a log is not read again in another format."""
    for suffixes in SUFFIXES:
        if found := [file for file in files if file.name.endswith(suffixes)]:
            return found
    return files


def listed_files(text: str) -> list[str]:
    """Read ``relative_file_paths`` out of rosbag2's metadata.yaml.

    Args:
        text: the file, in which a list stands as ``- a`` on lines of its own or as ``[a, b]``.

    Returns:
        The names in their order; empty where there are none.
    """
    found = re.search(r"^[ ]*relative_file_paths:[ ]*(.*)$", text, re.MULTILINE)
    if found is None:
        return []
    rest = text[found.start(1) :]
    if rest.startswith("["):
        items = rest[1:].split("]", 1)[0].split(",")
    else:
        listing = re.match(r"[^\n]*\n((?:[ ]*-[ ][^\n]*(?:\n|$))*)", rest)
        lines = listing.group(1).splitlines() if listing else []
        items = [line.strip()[1:] for line in lines]
    return [name for item in items if (name := item.strip().strip("'\""))]


@contextlib.contextmanager
def opened(path: Path) -> Iterator[LogFile]:
    """Open a file for reading, and close it in the end.

    Args:
        path: a file that should be a log.

    Raises:
        UnreadableInputError: the file can not be read, is empty, is no regular file, or is no
            log.
    """
    try:
        # Opening a pipe waits for someone to write to it, so what it is comes first.
        if not stat.S_ISREG(path.stat().st_mode):
            raise UnreadableInputError(
                str(path),
                "this is not a regular file",
                "logs are read more than once: write it to a file first, and give that file",
                "no regular file",
            )
        stream = FileIO(path)
    except (OSError, ValueError) as error:
        raise UnreadableInputError(str(path), _reason(error), _os_remedy(error)) from error
    with stream:
        file = LogFile(path, os.fstat(stream.fileno()).st_size, stream)
        if file.size == 0:
            raise UnreadableInputError(
                str(path), "the file is empty", f"nothing was recorded; {RECORD_REMEDY}", "empty"
            )
        yield replace(file, kind=_kind(path, file.read(0, magic.HEAD).tobytes()))


def _kind(path: Path, head: bytes) -> Kind:
    """What a file is by its first bytes, or an error that says what it is instead."""
    if kind := magic.log_kind(head):
        return kind
    if path.suffix.lower() in TABLES:
        return "csv"
    for start, what, remedy in OTHER_FORMATS:
        if head.startswith(start):
            raise UnreadableInputError(str(path), what, remedy.format(path=path))
    if path.name == "metadata.yaml":
        raise UnreadableInputError(
            str(path), "this describes a bag", f"give the directory it lies in: {path.parent}"
        )
    if what := magic.text_in_words(head):
        raise UnreadableInputError(str(path), f"this is {what}, and no log", "give a log", "a text")
    raise UnreadableInputError(
        str(path),
        "this is not an MCAP file, nor a log of another known format",
        f"give a .mcap, .db3, .bag, .csv or .parquet file, or a rosbag2 directory; {RECORD_REMEDY}",
        "another format",
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
