"""SUs that a tree says do not turn, and whose gyroscopes say that they do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.records import KinematicTree

_BY_JOINTS = 0.5
"""Share of what a gyroscope reads from which joints turn it: noise has some D / N of it, and a base
that sways under the robot does not follow the joints' velocities."""


def turned_all_the_same(
    sampled: Sequence[Sampled], su_names: Sequence[str], tree: KinematicTree
) -> tuple[str, ...]:
    """SUs beyond no joint that turns, of which joints' velocities explain what gyroscopes read.

    Such a tree is wrong, whatever accelerations it explains.

    Args:
        sampled: the logs on their grids.
        su_names: U SU names, in the order of the logs.
        tree: the tree.
    """
    return tuple(
        name
        for name, joint in zip(tree.su_names, tree.su_joint, strict=True)
        if all(tree.prismatic[d] for d in tree.chain(int(joint)))
        and any(_is_turned(s, list(su_names).index(name)) for s in sampled)
    )


def _is_turned(s: Sampled, u: int) -> bool:
    """Whether the joints' velocities explain most of what an SU's gyroscope reads in a log."""
    if s.turning is None:
        return False
    moved = s.motion.named & s.motion.moved
    use = s.motion.valid & s.turning.valid[:, u]
    if not moved.any() or use.sum() < 10 * (1 + moved.sum()):
        return False
    X = np.column_stack([np.ones(int(use.sum())), s.motion.qd[use][:, moved]])
    rates = s.turning.rates[use, u]
    left = rates - X @ np.linalg.lstsq(X, rates, rcond=None)[0]
    whole = ((rates - rates.mean(axis=0)) ** 2).sum()
    return bool((left**2).sum() < (1 - _BY_JOINTS) * whole)
