"""How the joints moved in a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skin2urdf.recording.reading import read
from skin2urdf.recording.records import JointStream


@dataclass(frozen=True, eq=False)
class Motion:
    """The joints of a log over time.

    Attributes:
        joints: their streams.
        duration: time of the last sample [s].
    """

    joints: tuple[JointStream, ...]
    duration: float

    def at(self, time: float) -> dict[str, float]:
        """Positions of all joints at a time [s], between samples linearly [rad or m]."""
        return {j.name: float(np.interp(time, j.time, j.position)) for j in self.joints}


def load_motion(log: str | Path, progress: Callable[[float], None] | None = None) -> Motion:
    """Read the motion of a log.

    Args:
        log: MCAP file or rosbag2 folder.
        progress: told the share that is read.

    Raises:
        UnreadableInputError: it can not be read.
    """
    recording = read(log, progress, with_digest=False)
    joints = tuple(joint for joint in recording.joints if joint.time.size)
    return Motion(joints, max((float(joint.time[-1]) for joint in joints), default=0.0))
