"""What was found of gyroscopes, in words and for the JSON file."""

from __future__ import annotations

from typing import Any

import numpy as np

from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.records import Gyros
from skin2urdf.recording.naming import shortened
from skin2urdf.report.tables import number

_DEG = float(np.rad2deg(1.0))
_CONTRADICTS = "it turns otherwise than its SU: its axes or its unit are others"
_STILL = "no joint turns it"


def gyro_notes(calibration: Calibration) -> list[str]:
    """Which gyroscopes counted, how good they are, and which did not count and why."""
    gyros = calibration.along.gyros if calibration.along else None
    if gyros is None:
        return []
    names = calibration.estimate.tree.su_names
    notes = []
    if gyros.used.any():
        used = gyros.used
        bias = np.linalg.norm(gyros.bias[:, used], axis=2).max()
        notes.append(
            f"the gyroscopes of {int(used.sum())} SUs count: noise of "
            f"{number(float(np.median(gyros.noise[used])) * _DEG, 3)} deg/s low-passed, biases of "
            f"up to {number(float(bias) * _DEG)} deg/s, scale errors of up to "
            f"{number(100 * float(np.abs(gyros.scale[used]).max()))} %"
        )
    # That nothing turns an SU on the base is as it should be.
    left_out = [name for name, odd in zip(names, gyros.contradict, strict=True) if odd]
    if left_out:
        notes.append(f"the gyroscope of {shortened(left_out)} does not count: {_CONTRADICTS}")
    return notes


def gyro_document(along: MotionEstimate | None, u: int) -> dict[str, Any] | None:
    """What was found of the gyroscope of SU u; None where it has none, or where none counted.

    In rad, s and their quotients; misalignments are what axis x reads of a turn about y and z, y
    of x and z, z of x and y.
    """
    gyros = along.gyros if along else None
    if gyros is None or not gyros.heard[u]:
        return None
    if not gyros.used[u]:
        return {"used": False, "why_not": _why_not(gyros, u)}
    return {
        "used": True,
        "why_not": None,
        "noise": gyros.noise[u],
        "bias": gyros.bias[:, u],
        "bias_sd": gyros.bias_sd[:, u],
        "scale": gyros.scale[u],
        "scale_sd": gyros.scale_sd[u],
        "misalignment": gyros.misalignment[u],
        "misalignment_sd": gyros.misalignment_sd[u],
        "delay": gyros.delay[u],
        "delay_sd": gyros.delay_sd[u],
    }


def _why_not(gyros: Gyros, u: int) -> str | None:
    """Why a gyroscope does not count; None where it does, or where there is none."""
    if gyros.used[u] or not gyros.heard[u]:
        return None
    return _CONTRADICTS if gyros.contradict[u] else _STILL
