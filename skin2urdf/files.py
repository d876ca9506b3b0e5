"""Files in and out: readers of results never meet half a file."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.magic import HEAD, log_in_words

_STREAMS = tuple(map(Path, ("/proc", "/dev/fd")))
"""Folders whose links are open files of a process; /dev/stdout leads there."""
_MOST_LINKS = 40
"""Links in a row that Linux follows."""


def check_target(path: str | Path, instead: str = "give the name of a file") -> Path:
    """Make sure that a file can be written at ``path``, before the work that fills it.

    Args:
        path: file to be written; it may exist already.
        instead: what to do where ``path`` is a stream or a device and no file.

    Returns:
        The absolute path, symbolic links resolved.

    Raises:
        UsageError: the folder does not exist or can not be written to, or ``path`` is a folder
            or another thing that is no regular file.
    """
    try:
        # A redirected stream resolves to its file, which would lose its name while it is written.
        if _leads_to_stream(Path(path).expanduser().absolute()):
            raise UsageError(f"can not write {path}: it is a stream and no file", instead)
        target = Path(path).expanduser().resolve()
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            target.stat()
    except (OSError, RuntimeError) as error:
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise UsageError(f"can not write {path}: {why}", "give another path") from error
    folder = target.parent
    if not folder.exists():
        raise UsageError(
            f"can not write {path}: the folder {folder} does not exist",
            f"create it (mkdir -p '{folder}') or give another output path",
        )
    if not folder.is_dir():
        raise UsageError(f"can not write {path}: {folder} is not a folder", "give another path")
    if target.is_dir():
        raise UsageError(
            f"can not write {path}: it is a folder", "give the name of a file inside of it"
        )
    if target.exists() and not target.is_file():
        raise UsageError(f"can not write {path}: it is not a regular file", instead)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise UsageError(
            f"can not write {path}: no permission to write in {folder}",
            "give a path in a folder that is yours",
        )
    return target


def _leads_to_stream(path: Path) -> bool:
    """Whether a path, or what a link of its chain points to, is an open file of a process."""
    for _ in range(_MOST_LINKS):
        folder = path.parent.resolve()
        if any(folder.is_relative_to(streams) for streams in _STREAMS):
            return True
        if not path.is_symlink():
            break
        path = folder / path.readlink()
    return False


def write_atomically(path: str | Path, text: str) -> None:
    """Write ``text`` as UTF-8 so that ``path`` is always the old file or the whole new one.

    A new file in the same folder is written, flushed to the disk and then renamed onto ``path``.
    Whatever goes wrong, the new file is removed and what was at ``path`` stays.

    Args:
        path: file to write; see :func:`check_target`.
        text: its new content.

    Raises:
        UsageError: ``path`` can not be written, the disk is full, and the like.
    """
    target = check_target(path)
    # Not tempfile: its files are private (mode 600), and the result should obey the umask.
    temporary = target.with_name(f".{target.name[:100]}.{secrets.token_hex(8)}.tmp")
    try:
        with temporary.open("x", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        raise UsageError(
            f"can not write {path}: {error.strerror or error}",
            "free some space or give another output path",
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def read_text(path: str | Path) -> str:
    """The text of a small UTF-8 file.

    Raises:
        UnreadableInputError: there is no such file, or it holds no UTF-8.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise UnreadableInputError(
            str(path), f"can not be read: {error.strerror or error}", "check the path"
        ) from error
    except ValueError as error:
        raise UnreadableInputError(str(path), "is no text in UTF-8", "check the path") from error


def read_description(path: str | Path) -> bytes:
    """What a file of text that describes a robot holds, such as a URDF.

    Raises:
        UnreadableInputError: there is no such file, or it is a log.
    """
    path = Path(path)
    try:
        if path.is_dir() and (path / "metadata.yaml").exists():
            what = "a folder with a rosbag2"
        else:
            content = path.read_bytes()
            what = log_in_words(content[:HEAD])
    except OSError as error:
        raise UnreadableInputError(
            str(path), f"can not be read: {error.strerror or error}", "check the path"
        ) from error
    if what:
        raise UnreadableInputError(
            str(path), f"this is {what}, and no URDF", "give a URDF file", "a log"
        )
    return content


def append_line(path: str | Path, line: str) -> None:
    """Add a line to the end of a file of text, which is begun where there is none.

    Args:
        path: the file; see :func:`check_target`.
        line: the line, without its end.

    Raises:
        UsageError: the file can not be written.
    """
    target = check_target(path)
    try:
        with target.open("a", encoding="utf-8", newline="\n") as file:
            file.write(f"{line}\n")
    except OSError as error:
        raise UsageError(
            f"can not write {path}: {error.strerror or error}", "give another path"
        ) from error
