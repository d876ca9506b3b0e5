"""Which way branches face that sliding joints alone carry, as these push them.

Gravity tells the directions in a branch up to a turn of all of it about the vertical, and each
branch and SU has grown with another one. Where joints that slide carry several, they push all of
them in one direction of the base: seen from each, that is the turn.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.geometry.so3 import axis_rotation
from skin2urdf.structure.accelerations import Along
from skin2urdf.structure.draft import Draft, groups
from skin2urdf.structure.worth import CONSISTENT

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class _Unit:
    """A branch or an SU that gravity tells nothing of but how it is tilted.

    Attributes:
        children: the branch's first joint, none of a single SU, and
        sus: its SUs.
        slides: k joints on the way to it that slide.
        push: (k, 3) their directions as it feels them, of length 1 where they are what they seem.
        sd: (k,) standard deviations of these.
    """

    children: Sequence[int]
    sus: Sequence[int]
    slides: Sequence[int]
    push: F64
    sd: F64


def facing_one_way(draft: Draft, samples: Along) -> Draft:
    """The draft with all that sliding joints push turned about the vertical to where they agree.

    An SU that starts the wrong way round is pushed against what it reads, and ends with a bias that
    no sensor has: a turn about the push alone brings no way out.

    Args:
        draft: a tree with all its joints.
        samples: the logs.
    """
    # A base that was tilted in between has shown by gravity which way all of it faces.
    if not np.allclose(draft.up, _UP):
        return draft
    axes: dict[int, F64] = {}
    for unit in sorted(_units(draft, samples), key=lambda unit: float(unit.sd.min())):
        angle = _turn(unit, axes)
        R = axis_rotation(_UP, np.array(angle))
        for j, push in zip(unit.slides, unit.push, strict=True):
            if j not in axes:
                axes[j] = R @ push / np.linalg.norm(push)
                draft = _with_axis(draft, j, axes[j])
        if angle:
            draft = draft.turned(unit.children, unit.sus, R)
    return draft


def _turn(unit: _Unit, axes: dict[int, F64]) -> float:
    """Angle [rad] about the vertical that brings pushes to known axes; 0 where nothing tells it."""
    along, across = 0.0, 0.0
    for j, push, sd in zip(unit.slides, unit.push, unit.sd, strict=True):
        # What pushes upwards looks the same from every side.
        if j in axes and np.hypot(*push[:2]) > CONSISTENT * sd:
            along += float(axes[j][:2] @ push[:2]) / sd**2
            across += float(push[0] * axes[j][1] - push[1] * axes[j][0]) / sd**2
    return float(np.arctan2(across, along))


def _units(draft: Draft, samples: Along) -> Iterator[_Unit]:
    """All that sliding joints push and gravity leaves free to turn about the vertical."""
    for at in range(len(draft.joints)):
        path = draft.path(at)
        slides = [j for j in path if draft.joints[j].kind == "prismatic"]
        if not slides or not all(draft.joints[j].is_hidden for j in path):
            continue
        for children, sus in groups(draft, at):
            if children and draft.joints[children[0]].is_hidden:
                continue
            judged = [draft.judged(samples, u) for u in sus]
            if judged:
                best = min(judged, key=lambda each: float(each.slide_sd[: len(slides)].sum()))
                k = len(slides)
                yield _Unit(children, sus, slides, best.slide[:k], best.slide_sd[:k])


def _with_axis(draft: Draft, joint: int, axis: F64) -> Draft:
    """The draft with another direction of a joint."""
    joints = list(draft.joints)
    direction = float(axis[0]), float(axis[1]), float(axis[2])
    joints[joint] = replace(joints[joint], axis=direction)
    return replace(draft, joints=tuple(joints))
