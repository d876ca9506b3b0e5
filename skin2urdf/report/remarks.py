"""What a URDF says of itself in comments: what is open in it, and what is no estimate."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from skin2urdf.calibration.result import Calibration
from skin2urdf.report.findings import Findings
from skin2urdf.urdf.records import NO_LIMITS, JointLimits, Remarks


def remarks(calibration: Calibration, found: Findings, limits: JointLimits) -> Remarks:
    """Comments for the URDF of a calibration.

    Args:
        calibration: a finished calibration.
        found: the figures on it.
        limits: the limits that are written.
    """
    tree = calibration.model.tree
    head = [
        f"calibrated by skin2urdf from {', '.join(Path(s.path).name for s in calibration.sources)}",
        found.verdict,
        "masses, inertias and effort limits are placeholders that let physics engines load the "
        "file; everything else about this robot is in the JSON beside it",
    ]
    if found.positions_open:
        head.append(f"OPEN: {found.positions_open.what}")
    joints: dict[str, list[str]] = defaultdict(list)
    for limb in found.open_limbs:
        head.append(f"OPEN: {limb.words.what}")
        joints[limb.joint].append(f"OPEN: {limb.words.what}")
    pairs = zip(calibration.open_directions, found.between_branches, strict=True)
    for direction, unknown in pairs if not found.positions_open else ():
        for name in direction.joints:
            joints[name].append(f"OPEN: {unknown.what}")
    for j, name in enumerate(tree.joint_names):
        if not limits.known[j] and not calibration.continuous[j]:
            low, high = calibration.limits[j]
            unit = "m" if tree.prismatic[j] else "rad"
            joints[name].append(f"{NO_LIMITS}; the log went from {low:.4g} to {high:.4g} {unit}")
    sus = {
        name: tuple(f"OPEN: {unknown.what}" for unknown in words)
        for name, words in zip(tree.su_names, found.unknown, strict=True)
        if words
    }
    return Remarks(tuple(head), {name: tuple(lines) for name, lines in joints.items()}, sus)
