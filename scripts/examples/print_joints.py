"""Calibrate logs and print where every joint is, with its uncertainty.

usage: python scripts/examples/print_joints.py LOG.mcap [MORE.mcap ...]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from skin2urdf import Calibration, calibrate


def lines_of(calibration: Calibration) -> list[str]:
    """One line for each joint: its parent, its origin in the parent's frame, its axis' error."""
    model, seen = calibration.model, calibration.observability
    names = model.tree.joint_names
    lines = [f"{calibration.quality}: chi-squared/dof {calibration.estimate.cost_per_dof:.2f}"]
    for j, name in enumerate(names):
        parent = int(model.tree.parent[j])
        origin = ", ".join(f"{x:.4f}" for x in model.T_parent_joint[j, :3, 3])
        # Local coordinates of a joint are tx, ty [m], rx, ry [rad], square to its axis.
        tilt = np.rad2deg(np.sqrt(np.trace(seen.joint_covariance[j, 2:, 2:])))
        lines.append(
            f"{name} on {names[parent] if parent >= 0 else 'the base'} at ({origin}) m, "
            f"axis known to {tilt:.4f} deg, {seen.joint_verdict[j]}"
        )
    return lines


def main(arguments: Sequence[str]) -> int:
    """Print the joints that the logs show.

    Args:
        arguments: the logs.

    Returns:
        The exit status.
    """
    if not arguments:
        print(__doc__)
        return 2
    print("\n".join(lines_of(calibrate(list(arguments)))))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
