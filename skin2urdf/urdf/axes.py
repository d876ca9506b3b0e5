"""Errors of joint axes between an aligned estimate and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.structure.records import JointType
from skin2urdf.urdf.records import JointError, Spread


@dataclass(frozen=True, eq=False)
class AxisErrors:
    """Errors of all joints that can be compared.

    Attributes:
        joints: one entry per joint.
        angle: axis angles over all of them and all configurations [rad].
        distance: distances of axis lines over the revolute ones [m].
    """

    joints: tuple[JointError, ...]
    angle: Spread
    distance: Spread


def axis_errors(
    joints: Sequence[tuple[str, JointType]],
    axes_est: Sequence[F64],
    axes_true: Sequence[F64],
    places: Sequence[F64],
) -> AxisErrors:
    """Compare axes in one base frame.

    The distance of two axis lines is taken where it matters: from the point of the true axis that
    is nearest to the SUs which the joint carries, square to the estimated axis. The distance along
    the common normal would be meaningless, because two lines that should coincide and do not quite
    are nearest to each other anywhere.

    Args:
        joints: D names and types, the types being those of both robots.
        axes_est: D arrays (N, 6), the joint's columns of the Jacobian in the base frame at N
            configurations: for a revolute joint ``(-w x (any point of the axis), w)``, for a
            prismatic one ``(v, 0)``.
        axes_true: likewise.
        places: D arrays (N, 3), the middle of the SUs that the joint carries [m].
    """
    errors: list[JointError] = []
    angles: list[F64] = [np.zeros(0)]
    distances: list[F64] = [np.zeros(0)]
    for (name, kind), est, true, place in zip(joints, axes_est, axes_true, places, strict=True):
        part = slice(3, 6) if kind == "revolute" else slice(0, 3)
        angles.append(_angle(est[:, part], true[:, part]))
        spread = None
        if kind == "revolute":
            distances.append(_distance(est, true, place))
            spread = Spread.of(distances[-1])
        errors.append(JointError(name, kind, Spread.of(angles[-1]), spread))
    return AxisErrors(
        tuple(errors), Spread.of(np.concatenate(angles)), Spread.of(np.concatenate(distances))
    )


def _angle(a: F64, b: F64) -> F64:
    """(N,) angles between vectors (N, 3), exact for small ones [rad]."""
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.arctan2(sine, np.sum(a * b, axis=-1)))


def _distance(est: F64, true: F64, place: F64) -> F64:
    """(N,) distances of lines (N, 6) near ``place`` (N, 3) [m]."""
    v, w = true[:, :3], true[:, 3:]
    foot = np.cross(w, v)
    foot = foot + w * np.sum(w * (place - foot), axis=-1, keepdims=True)
    # |v + w x p| is the distance of p from the line of the unit twist (v, w).
    return np.asarray(np.linalg.norm(est[:, :3] + np.cross(est[:, 3:], foot), axis=-1))
