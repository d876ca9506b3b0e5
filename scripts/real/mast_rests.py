r"""Turn the public rests of an arm on a mast, with two accelerometers, into a log of the contract.

The data lie in github.com/Hilti-Research/construction_robot_stationing_datasets at commit f26546d
(23 July 2024), under CC BY-NC-SA 3.0: each file of ``data/datasets`` holds some 440 rests of a mast
and of the arm of six joints on it, with the mean reading of an accelerometer on the base and of
one at the mast's tip. They are read where they are and are not passed on.

    git clone https://github.com/Hilti-Research/construction_robot_stationing_datasets
    git -C construction_robot_stationing_datasets checkout f26546d
    python scripts/real/mast_rests.py \
        construction_robot_stationing_datasets/data/datasets/flat.yaml mast.mcap

The stamps are those of the data, one reading and one set of positions 3 s to a minute apart: the
data hold nothing of the motion between them. So the log is one of rests, and **each is written
for the last 2 s before its stamp at 100 Hz**: the values are the data's, that they are held is
said here.

What is known of the robot: the mast slides (``column_prismatic_joint``), the arm stands on its
tip, and no sensor is beyond the arm's first joint (``data/trailblazer.urdf``). So a log shows
none of its joints. The base tilts by up to 1 mrad, the mast's tip by up to 12 mrad
with the arm's pose.

Exit status: 0; 2 where the data can not be read as these rests or the log not be written.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml
from common import lines_of, run

from skin2urdf.arrays import F64
from skin2urdf.errors import UnreadableInputError
from skin2urdf.recording.records import JointStream, Recording, SuStream

SENSORS = ("tilt_sensor_base", "tilt_sensor_column")
# How long a rest is written [s], and the rate at which, both made up [Hz].
HELD, RATE = 2.0, 100.0


def recording(file: Path) -> Recording:
    """Read the rests.

    Args:
        file: one of ``data/datasets``.

    Returns:
        Positions and means, each held for the time before its stamp.

    Raises:
        UnreadableInputError: the file holds something else.
    """
    try:
        data = yaml.safe_load("\n".join(lines_of(file)))
        names = tuple(str(name) for name in data["joint_names"])
        rows = sorted(_rests(data), key=lambda row: float(row[0]))
        table = np.array(rows, dtype=np.float64)
    except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise UnreadableInputError(str(file), f"not a table of rests: {error}") from error
    if table.ndim != 2 or table.shape[1] != 1 + len(names) + 3 * len(SENSORS):
        raise UnreadableInputError(str(file), "not one position of each joint in every rest")
    count = round(HELD * RATE)
    start = float(table[0, 0]) - HELD
    time = np.add.outer(table[:, 0] - start, np.arange(1 - count, 1) / RATE).ravel()
    held: F64 = np.repeat(table, count, axis=0)
    return Recording(
        joints=tuple(JointStream(name, time, held[:, 1 + k]) for k, name in enumerate(names)),
        sus=tuple(
            SuStream(name, time, held[:, 1 + len(names) + 3 * k :][:, :3], f"/{name}")
            for k, name in enumerate(SENSORS)
        ),
        start=start,
    )


def _rests(data: dict) -> Iterator[list[float]]:  # type: ignore[type-arg]
    """Go through the rests: stamp, positions, means of the base's and the mast's sensor."""
    for height in data["column_heights"].values():
        for solution in height["solution_spaces"].values():
            for rest in (
                *solution["stationing_measurements"],
                *solution["evaluation_measurements"],
            ):
                yield [
                    rest["time"],
                    *rest["joint_states"],
                    *(value for name in SENSORS for value in rest[f"{name}_accel"]),
                ]


if __name__ == "__main__":
    sys.exit(run(__doc__ or "", "file of the rests", recording))
