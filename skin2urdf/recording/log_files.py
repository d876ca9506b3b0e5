"""The files of a log, whatever their format, read one after the other."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from skin2urdf.notes import ReadingNote
from skin2urdf.recording.blocks import Block, Channel, Channels
from skin2urdf.recording.formats import opened_log
from skin2urdf.recording.inputs import bag_parts
from skin2urdf.recording.naming import printable
from skin2urdf.recording.progress import Share


class LogFiles:
    """The files of a log; what is known about it grows as its messages are handed out.

    Attributes:
        channels: all channels met.
        notes: what was damaged or missing.
        profile: "ros2" or "ros1", as far as the files say.
        compressions: chunk compressions met.
        digest: SHA-256 over the bytes of all files (hex), once all blocks are read; empty where it
            is not asked for.
    """

    def __init__(
        self,
        path: Path,
        wanted: Callable[[Channel], bool],
        progress: Callable[[Share], None] | None = None,
        with_digest: bool = False,
    ) -> None:
        """Begin with a log.

        Args:
            path: a file or a directory.
            wanted: tells which channels' messages are handed out.
            progress: called now and then with the share that is read, up to 1.
            with_digest: whether to take the digest.
        """
        self.channels = Channels(wanted)
        self.notes: list[ReadingNote] = []
        self.profile = ""
        self.compressions: set[str] = set()
        self.digest = ""
        self._path = path
        self._progress = progress or (lambda _: None)
        self._with_digest = with_digest

    def blocks(self) -> Iterator[Block]:
        """Hand out the messages of all files.

        Raises:
            UnreadableInputError: there is no log, or it can not be read.
        """
        digest = hashlib.sha256()
        parts, notes = bag_parts(self._path)
        self.notes += notes
        total = sum(part.size for part in parts)
        before = 0
        for part in parts:
            take = (lambda piece: digest.update(piece.data)) if self._with_digest else None
            with opened_log(part.path, self.channels, take) as log:
                for block in log.blocks():
                    yield block
                    done = before + int(log.share * part.size)
                    self._progress(Share(done / total, done, total))
            before += part.size
            read = log.container
            self.profile = self.profile or read.profile
            self.compressions |= read.compressions
            several = len(parts) > 1
            self.notes += [_of_part(n, part.path.name) if several else n for n in read.notes]
        self.digest = digest.hexdigest() if self._with_digest else ""
        self._progress(Share(1.0, total, total))


def _of_part(note: ReadingNote, name: str) -> ReadingNote:
    """A note on one file of several."""
    return replace(note, words=f"{printable(name)}: {note.words}", sources=(name, *note.sources))
