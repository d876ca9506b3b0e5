"""The SUs that an earlier calibration has left: a URDF, and what stands in the JSON beside it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.errors import UnreadableInputError
from skin2urdf.urdf.beside import document_beside
from skin2urdf.vendor.description import Description, describe
from skin2urdf.vendor.source import read_model


@dataclass(frozen=True, eq=False)
class KnownSu(Record):
    """An SU as it was found.

    Attributes:
        name: the SU.
        joint: the joint before it; None on the base.
        mount: the fixed joint that holds it in the URDF.
        T_link_su: (4, 4) its frame in that of the link [m].
        covariance: (6, 6) of it, twists (linear [m], angular [rad]) in the SU's frame.
        unobservable: (k, 6) orthonormal directions along which nothing was known (linear [m],
            angular times the arm of :mod:`observability`).
        bias: (3,) [m/s^2].
        shape: (6,) scale errors and cross-axis terms.
    """

    name: str
    joint: str | None
    mount: str
    T_link_su: F64
    covariance: F64
    unobservable: F64
    bias: F64
    shape: F64


@dataclass(frozen=True, eq=False)
class KnownSkin(Record):
    """An earlier calibration.

    Attributes:
        description: the URDF.
        document: what stands in the JSON beside it.
        beside: the JSON.
        sus: its SUs.
        up: (3,) direction opposite to gravity in the base frame, as it was then.
    """

    description: Description
    document: Mapping[str, Any]
    beside: Path
    sus: tuple[KnownSu, ...]
    up: F64


def load_skin(urdf: str | Path) -> KnownSkin:
    """Read an earlier calibration.

    Args:
        urdf: a URDF that `skin2urdf calibrate` wrote, with its JSON beside it.

    Raises:
        UnreadableInputError: one of them can not be read, or they do not belong together.
    """
    description = describe(read_model(urdf))
    beside = document_beside(urdf)
    if beside is None:
        raise UnreadableInputError(
            str(urdf),
            "has no JSON of this very file beside it, which says how well its SUs are known",
            "give the URDF as skin2urdf calibrate wrote it, with the JSON in the same folder",
        )
    try:
        document = json.loads(beside.read_bytes())
        open_ = document["observability"]["sus"]
        sus = tuple(
            _su(name, su, open_[name]["unobservable"], description)
            for name, su in document["sus"].items()
        )
        up = np.array(document["gravity_up"][0], dtype=np.float64).reshape(3)
    except (OSError, ValueError, KeyError, TypeError, IndexError, StopIteration) as error:
        raise UnreadableInputError(
            str(beside), f"does not hold a calibration: {error}", "calibrate again"
        ) from error
    return KnownSkin(description, document, beside, sus, up / np.linalg.norm(up))


def _su(name: str, su: Mapping[str, Any], rows: Any, description: Description) -> KnownSu:
    """One SU out of the document."""
    link = su.get("su_link", name)
    carriers = {joint.child: joint for joint in description.joints}
    # Where a name was taken, the link has a suffix.
    mount = carriers.get(link) or carriers[f"{link}_su"]
    return KnownSu(
        name=name,
        joint=su["joint"],
        mount=mount.name,
        T_link_su=np.reshape(su["T_joint_su"], (4, 4)),
        covariance=np.reshape(su["covariance"], (6, 6)),
        unobservable=np.reshape(rows, (-1, 6)),
        bias=np.reshape(su["bias"], 3),
        shape=np.concatenate([np.reshape(su["scale"], 3), np.reshape(su["cross_yz_xz_xy"], 3)]),
    )
