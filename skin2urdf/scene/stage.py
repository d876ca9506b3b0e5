"""Where the limbs of a robot stand: a log does not tell how they sit on their common base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.scene.robot import BASE, Segment

_GAP = 0.25
"""Between limbs, over the mean of their widths."""


def chains(parts: Sequence[Segment]) -> dict[str, tuple[str, ...]]:
    """Joints from the base to each segment, by joint; none for the base."""
    parents = {part.joint: part.parent for part in parts}
    found: dict[str, tuple[str, ...]] = {BASE: ()}
    for joint in parents:
        path: list[str] = []
        at = joint
        while at != BASE and len(path) <= len(parents):
            path.append(at)
            at = parents[at]
        found[joint] = tuple(reversed(path))
    return found


def side_by_side(parts: Sequence[Segment], frames: Mapping[str, F64]) -> dict[str, F64]:
    """(4, 4) transforms that set limbs side by side along x, by their first joints.

    A robot with one limb stays where it is. SUs on the base stay at its origin.

    Args:
        parts: segments, the base first.
        frames: (4, 4) of all segments in the base frame, by joint.
    """
    chain = chains(parts)
    limbs: dict[str, list[F64]] = {}
    for part in parts:
        if part.joint == BASE:
            continue
        T = frames[part.joint]
        points = [T[:3, 3], *((T @ su)[:3, 3] for su in part.sus.values())]
        limbs.setdefault(chain[part.joint][0], []).extend(points)
    found = {name: np.eye(4) for name in limbs}
    if len(limbs) < 2:
        return found
    spans = {name: (np.min(p, axis=0)[0], np.max(p, axis=0)[0]) for name, p in limbs.items()}
    gap = _GAP * float(np.mean([high - low for low, high in spans.values()]))
    left = 0.0
    for name, (low, high) in spans.items():
        found[name][0, 3] = left - low
        left += high - low + gap
    for T in found.values():
        T[0, 3] -= 0.5 * (left - gap)
    return found
