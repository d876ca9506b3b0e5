"""The file of records: a line of JSON each, appended as they finish, by several writers if need be.

Beside the output lies an empty file that is only locked: one byte while a line is appended, and one
byte for every case that is under way. The system lets go of the locks of a process that ends,
however it ends, so that a case can be taken up by another batch as soon as its own is dead.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Generic

from batch.records import C, F, Record, parsed
from skin2urdf.errors import UnreadableInputError

_APPENDING = 0
_KEYS = 2**62


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
        self._locks: int | None = None
        self.refresh()
        if self.broken > 1 and not self.records:
            raise UnreadableInputError(
                str(path), "holds no run of this script", "give another file to --output"
            )

    def refresh(self) -> None:
        """Read what has been appended since, by whomever."""
        try:
            with self.path.open("rb") as file:
                file.seek(self._read)
                text = file.read()
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

    def append(self, record: Record[C, F]) -> None:
        """Add a record, on disk when this returns."""
        with self._locked(_APPENDING), self.path.open("ab+") as file:
            # What another writer left half done becomes a line that is passed over.
            if file.tell() and _last_byte(file.fileno()) != b"\n":
                file.write(b"\n")
            file.write(record.to_json().encode() + b"\n")
        self.records[record.case.key] = record

    def claim(self, case: C) -> bool:
        """Take a case; False where another batch on this file has it under way."""
        try:
            fcntl.lockf(self._lock_file(), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _byte_of(case))
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EAGAIN):
                return False
            raise
        return True

    def release(self, case: C) -> None:
        """Give a case back."""
        fcntl.lockf(self._lock_file(), fcntl.LOCK_UN, 1, _byte_of(case))

    def close(self) -> None:
        """Give all cases back."""
        if self._locks is not None:
            os.close(self._locks)
            self._locks = None

    @contextmanager
    def _locked(self, byte: int) -> Iterator[None]:
        fcntl.lockf(self._lock_file(), fcntl.LOCK_EX, 1, byte)
        try:
            yield
        finally:
            fcntl.lockf(self._lock_file(), fcntl.LOCK_UN, 1, byte)

    def _lock_file(self) -> int:
        """Descriptor of the file of locks, which is opened once: closing it frees every lock."""
        if self._locks is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            name = self.path.with_name(f".{self.path.name}.locks")
            self._locks = os.open(name, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        return self._locks


def _last_byte(file: int) -> bytes:
    return os.pread(file, 1, os.fstat(file).st_size - 1)


def _byte_of(case: C) -> int:
    """Place of a case's lock in the file of locks."""
    digest = hashlib.sha256(case.key.encode()).digest()
    return 1 + int.from_bytes(digest[:8], "big") % _KEYS
