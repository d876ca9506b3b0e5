"""Joints that move alike all along, which no reading tells from each other.

The fingers of a gripper have one drive, and their positions are published one as a multiple of the
other (mimic joints). What sits beyond one of them may as well sit beyond the other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.signals.motion import Motion, travel

_FAR = 10.0
"""Travel of a joint, over what its encoder may seem to go at rest, from which it is known what
another one is a multiple of: to a tenth."""
_EVERY = 5
"""Samples of which one is taken: 25 a second, in which no joint moves far."""


def joints_moved_alike(motions: Sequence[Motion]) -> tuple[tuple[str, ...], ...]:
    """Groups of joints whose positions are multiples of each other, by a constant apart.

    Args:
        motions: of the logs, with the same joints.
    """
    names = motions[0].dof_names
    creep = np.max([motion.creep for motion in motions], axis=0)
    moved = np.max([np.where(m.named, travel(m), 0.0) for m in motions], axis=0) > _FAR * creep
    q = np.concatenate([motion.q[motion.valid][::_EVERY] for motion in motions])
    left = [int(d) for d in np.flatnonzero(moved & np.all([m.named for m in motions], axis=0))]
    groups = []
    while left:
        first, *others = left
        alike = [d for d in others if _is_multiple(q[:, first], q[:, d], float(creep[d]))]
        if alike:
            groups.append(tuple(names[d] for d in (first, *alike)))
        left = [d for d in others if d not in alike]
    return tuple(groups)


def _is_multiple(q: F64, other: F64, within: float) -> bool:
    """Whether positions (N,) are a multiple of others, and a constant, within some distance."""
    from_mean, others = q - q.mean(), other - other.mean()
    off = others - (others @ from_mean) / (from_mean @ from_mean) * from_mean
    return bool(np.abs(off).max() <= within)
