r"""Turn a public run of a Baxter with an accelerometer in its hand into a log of the contract.

The data lie in github.com/tufts-ai-robotics-group/baxter_ws at commit 6be51b3, in
``src/run_scripts/src/data``: for each of six objects and ten trials an arm that lifts, shakes,
drops, pushes and pokes it, as JSON of the ROS messages. The repository names no licence for them:
they are read where they are and are not passed on. Shaking, 12 s each, moves most:

    git clone https://github.com/tufts-ai-robotics-group/baxter_ws
    git -C baxter_ws checkout 6be51b3
    for run in baxter_ws/src/run_scripts/src/data/*/*_shake_accel_*.json; do
        python scripts/real/baxter_hand.py "$run" "$(basename "$run" .json).mcap"
    done
    skin2urdf calibrate *_shake_accel_*.mcap --model baxter.urdf -o calibrated.urdf

Stamps, positions and readings are those of the messages. Joints are published in two kinds of
messages on one topic, 17 of both arms, torso and head, and one finger; the torso's position of
-12.57 rad, which means nothing, stays what it is, and so do gaps of up to 0.7 s.

What is known of the robot: the maker's URDF (``baxter_description`` of
github.com/RethinkRobotics/baxter_common), in which ``left_hand_accelerometer`` is a link. One
accelerometer on a chain of seven joints tells neither their order nor where it sits without it.

Exit status: 0; 2 where the data can not be read as a run or the log not be written.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from common import run

from skin2urdf.errors import UnreadableInputError
from skin2urdf.recording.records import JointStream, Recording, SuStream

SU = "left_hand_accelerometer"
ACCELEROMETER, JOINTS = "_accel_", "_jointstate_"
NANO = 1e-9


def recording(path: Path) -> Recording:
    """Read a run.

    Args:
        path: its file of the accelerometer's messages, beside which is that of the joints'.

    Returns:
        Joints and accelerometer on the robot's time.

    Raises:
        UnreadableInputError: one of both is missing, or holds something else.
    """
    if ACCELEROMETER not in path.name:
        what = f"the name has no {ACCELEROMETER}"
        raise UnreadableInputError(str(path), what, "give the file of an accelerometer")
    try:
        felt = [
            (stamp, [message["linear_acceleration"][axis] for axis in "xyz"])
            for stamp, message in _messages(path)
        ]
        positions: dict[str, list[tuple[float, float]]] = defaultdict(list)
        for stamp, message in _messages(path.with_name(path.name.replace(ACCELEROMETER, JOINTS))):
            for name, position in zip(message["name"], message["position"], strict=True):
                positions[name].append((stamp, position))
        start = min(felt[0][0], *(stamps[0][0] for stamps in positions.values()))
        times, readings = zip(*felt, strict=True)
        su = SuStream(SU, np.array(times) - start, np.array(readings, dtype=np.float64), f"/{SU}")
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise UnreadableInputError(str(path), "these are no messages of a run") from error
    joints = (
        JointStream(name, *(np.array(each) - [start, 0.0]).T) for name, each in positions.items()
    )
    return Recording(joints=tuple(joints), sus=(su,), start=start)


def _messages(path: Path) -> Iterator[tuple[float, dict[str, Any]]]:
    """Stamp [s] and fields of each message of a file, in the order in which they arrived."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UnreadableInputError(
            str(path), f"can not be read: {error.strerror}", "give a file of the data set"
        ) from error
    for number in sorted(found, key=int):
        stamp = found[number]["header"]["stamp"]
        yield stamp["secs"] + NANO * stamp["nsecs"], found[number]


if __name__ == "__main__":
    sys.exit(run(__doc__ or "", "the *_accel_*.json of a run", recording))
