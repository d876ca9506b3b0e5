r"""Turn the public rests of a Franka Panda with six IMUs into a log of the contract.

The data lie in github.com/HIRO-group/ros_robotic_skin at commit 8b042a8 (20 June 2020), under a
BSD licence (``package.xml``): ``config/panda_positions.txt`` holds the seven joint positions of
twelve rests, ``config/measured_static_acceleration.txt`` the mean reading of each IMU in each.

    git clone https://github.com/HIRO-group/ros_robotic_skin
    git -C ros_robotic_skin checkout 8b042a8
    python scripts/real/panda_rests.py ros_robotic_skin/config panda_rests.mcap

**The data hold no time of any sample**, only means: the stamps in the file are those of the lines
of its own listing, milliseconds apart. So the times of the log are not the robot's. Each mean is
written again and again for the 3 s that the data's own code averages over, at 100 Hz, and nothing
at all for the 5 s between two rests, where the robot moved and nobody recorded: the values are
the data's, that they are held is said here. A calibration can take gravity at rest from such a
log, and nothing that rests on motion, noise or clocks.

``imu_link0`` is no sensor: the listing holds 1, 1, 1 for it in every rest, and it is left out.

What is known of the robot: a Panda, joints in the order panda_joint1 to panda_joint7, and IMUs
numbered from base to tip. The number in a name is not that of the link: gravity turns by the angle
of panda_joint2 in imu_link1, and each further joint up to panda_joint6 turns one IMU less.

Exit status: 0; 2 where the data can not be read as these rests or the log not be written.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
from common import held, lines_of, run

from skin2urdf.arrays import F64
from skin2urdf.errors import UnreadableInputError
from skin2urdf.recording.records import Recording

JOINTS = tuple(f"panda_joint{k}" for k in range(1, 8))
NO_SENSOR = "imu_link0"
LINE = re.compile(
    r"\[(?P<stamp>[\d.]+)\]: \[Pose_(?P<pose>\d+), (?P<imu>\w+)\] "
    r"Mean Acceleration: \((?P<mean>[-\d. ]+)\)"
)
# How long the data's own code averages in a rest [s] (scripts/data_generators), the rate at which
# a mean is written and the time between two rests, both made up [Hz, s].
HELD, RATE, BETWEEN = 3.0, 100.0, 5.0


def recording(folder: Path) -> Recording:
    """Read the rests.

    Args:
        folder: ``config`` of the repository.

    Returns:
        Positions and means, each held for as long as it was averaged, on made-up times.

    Raises:
        UnreadableInputError: a file is missing or holds something else.
    """
    position = _positions(folder / "panda_positions.txt")
    start, means = _means(folder / "measured_static_acceleration.txt", len(position))
    return held(
        dict(zip(JOINTS, position.T, strict=True)),
        means,
        start=start,
        seconds=HELD,
        rate=RATE,
        between=BETWEEN,
    )


def _positions(path: Path) -> F64:
    """Read (P, 7) positions [rad] of the rests."""
    try:
        table = np.array([line.split() for line in lines_of(path)], dtype=np.float64)
    except ValueError as error:
        raise UnreadableInputError(str(path), f"not a table of positions: {error}") from error
    if table.ndim != 2 or table.shape[1] != len(JOINTS):
        raise UnreadableInputError(str(path), f"not rows of {len(JOINTS)} positions")
    return table


def _means(path: Path, rests: int) -> tuple[float, dict[str, F64]]:
    """Read when the listing was made [s since 1970] and of each IMU its (P, 3) means [m/s^2]."""
    found: dict[str, dict[int, list[float]]] = {}
    stamps = []
    for line in lines_of(path):
        match = LINE.search(line)
        if match is None:
            raise UnreadableInputError(str(path), f"not a line of means: {line[:60]}")
        stamps.append(float(match["stamp"]))
        mean = [float(value) for value in match["mean"].split()]
        found.setdefault(match["imu"], {})[int(match["pose"])] = mean
    found.pop(NO_SENSOR, None)
    expected = list(range(1, rests + 1))
    if not found or any(
        sorted(means) != expected or any(len(mean) != 3 for mean in means.values())
        for means in found.values()
    ):
        raise UnreadableInputError(str(path), f"not one mean of each IMU in {rests} rests")
    return stamps[0], {
        name: np.array([means[pose] for pose in expected]) for name, means in sorted(found.items())
    }


if __name__ == "__main__":
    sys.exit(run(__doc__ or "", "folder config of the repository", recording))
