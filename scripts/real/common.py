"""What the adapters of public recordings share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import Skin2UrdfError, UnreadableInputError
from skin2urdf.recording.records import JointStream, Recording, SuStream
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


def held(
    position: dict[str, F64],
    reading: dict[str, F64],
    *,
    start: float,
    seconds: float,
    rate: float,
    between: float,
) -> Recording:
    """Make a log of rests of which one position and one reading each are known, and no times.

    Args:
        position: (P,) positions [rad] of each joint.
        reading: (P, 3) readings [m/s^2] of each SU.
        start: when the log begins [s since 1970].
        seconds: how long each rest is held, made up where the data do not tell it [s].
        rate: at which it is written again and again [Hz].
        between: time without any message between two rests [s].

    Returns:
        Positions and readings on made-up times.
    """
    rests = len(next(iter(position.values())))
    count = round(seconds * rate)
    time = np.add.outer(np.arange(rests) * (seconds + between), np.arange(count) / rate).ravel()
    of_time = np.repeat(np.arange(rests), count)
    return Recording(
        joints=tuple(JointStream(name, time, at[of_time]) for name, at in position.items()),
        sus=tuple(
            SuStream(name, time, felt[of_time], f"/{name}") for name, felt in reading.items()
        ),
        start=start,
    )


def run(doc: str, data: str, read: Callable[[Path], Recording]) -> int:
    """Read the arguments of an adapter, its data, and write them as a log.

    Args:
        doc: what the adapter says of itself.
        data: what the data are.
        read: reads them.

    Returns:
        The exit status: 0, or that of what went wrong, which is printed.
    """
    words, _, rest = doc.partition("\n")
    parser = argparse.ArgumentParser(
        description=words, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help=data)
    parser.add_argument("log", type=Path, help="MCAP file to write")
    arguments = parser.parse_args()
    try:
        recording = read(arguments.data)
        write(recording, arguments.log)
    except Skin2UrdfError as error:
        print(f"error: {error}", *[error.remedy] * bool(error.remedy), sep="\n  ", file=sys.stderr)
        return error.exit_status
    joints, sus = len(recording.joints), len(recording.sus)
    print(f"{arguments.log}: {joints} joints, {sus} SUs, {recording.duration:.1f} s")
    return 0
