"""Joints that turn without end: positions that drivers wrap into one turn, unwrapped again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.recording.positions import TURN
from skin2urdf.recording.records import JointStream

_FASTEST = 30.0
"""Speed that no joint reaches in a log with rests and patterns [rad/s]."""
_GAP = 0.1
"""Time between samples from which a jump may be a move that was not recorded [s]."""
_ROUNDING = 0.05
"""What encoders and a pattern across the seam may add to a range of one turn [rad]."""


def unwrapped(stream: JointStream) -> tuple[JointStream, bool]:
    """A joint's stream without jumps by a turn, and whether there were any.

    A position wraps where it stays inside one turn and leaves one end of it for the other within
    one sample; whether that turn is (-pi, pi] or [0, 2 pi) does not matter.

    Args:
        stream: positions of one joint [rad or m].
    """
    x = stream.position
    if x.size < 2 or np.ptp(x) > TURN + _ROUNDING:
        return stream, False
    step, dt = np.abs(np.diff(x)), np.diff(stream.time)
    wraps = (np.abs(step - TURN) < _FASTEST * dt) & (step > np.pi) & (dt < _GAP)
    if not wraps.any():
        return stream, False
    return replace(stream, position=np.unwrap(x)), True
