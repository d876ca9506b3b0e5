"""Limbs that nothing but gravity connects: what a log does not tell of where they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.uncertainty.bounds import ON_BASE, limbs_of
from skin2urdf.model.records import OpenDirection
from skin2urdf.report.words import TILT_REMEDY, Unknown, frames_at_zero

_APART = np.deg2rad(5.0)
"""Angle [rad] between the directions of gravity of two logs from which they tell the turn of limbs
about the vertical: half a degree of cross-axis error is then six degrees of turn."""


@dataclass(frozen=True, eq=False)
class OpenLimb:
    """A limb of which no reading tells where it is relative to another one.

    Attributes:
        joint: its first turning joint.
        reference: the first turning joint of the limb that counts as being in its place.
        directions: the ways in which it may sit elsewhere, in the frames of the URDF.
        words: the same in words.
    """

    joint: str
    reference: str
    directions: tuple[OpenDirection, ...]
    words: Unknown


def open_limbs(calibration: Calibration) -> tuple[OpenLimb, ...]:
    """Limbs beside the largest one: where they are relative to it is open.

    The URDF puts the first axis of every limb through the origin of the base. That is a free choice
    for one limb, and for the others as good as any.

    Args:
        calibration: a finished calibration.
    """
    tree, up = calibration.model.tree, calibration.estimate.state.up
    limbs = limbs_of(tree)
    found, sizes = np.unique(limbs[limbs != ON_BASE], return_counts=True)
    if len(found) < 2:
        return ()
    reference = tree.joint_names[int(found[np.argmax(sizes)])]
    turns = float(np.linalg.norm(np.cross(up, up[0]), axis=-1).max()) < np.sin(_APART)
    frames = frames_at_zero(calibration.model)
    return tuple(
        OpenLimb(
            tree.joint_names[j],
            reference,
            tuple(
                OpenDirection({tree.joint_names[j]: xi}, {})
                for xi in _moves(frames[j, :3, :3], up[0], turns)
            ),
            _words(tree.joint_names[j], reference, turns),
        )
        for j in map(int, found)
        if tree.joint_names[j] != reference
    )


def _moves(R_base_joint: F64, up: F64, turns: bool) -> list[F64]:
    """Twists (6,) of a joint's placement: along the axes of the base, and about the vertical."""
    slides = [np.concatenate([R_base_joint[axis], np.zeros(3)]) for axis in range(3)]
    turn = np.concatenate([np.zeros(3), R_base_joint.T @ up])
    return [*slides, turn] if turns else slides


def _words(joint: str, reference: str, turns: bool) -> Unknown:
    """What is not known of a limb."""
    what = f"place of the limb beyond {joint}"
    remedy = "measure it, or take it from a drawing"
    if turns:
        what += " and its turn about the vertical"
        remedy += f"; for the turn {TILT_REMEDY}"
    what += f" relative to that beyond {reference}; the URDF lets both begin at the base's origin"
    return Unknown("pose", "unconnected", what, "nothing but gravity connects them", remedy, joint)
