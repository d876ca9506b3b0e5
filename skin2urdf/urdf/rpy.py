"""Roll, pitch and yaw as URDF means them: ``R = Rz(yaw) Ry(pitch) Rx(roll)``."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64


def rpy_of_rotation(R: F64) -> F64:
    """Roll, pitch and yaw of a rotation, exact up to and through gimbal lock.

    Reading roll and yaw off separate elements of R loses all digits as the pitch nears +-90 deg,
    because either is then rounding noise. Roll and pitch are taken here from what is left of R
    after the yaw is undone, whatever value that had, so the three always rebuild R.

    Args:
        R: (3, 3) rotation.

    Returns:
        (3,) roll, pitch, yaw [rad].
    """
    yaw = np.arctan2(R[1, 0], R[0, 0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-R[2, 0], cos * R[0, 0] + sin * R[1, 0])
    roll = np.arctan2(sin * R[0, 2] - cos * R[1, 2], cos * R[1, 1] - sin * R[0, 1])
    return np.array([roll, pitch, yaw])
