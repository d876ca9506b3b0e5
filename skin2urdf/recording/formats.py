"""Open the files of a log, whatever their format, as containers of messages."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from skin2urdf.errors import UnreadableInputError
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.blocks import Block, Channels, Container
from skin2urdf.recording.container import McapFile
from skin2urdf.recording.gather import U8
from skin2urdf.recording.inputs import LogFile, opened
from skin2urdf.recording.packed import plain_messages, unpacked

PIECE = 1 << 24


class OpenedLog(NamedTuple):
    """A file of a log, open.

    Attributes:
        container: hands out its messages.
        size: bytes that there are to be read, unpacked ones where the file is packed.
    """

    container: Container
    size: int

    def blocks(self) -> Iterator[Block]:
        """Hand out the messages of all wanted channels, unpacked.

        Raises:
            UnreadableInputError: the file can not be read.
        """
        for block in self.container.blocks():
            yield from plain_messages(block, self.container.notes)

    @property
    def share(self) -> float:
        """Share of the file that has been read, in [0, 1]."""
        return min(1.0, self.container.position / max(1, self.size))


@contextlib.contextmanager
def opened_log(
    path: Path, channels: Channels, digest: Callable[[U8], None] | None
) -> Iterator[OpenedLog]:
    """Open one file of a log, and close it in the end.

    Args:
        path: the file.
        channels: the channels of the whole log.
        digest: takes all bytes of the file in their order, if given.

    Raises:
        UnreadableInputError: the file is no log, or can not be read.
    """
    with opened(path) as file:
        if file.kind == "mcap":
            yield OpenedLog(McapFile(file, channels, digest), file.size)
            return
        if digest is not None:
            for start in range(0, file.size, PIECE):
                digest(file.read(start, PIECE))
        if file.kind != "zstd":
            yield OpenedLog(_container(file, channels), file.size)
            return
        with unpacked(file) as (plain, note):
            try:
                with opened(plain) as inner:
                    container = _container(inner, channels)
                    container.compressions.add("zstd (whole file)")
                    container.notes += [ReadingNote("cut short", note)] if note else []
                    yield OpenedLog(container, inner.size)
            except UnreadableInputError as error:
                # The temporary file is gone, and says nothing to a user.
                what = str(error).removeprefix(f"{plain}: ")
                raise UnreadableInputError(
                    str(path), f"once unpacked: {what}", error.remedy, error.why
                ) from error


def _container(file: LogFile, channels: Channels) -> Container:
    """The container of a file that is not packed."""
    if file.kind == "mcap":
        return McapFile(file, channels)
    if file.kind == "sqlite3":
        from skin2urdf.recording.database import Database

        return Database(file, channels)
    if file.kind == "ros1":
        from skin2urdf.recording.ros1_bag import Ros1Bag

        return Ros1Bag(file, channels)
    if file.kind in ("csv", "parquet"):
        from skin2urdf.recording.tables import Table

        return Table(file, channels)
    raise UnreadableInputError(
        str(file.path), "this file is packed twice", f"unpack it with `zstd -d {file.path}`"
    )
