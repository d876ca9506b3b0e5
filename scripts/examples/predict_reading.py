"""Load a calibrated URDF in Pinocchio and predict what the accelerometer of one SU reads.

usage: python scripts/examples/predict_reading.py ROBOT.urdf SU [q1 q2 ...]

The joints stand still at the given positions [rad or m], in the URDF's order; 0 where not given.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from skin2urdf.arrays import F64
from skin2urdf.geometry.units import GRAVITY


def predict(
    urdf: str | Path, su: str, q: F64, qd: F64 | None = None, qdd: F64 | None = None
) -> F64:
    """Specific force that an SU's accelerometer reads.

    Args:
        urdf: a URDF whose base frame has z up, with every SU as a link.
        su: name of the SU.
        q: (nq,) configuration as Pinocchio has it.
        qd: (nv,) velocities [rad/s or m/s]; at rest where not given.
        qdd: (nv,) accelerations.

    Returns:
        (3,) in the SU's frame [m/s^2].

    Raises:
        ValueError: the URDF has no link of that name.
    """
    model = pin.buildModelFromUrdf(str(urdf))
    if not model.existFrame(su):
        raise ValueError(f"{urdf} has no link {su}")
    data, still = model.createData(), np.zeros(model.nv)
    pin.forwardKinematics(
        model, data, q, still if qd is None else qd, still if qdd is None else qdd
    )
    pin.updateFramePlacements(model, data)
    frame = model.getFrameId(su)
    acceleration = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL).linear
    up = data.oMf[frame].rotation.T @ np.array([0.0, 0.0, GRAVITY])
    return np.asarray(acceleration + up)


def main(arguments: Sequence[str]) -> int:
    """Print one reading.

    Args:
        arguments: the URDF, the SU, and joint positions.

    Returns:
        The exit status.
    """
    if len(arguments) < 2:
        print(__doc__)
        return 2
    urdf, su, *positions = arguments
    model = pin.buildModelFromUrdf(urdf)
    step = np.zeros(model.nv)
    step[: len(positions)] = [float(x) for x in positions]
    x, y, z = predict(urdf, su, pin.integrate(model, pin.neutral(model), step))
    print(f"{su} reads ({x:.4f}, {y:.4f}, {z:.4f}) m/s^2")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
