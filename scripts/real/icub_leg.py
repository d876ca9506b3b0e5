r"""Turn the public recording of an iCub's right leg into a log of the contract.

The data lie in github.com/robotology-playground/sensors-calib-inertial at commit 3c31008a
(14 July 2016), in ``data/calibration/dumperExample/iCubGenova02/right_leg``: what YARP's dumper
wrote of the leg's encoders (``stateExt:o``) and of eleven accelerometer boards (``inertialMTB``).
The repository names no licence for them: they are read where they are and are not passed on.

    git clone https://github.com/robotology-playground/sensors-calib-inertial
    git -C sensors-calib-inertial checkout 3c31008a
    python scripts/real/icub_leg.py \
        sensors-calib-inertial/data/calibration/dumperExample/iCubGenova02/right_leg icub_leg.mcap

Stamps are the dumper's, positions the encoders' (degrees made radians), readings the boards'
counts times the full scale that the data's own code uses. Nothing is filtered or left out: a
board that answers with -1, and values that the bus repeats about five times, stay what they are.

What is known of the robot: the order of the boards in a message is that of their codes
(``src/EncodersAutoCalib/jointsNsensorsDefinitions.m``), and ``src/models/iCubGenova02`` holds the
leg's URDF with a link for each board. In the 33 s of the recording the hip's pitch turns by about
40 deg and back; the other five joints hold.

Exit status: 0; 2 where the data can not be read as this recording or the log not be written.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from common import lines_of, run

from skin2urdf.arrays import F64
from skin2urdf.errors import UnreadableInputError
from skin2urdf.recording.records import JointStream, Recording, SuStream

JOINTS = (
    "r_hip_pitch", "r_hip_roll", "r_hip_yaw", "r_knee", "r_ankle_pitch", "r_ankle_roll",
)  # fmt: skip
BOARDS = (
    *(f"r_upper_leg_mtb_acc_11b{k}" for k in range(1, 8)),
    *(f"r_lower_leg_mtb_acc_11b{k}" for k in range(8, 12)),
)
# A message of the boards: number and length of what follows, then for each board its address,
# kind, own time and three counts.
AHEAD, PER_BOARD = 2, 6
# m/s^2 of one count: SensorsData.m of the same commit.
FULL_SCALE = 5.9855e-04


def recording(folder: Path) -> Recording:
    """Read the recording.

    Args:
        folder: the one that holds ``stateExt:o`` and ``inertialMTB``.

    Returns:
        Encoders and boards on the dumper's time.

    Raises:
        UnreadableInputError: a file is missing or holds something else.
    """
    joints = _table(folder / "stateExt:o" / "data.log", 2 + len(JOINTS))
    boards = _table(folder / "inertialMTB" / "data.log", 2 + AHEAD + PER_BOARD * len(BOARDS))
    start = float(min(joints[0, 1], boards[0, 1]))
    joint_time, board_time = joints[:, 1] - start, boards[:, 1] - start
    position = np.deg2rad(joints[:, 2:])
    blocks = boards[:, 2 + AHEAD :].reshape(-1, len(BOARDS), PER_BOARD)
    return Recording(
        joints=tuple(
            JointStream(name, joint_time, position[:, k]) for k, name in enumerate(JOINTS)
        ),
        sus=tuple(
            SuStream(name, board_time, FULL_SCALE * blocks[:, k, 3:], f"/{name}")
            for k, name in enumerate(BOARDS)
        ),
        start=start,
    )


def _table(path: Path, width: int) -> F64:
    """Read the first columns of a dumper's file: (N, width), column 1 the stamp [s], increasing."""
    rows = [
        line.replace("(", " ").replace(")", " ").replace("[ok]", " ").split()[:width]
        for line in lines_of(path)
    ]
    try:
        table = np.array(rows, dtype=np.float64)
    except ValueError as error:
        raise UnreadableInputError(str(path), f"not the dumper's table: {error}") from error
    if table.ndim != 2 or table.shape[1] != width or not np.all(np.diff(table[:, 1]) > 0.0):
        raise UnreadableInputError(str(path), f"not rows of {width} columns in the order of time")
    return table


if __name__ == "__main__":
    sys.exit(run(__doc__ or "", "folder of the leg's recording", recording))
