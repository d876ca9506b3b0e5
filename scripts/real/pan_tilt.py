r"""Turn a public sweep of a pan-tilt camera on hobby servos into a log of the contract.

The data lie in github.com/AstraZeneca/PerfCam-Dataset at commit 89759b2 (2 May 2025), under the
Apache License 2.0: in ``experiments/az_kul_small_line/3d_reconstruction/by_perfcam/spots`` are 26
folders, one for each place the stand was put to. Each holds 77 rests of its three servos
(``motor_angles_K.json``, degrees as commanded) with one sample of the camera's IMU each
(``frame_imu_K.json``, an Intel RealSense D435i).

    git clone --no-checkout https://github.com/AstraZeneca/PerfCam-Dataset
    git -C PerfCam-Dataset checkout 89759b2 -- experiments/az_kul_small_line/3d_reconstruction
    python scripts/real/pan_tilt.py \
        PerfCam-Dataset/experiments/az_kul_small_line/3d_reconstruction/by_perfcam/spots/1 tilt.mcap

**The data hold no times**: each sample is written again and again for 1 s at 100 Hz, and nothing at
all for the 2 s between two rests. So a log can show gravity at rest, and nothing that rests on
motion, noise or clocks. Rates of the gyroscope are left out, since they are those of a rest.

What is known of the robot: ``angle0`` pans the camera about an axis that is vertical but for some
degrees, in steps of 18 deg from 0 to 180, ``angle1`` stays, ``angle2`` tilts it, in steps of
18 deg from 63 to 180. No geometry is published. Servos say where they were sent, not where they
are: they miss by a degree or two.

Exit status: 0; 2 where the data can not be read as these rests or the log not be written.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from common import held, lines_of, run

from skin2urdf.arrays import F64
from skin2urdf.errors import UnreadableInputError
from skin2urdf.recording.records import Recording

JOINTS = ("angle0", "angle1", "angle2")
AXES = ("x", "y", "z")
# How long a rest is held, the rate at which its sample is written and the time between two rests,
# all made up [s, Hz, s].
HELD, RATE, BETWEEN = 1.0, 100.0, 2.0


def recording(folder: Path) -> Recording:
    """Read the rests of one place.

    Args:
        folder: the one of the place, which holds ``data``.

    Returns:
        Positions and samples, each held, on made-up times.

    Raises:
        UnreadableInputError: a file is missing or holds something else.
    """
    angles = sorted(
        (folder / "data").glob("motor_angles_*.json"),
        key=lambda path: int(path.stem.split("_")[-1]),
    )
    if not angles:
        raise UnreadableInputError(str(folder), "holds no rests", "give the folder of one place")
    imus = [path.with_name(path.name.replace("motor_angles", "frame_imu")) for path in angles]
    position = np.deg2rad([_numbers(path, None, JOINTS) for path in angles])
    reading = np.array([_numbers(path, "acceleration", AXES) for path in imus])
    return held(
        dict(zip(JOINTS, position.T, strict=True)),
        {"camera": reading},
        start=0.0,
        seconds=HELD,
        rate=RATE,
        between=BETWEEN,
    )


def _numbers(path: Path, within: str | None, names: tuple[str, ...]) -> F64:
    """Read numbers by their names from a file of JSON, or from an object in it."""
    try:
        found = json.loads("\n".join(lines_of(path)))
        found = found if within is None else found[within]
        return np.array([found[name] for name in names], dtype=np.float64)
    except (ValueError, KeyError, TypeError) as error:
        raise UnreadableInputError(str(path), f"not {', '.join(names)}: {error}") from error


if __name__ == "__main__":
    sys.exit(run(__doc__ or "", "folder of one place", recording))
