"""What the adapters of public recordings share."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from skin2urdf.errors import Skin2UrdfError, UnreadableInputError
from skin2urdf.recording.records import Recording
from skin2urdf.recording.writing import write


def lines_of(path: Path) -> list[str]:
    """Read the lines of a text file that hold anything.

    Raises:
        UnreadableInputError: the file can not be read as text.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UnreadableInputError(
            str(path), f"can not be read: {error.strerror}", "give the folder of the data set"
        ) from error
    except UnicodeDecodeError as error:
        raise UnreadableInputError(str(path), "is not text") from error
    return [line for line in text.splitlines() if line.strip()]


def adapt(read: Callable[[], Recording], log: Path) -> int:
    """Read a public recording and write it as a log.

    Args:
        read: reads the recording.
        log: MCAP file to write.

    Returns:
        The exit status: 0, or that of what went wrong, which is printed.
    """
    try:
        recording = read()
        write(recording, log)
    except Skin2UrdfError as error:
        print(f"error: {error}", *[error.remedy] * bool(error.remedy), sep="\n  ", file=sys.stderr)
        return error.exit_status
    joints, sus = len(recording.joints), len(recording.sus)
    print(f"{log}: {joints} joints, {sus} SUs, {recording.duration:.1f} s")
    return 0
