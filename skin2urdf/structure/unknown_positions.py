"""Joints whose positions a log lacks: what of that log can be used all the same.

A joint that a log does not name rests somewhere. Where it comes before all joints that the log
names, it only turns the base of what the SU feels, and the direction of gravity is estimated for
every log anyway. Behind a joint that moves its position matters, and the SUs beyond it say nothing.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.errors import InsufficientDataError
from skin2urdf.notes import Note
from skin2urdf.signals.records import Features
from skin2urdf.structure.ordering import Ordering
from skin2urdf.structure.records import KinematicTree


def usable(features: Features, tree: KinematicTree) -> Bool:
    """(P, U) False for the SUs of the tree that a log's unknown joint positions spoil.

    Of SUs beyond different unknown joints a log keeps those of one group, as only one base can be
    turned by the log's gravity: the group with most SUs that no other log holds, then the largest.

    Args:
        features: the measurements; unknown positions have an infinite deviation.
        tree: the structure, with names as in the features.

    Raises:
        InsufficientDataError: nothing is left of an SU.
    """
    order = Ordering.of(tree, features)
    known = np.isfinite(features.encoders.position_sd[:, order.dof])
    use = np.ones((features.n_poses, tree.n_sus), dtype=bool)
    if known.all():
        return use
    heard = features.valid[:, order.su]
    for log in np.unique(features.log[~known.all(axis=1)]):
        mine = features.log == log
        elsewhere = heard[~mine].any(axis=0)
        bases = [_base(tree, int(joint), known[mine].all(axis=0)) for joint in tree.su_joint]
        size: dict[tuple[int, ...], tuple[int, int]] = {}
        for u, base in enumerate(bases):
            if base is not None and heard[mine, u].any():
                only_here, moves = size.get(base, (0, 0))
                moves += len(tree.chain(int(tree.su_joint[u]))) - len(base)
                size[base] = only_here + int(not elsewhere[u]), moves
        chosen = max(size, key=size.__getitem__, default=())
        use[mine] &= np.array([base == chosen for base in bases])
    _check_left(heard, use, tree)
    return use


def _check_left(heard: Bool, use: Bool, tree: KinematicTree) -> None:
    gone = heard.any(axis=0) & ~(heard & use).any(axis=0)
    if gone.any():
        names = [tree.su_names[u] for u in np.flatnonzero(gone)]
        raise InsufficientDataError(
            f"{', '.join(names)}: recorded only in logs that lack positions of joints that matter "
            "to them",
            "publish and record the states of all joints in every log, of those at rest too",
            lacks="positions",
            names=names,
        )


def unknown_position_notes(features: Features, tree: KinematicTree) -> list[Note]:
    """Notes on logs that lack positions, and about the SUs that are not used from them."""
    use = usable(features, tree)
    groups: dict[tuple[int, ...], list[str]] = defaultdict(list)
    lost = features.valid[:, Ordering.of(tree, features).su] & ~use
    for u, name in enumerate(tree.su_names):
        logs = tuple(int(log) for log in np.unique(features.log[lost[:, u]]))
        if logs:
            groups[logs].append(name)
    return [Note("positions lacking", tuple(names), numbers=logs) for logs, names in groups.items()]


def _base(tree: KinematicTree, joint: int, named: Bool) -> tuple[int, ...] | None:
    """Unknown joints before an SU on ``joint`` if nothing named comes before them, else None."""
    chain = tree.chain(joint)
    unknown = tuple(j for j in chain if not named[j])
    return unknown if unknown == chain[: len(unknown)] else None
