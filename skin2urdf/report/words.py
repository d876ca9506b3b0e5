"""What a log does not tell of an SU, in words: what it is, why, and what to record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.model.records import KinematicModel

ARM = 0.1
"""Length [m] by which the angular part of a direction is multiplied."""
_ALIKE = 0.1
"""Part of a unit direction that may lie outside of a set of directions it counts as one of."""
PARALLEL = 0.05
"""Sine of the angle up to which axes count as parallel."""
VERTICAL = np.deg2rad(15.0)
"""Angle up to which an axis counts as vertical [rad]."""

TILT_REMEDY = "record a second log with the base tilted by 20 degrees or more"
CROSS_REMEDY = "say how large the sensors' cross-axis errors are by their data sheet (--cross)"


Part = Literal["pose", "position", "orientation", "slide", "turn", "tilt", "direction"]
"""What of something is not known: all of it, where it is, how it is turned, where it is along the
axis of a joint, how it is turned about that axis (the vertical, without a joint), how it is tilted
against gravity, or one direction of no special kind."""
Cause = Literal[
    "still", "silence", "little motion", "gravity alone", "vertical axis", "parallel axes",
    "one joint", "pushed", "bias", "unconnected",
]  # fmt: skip
"""What keeps a log from telling it: no joint moves it, its readings tell nothing, motion is too
small, too slow or too much alike, gravity alone is felt, the axis is vertical, those of all joints
are parallel, one joint alone turns it, joints push it and never turn it, bias looks the same, or
nothing but gravity connects it with the rest."""


@dataclass(frozen=True)
class Unknown:
    """Something a log does not tell.

    Attributes:
        part: what of it is not known, and
        cause: what keeps the log from telling it, for a script.
        what: what is not known.
        why: what keeps the log from telling it.
        remedy: what to record to learn it; empty where no recording helps.
        joint: the one along or about whose axis it is not known.
    """

    part: Part
    cause: Cause
    what: str
    why: str
    remedy: str = ""
    joint: str = ""

    def __str__(self) -> str:
        """All of it in one line."""
        return f"{self.what}: {self.why}" + (f"; {self.remedy}" if self.remedy else "")


NO_POSITIONS = Unknown(
    "position",
    "gravity alone",
    "positions of all joints and SUs, of which the figures in the URDF say nothing",
    "the log holds rests and slow motion, in which gravity alone is felt",
    "record moves of all joints at 0.5 rad/s or more, or patterns around the poses",
)
"""Where all samples count."""
NO_POSITIONS_OF_PATTERNS = replace(
    NO_POSITIONS,
    why="the log holds no patterns, and without its other samples gravity at rest alone is left",
    remedy="leave --motion patterns out, so that all samples count",
)
"""Where those around poses alone do."""


def unknowns(
    model: KinematicModel, unobservable: Sequence[F64], up: F64
) -> tuple[tuple[Unknown, ...], ...]:
    """Put the unobservable directions of every SU into words.

    Args:
        model: D joints and U SUs.
        unobservable: per SU (k, 6) orthonormal twists in its own frame, (linear [m], angular times
            :data:`ARM`), as
            :class:`skin2urdf.estimation.uncertainty.observability.Observability` has them.
        up: (G, 3) unit vector opposite to gravity in the base frame, per log.

    Returns:
        What is not known of each SU; empty where all of it is.
    """
    T_base_joint = frames_at_zero(model)
    return tuple(
        _of_reference(model.tree.su_names[u], len(rows))
        if model.tree.su_joint[u] < 0
        else _of_moving(model, u, np.asarray(rows, float), T_base_joint, up)
        for u, rows in enumerate(unobservable)
    )


def frames_at_zero(model: KinematicModel) -> F64:
    """(D, 4, 4) joint frames in the base frame with all joints at 0."""
    T = np.empty_like(model.T_parent_joint)
    for j, parent in enumerate(model.tree.parent):
        T[j] = model.T_parent_joint[j] if parent < 0 else T[parent] @ model.T_parent_joint[j]
    return T


def _of_reference(name: str, count: int) -> tuple[Unknown, ...]:
    """What is not known of an SU that no joint moves; gravity alone shows up to two turns of it."""
    if not count:
        return ()
    moves = "no joint moves it"
    if count == 6:
        return (
            Unknown(
                "pose",
                "still",
                f"where {name} sits and how it is turned",
                f"{moves}, and in one orientation its bias can not be told from a tilt",
                f"{TILT_REMEDY} to learn how it is turned; no recording tells where it sits",
            ),
        )
    why = f"{moves}, so that no recording tells it"
    unknown = [Unknown("position", "still", f"position of {name}", why)]
    if count > 3:
        what, why = f"turn of {name} about the vertical", f"{moves}; only its tilt shows"
        unknown.append(Unknown("turn", "still", what, why, TILT_REMEDY))
    return tuple(unknown)


def _of_moving(
    model: KinematicModel, u: int, rows: F64, T_base_joint: F64, up: F64
) -> tuple[Unknown, ...]:
    """What is not known of an SU that joints move."""
    name, tree = model.tree.su_names[u], model.tree
    chain = tree.chain(int(tree.su_joint[u]))
    names = [tree.joint_names[j] for j in chain]
    if not len(rows):
        return ()
    if len(rows) == 6:
        why = "its readings tell nothing"
        return (Unknown("pose", "silence", f"pose of {name}", why, more(names)),)
    turning = [j for j in chain if not tree.prismatic[j]]
    if not turning:
        return _of_pushed(name, names, rows)
    pivot = [tree.joint_names[j] for j in turning]
    T_base_su = T_base_joint[chain[-1]] @ model.T_joint_su[u]
    slide, turn = _about_axis(np.linalg.solve(T_base_joint[turning[-1]], T_base_su))
    parallel = _parallel(T_base_joint, turning)
    tilt = largest_angle(up, T_base_joint[turning[0], :3, 2])
    found: list[Unknown] = []
    if _holds(rows, np.eye(6)[:3]):
        why = f"{listed(pivot)} turned it too slowly for that"
        what = f"position of {name}"
        found.append(Unknown("position", "little motion", what, why, more(pivot)))
        rows = _without(rows, np.eye(6)[:3])
    elif _holds(rows, slide[None]):
        found.append(_along(name, pivot, parallel))
        rows = _without(rows, slide[None])
    if _holds(rows, turn[None]) and parallel:
        found.append(_yaw(name, pivot[-1], tilt))
        rows = _without(rows, turn[None])
    if len(rows) and parallel and tilt < VERTICAL:
        found.append(_tilt(name, pivot))
    elif len(rows):
        found.append(_some(name, names, rows))
    return tuple(found)


def _of_pushed(name: str, names: Sequence[str], rows: F64) -> tuple[Unknown, ...]:
    """What is not known of an SU that joints push but never turn."""
    pushed = f"{listed(names)} push" if len(names) > 1 else f"{names[0]} pushes"
    why = f"{pushed} it the same way wherever it sits"
    position = Unknown("position", "pushed", f"position of {name}", why)
    if not _holds(rows, np.eye(6)[:3]):
        return (_some(name, names, rows),)
    if not len(_without(rows, np.eye(6)[:3])):
        return (position,)
    why = "no joint turns it, and in one orientation its bias can not be told from a turn"
    return position, Unknown("orientation", "bias", f"how {name} is turned", why, TILT_REMEDY)


def _some(name: str, names: Sequence[str], rows: F64) -> Unknown:
    """Directions of no special kind."""
    part = _kinds(rows)
    return Unknown(
        part,
        "little motion",
        f"{part} of {name} along {len(rows)} of 6 directions",
        f"the motion of {listed(names)} in this log is too small or too much alike",
        more(names),
    )


def _about_axis(T_joint_su: F64) -> tuple[F64, F64]:
    """Unit directions (6,) of an SU along, and turning about, the z axis of a joint."""
    R, p = T_joint_su[:3, :3], T_joint_su[:3, 3]
    axis = R[2]  # R^T e_z: the joint's axis in the SU's frame
    turn = np.concatenate([R.T @ np.cross((0.0, 0.0, 1.0), p), ARM * axis])
    return np.concatenate([axis, np.zeros(3)]), turn / np.linalg.norm(turn)


def _parallel(T_base_joint: F64, chain: Sequence[int]) -> bool:
    """Whether the axes of all joints of a chain are parallel."""
    axes = T_base_joint[list(chain), :3, 2]
    sine = np.linalg.norm(np.cross(axes, axes[-1]), axis=-1)
    return bool((sine < PARALLEL).all())


def _holds(rows: F64, directions: F64) -> bool:
    """Whether the span of orthonormal ``rows`` holds all unit ``directions``, nearly."""
    if not len(rows):
        return False
    outside = directions - directions @ rows.T @ rows
    return bool((np.linalg.norm(outside, axis=-1) < _ALIKE).all())


def _without(rows: F64, directions: F64) -> F64:
    """Orthonormal rows of the span of ``rows`` square to the unit ``directions`` in it."""
    left = rows - rows @ directions.T @ directions
    _, values, Vt = np.linalg.svd(left, full_matrices=False)
    return np.asarray(Vt[values > 0.5])


def _along(name: str, names: Sequence[str], parallel: bool) -> Unknown:
    """An SU that may be slid along the axis of the last joint that turns it."""
    what = f"position of {name} along the axis of {names[-1]}"
    if len(names) == 1:
        why = f"{names[0]} is the only joint that turns it, so that no recording tells it"
        return Unknown("slide", "one joint", what, why, joint=names[0])
    if parallel:
        why = f"the axes of {listed(names)} are parallel, so that no recording tells it"
        return Unknown("slide", "parallel axes", what, why, joint=names[-1])
    why = f"the joints before {names[-1]} move too little or too slowly in this log"
    return Unknown("slide", "little motion", what, why, more(names[:-1]), names[-1])


def largest_angle(up: F64, axis: F64) -> float:
    """Largest angle between an axis and the vertical over all logs [rad]."""
    return float(np.max(np.arccos(np.clip(np.abs(up @ axis), 0.0, 1.0))))


def _tilt(name: str, names: Sequence[str]) -> Unknown:
    """An SU in which gravity never turns, so that its bias and scale look like a tilt."""
    why = f"gravity keeps its direction in it whatever {listed(names)} does, and so does bias"
    return Unknown("tilt", "bias", f"tilt of {name}", why, TILT_REMEDY)


def _yaw(name: str, joint: str, tilt: float) -> Unknown:
    """An SU that may be turned about the axis of a joint, ``tilt`` [rad] from the vertical."""
    what = f"turn of {name} about the axis of {joint}"
    if tilt < VERTICAL:
        degrees = np.rad2deg(tilt)
        why = "the axis is vertical" + (f" to {degrees:.0f} deg" if degrees >= 0.5 else "")
        return Unknown("turn", "vertical axis", what, why, TILT_REMEDY, joint)
    why = f"{joint} turns too little between the poses of this log"
    remedy = f"record poses in which {joint} differs by a radian or more"
    return Unknown("turn", "little motion", what, why, remedy, joint)


def _kinds(rows: F64) -> Part:
    """Which parts of a pose directions are about."""
    linear = float(np.sum(rows[:, :3] ** 2))
    angular = float(np.sum(rows[:, 3:] ** 2))
    if angular < _ALIKE**2 * linear:
        return "position"
    return "orientation" if linear < _ALIKE**2 * angular else "pose"


def more(names: Sequence[str]) -> str:
    """What to record where motion is missing."""
    return f"record more poses, with a pattern of 0.1 rad or more on {listed(names)}"


def listed(names: Sequence[str]) -> str:
    """Names in a sentence."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
