"""The file of records: a line of JSON each, appended as they finish, by several writers if need be.

Bytes far beyond its end are locked: one while a line is appended, and one for every case that is
under way. The system lets go of the locks of a process that ends, however it ends, so that a case
can be taken up by another batch as soon as its own is dead.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
from pathlib import Path
from typing import Generic

from batch.records import C, F, Record, parsed
from skin2urdf.errors import UnreadableInputError

_CASES = 2**62
"""Where the bytes begin that stand for cases; the one before it stands for the end of the file."""


class Store(Generic[C, F]):
    """Records of one script in a file.

    Attributes:
        path: the file.
        records: by key, as far as they have been read; of several with one key the last counts.
        broken: lines that hold no whole record (of a batch that was killed while it wrote). The
            last one may yet become whole, if another writer is at it.
    """

    def __init__(self, path: Path, case: type[C], figures: type[F]) -> None:
        """Read a file; it need not exist.

        Args:
            path: the file.
            case: type of the script's cases.
            figures: type of its figures.

        Raises:
            UnreadableInputError: the file can not be read, or holds lines but no record of these
                types.
        """
        self.path = path
        self.records: dict[str, Record[C, F]] = {}
        self.broken = self._broken = 0
        self._types = case, figures
        self._read = 0
        self._file: int | None = None
        self.refresh()
        if self.broken > 1 and not self.records:
            raise UnreadableInputError(
                str(path), "holds no run of this script", "give another file to --output"
            )

    def refresh(self) -> None:
        """Read what has been appended since, by whomever."""
        try:
            text = self._unread()
        except FileNotFoundError:
            return
        except OSError as error:
            raise UnreadableInputError(
                str(self.path), f"can not be read: {error.strerror}"
            ) from error
        *lines, rest = text.split(b"\n")
        self._read += len(text) - len(rest)
        self._broken += sum(not self._take(line) for line in lines)
        self.broken = self._broken + (not self._take(rest))

    def _take(self, line: bytes) -> bool:
        """Take in a line; False where it is neither a record nor empty."""
        if not line.strip():
            return True
        try:
            record = parsed(line.decode("utf-8", errors="replace"), *self._types)
        except (ValueError, RecursionError):
            return False
        self.records[record.case.key] = record
        return True

    def _unread(self) -> bytes:
        """What lies behind the lines that have been read."""
        if self._file is None:
            with self.path.open("rb") as file:
                file.seek(self._read)
                return file.read()
        return os.pread(self._file, os.fstat(self._file).st_size - self._read, self._read)

    def append(self, record: Record[C, F]) -> None:
        """Add a record, as one line and at once."""
        file, end = self._opened(), _CASES - 1
        fcntl.lockf(file, fcntl.LOCK_EX, 1, end)
        try:
            size = os.fstat(file).st_size
            # What another writer left half done becomes a line that is passed over.
            half = size > 0 and os.pread(file, 1, size - 1) != b"\n"
            _write(file, b"\n" * half + record.to_json().encode() + b"\n")
        finally:
            fcntl.lockf(file, fcntl.LOCK_UN, 1, end)
        self.records[record.case.key] = record

    def claim(self, case: C) -> bool:
        """Take a case; False where another batch on this file has it under way."""
        try:
            fcntl.lockf(self._opened(), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _byte_of(case))
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EAGAIN):
                return False
            raise
        return True

    def release(self, case: C) -> None:
        """Give a case back."""
        fcntl.lockf(self._opened(), fcntl.LOCK_UN, 1, _byte_of(case))

    def close(self) -> None:
        """Give all cases back."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _opened(self) -> int:
        """Descriptor of the file, which is opened once: closing any of it frees every lock."""
        if self._file is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
            self._file = os.open(self.path, flags, 0o644)
        return self._file


def _write(file: int, text: bytes) -> None:
    """Write all of it; a disk that is full or a signal can cut a write short."""
    while text:
        text = text[os.write(file, text) :]


def _byte_of(case: C) -> int:
    """The byte that stands for a case."""
    digest = hashlib.sha256(case.key.encode()).digest()
    return _CASES + int.from_bytes(digest[:8], "big") % (_CASES - 1)
