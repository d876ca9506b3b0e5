"""Calibrate a log, save the URDF, and compare it with the URDF of the robot that made the log.

usage: python scripts/examples/compare_with_truth.py LOG.mcap TRUTH.urdf ESTIMATE.urdf

Exits with 0 where both trees are equal.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skin2urdf import Calibration, calibrate, compare, save


def compare_with(
    calibration: Calibration, truth: str | Path, target: str | Path
) -> tuple[bool, list[str]]:
    """Save an estimate and say how far it is from the truth.

    Args:
        calibration: what was found.
        truth: the URDF to compare with.
        target: where the estimated URDF goes; its JSON goes beside it.

    Returns:
        Whether the trees are equal; their differences if not, else rms errors, without directions
        that the log leaves open.
    """
    urdf, _ = save(calibration, target)
    found = compare(urdf, truth, rng=np.random.default_rng(0))
    if found.tree_differences:
        return False, [each.words for each in found.tree_differences]
    return True, [
        f"SU positions: {1e3 * found.position.rms:.3f} mm rms",
        f"SU orientations: {np.rad2deg(found.orientation.rms):.3f} deg rms",
    ]


def main(arguments: Sequence[str]) -> int:
    """Calibrate and compare.

    Args:
        arguments: the log, the truth and the URDF to write.

    Returns:
        The exit status.
    """
    if len(arguments) != 3:
        print(__doc__)
        return 2
    log, truth, target = arguments
    equal, lines = compare_with(calibrate(log), truth, target)
    print("\n".join(lines))
    return int(not equal)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
