"""The URDF of a calibration on a given model."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.geometry.se3 import inverse, log
from skin2urdf.urdf.check import InconsistentUrdfError
from skin2urdf.vendor.description import describe
from skin2urdf.vendor.editing import Attachment, with_additions
from skin2urdf.vendor.records import ModelCalibration
from skin2urdf.vendor.source import ModelText

_SAME = 1e-9
"""How exactly what was written has to read back [m, rad]."""
_MOVED = 1e-12
"""Correction of a placement that is none [m, rad]: rounding."""


def model_urdf(result: ModelCalibration) -> str:
    """The model's text with the SUs, and the corrected origins where that was asked for.

    Raises:
        InconsistentUrdfError: what was written does not read back as what was found.
    """
    chassis, text = result.chassis, result.chassis.description.text
    origins = {}
    if not result.kept:
        T = chassis.origins(result.along.state.T_parent_joint)
        moved = np.abs(result.corrections).max(axis=1, initial=0.0) > _MOVED
        origins = {chassis.joints[int(j)].name: T[j] for j in np.flatnonzero(moved)}
    attachments = attachments_of(result)
    new = with_additions(text.text, text.source, attachments, origins)
    _check(new, text, attachments, origins)
    return new


def attachments_of(result: ModelCalibration) -> tuple[Attachment, ...]:
    """The SUs as links."""
    rows = zip(result.su_links, result.links, result.T_link_su, strict=True)
    return tuple(Attachment(name, mount, link, T) for (name, mount), link, T in rows)


def _check(
    new: str, old: ModelText, attachments: Iterable[Attachment], origins: dict[str, F64]
) -> None:
    """Read it back."""
    read = {
        joint.name: joint
        for joint in describe(ModelText(new, old.source, old.kind, old.digest)).joints
    }
    wanted = origins | {each.mount: each.T_link_su for each in attachments}
    for name, T in wanted.items():
        off = np.abs(log(inverse(T) @ read[name].T_parent_origin)).max()
        if not off < _SAME:
            raise InconsistentUrdfError(f"{name} reads back {off:.1g} off")
