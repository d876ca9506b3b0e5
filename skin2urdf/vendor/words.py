"""Notes on a model and a log that were brought together, in words for the user."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.signals.sampling import Sampled
from skin2urdf.vendor.records import ModelCalibration


def model_notes(result: ModelCalibration, sampled: Sequence[Sampled]) -> list[str]:
    """What is to be said of joints, mount and links.

    Args:
        result: the calibration.
        sampled: its logs.
    """
    return [*_mount(result), *_joints(result, sampled), *_alternatives(result), *_names(result)]


def _mount(result: ModelCalibration) -> list[str]:
    up, tilt = result.along.state.up[0], np.rad2deg(result.tilt)
    if result.mount_open:
        return [
            "the log does not tell how the robot is mounted: its base's z axis was taken to be "
            f"{tilt:.0f} deg off the vertical (sd {np.rad2deg(result.tilt_sd):.0f} deg), and an "
            "upright one may be as true; move joints whose axes are not parallel"
        ]
    if not result.turned:
        return []
    x, y, z = up
    return [
        f"the robot is mounted turned: its base's z axis is {tilt:.1f} deg off the vertical (up is "
        f"{x:.3f} {y:.3f} {z:.3f} in {result.chassis.description.root})"
    ]


def _joints(result: ModelCalibration, sampled: Sequence[Sampled]) -> list[str]:
    chassis, notes = result.chassis, []
    if chassis.extra:
        notes.append(
            f"the model lacks {_listed(chassis.extra)} of the log: what these move has no place in "
            "it, and SUs there can not fit"
        )
    before = {joint.name for joint in chassis.joints}
    for name, at in chassis.absent.items():
        where = (
            "other joints of the log move beyond it" if name in before else "nothing moves by it"
        )
        notes.append(f"the log lacks {name} of the model: it is taken to rest at {at:g} ({where})")
    still = [
        joint.name
        for joint, column in zip(chassis.joints, chassis.measured, strict=True)
        if column >= 0 and not any(s.motion.moved[column] for s in sampled)
    ]
    if still:
        notes.append(f"{_listed(still)} kept still")
    return notes


def _alternatives(result: ModelCalibration) -> list[str]:
    chassis, notes = result.chassis, []
    for name, link, others in zip(result.tree.su_names, result.links, result.instead, strict=True):
        if others:
            notes.append(
                f"{name} may sit on {link} as well as on "
                f"{_listed([chassis.link(j) for j in others])}: no joint between them moved enough "
                "to tell; its place is right for where these joints were"
            )
    return notes


def _names(result: ModelCalibration) -> list[str]:
    links = set(result.chassis.description.links)
    return [
        f"the model has a link {name} already: the SU that was found is another one, {name}_su"
        for name in result.tree.su_names
        if name in links
    ]


def _listed(names: Sequence[str], most: int = 6) -> str:
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")
