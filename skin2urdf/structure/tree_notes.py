"""Notes on trees: what the log does not tell from them, and joints that they leave out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.notes import Note
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.records import KinematicTree


def doubt(tree: KinematicTree, other: KinematicTree) -> Note:
    """A note on a tree that the log does not tell from the one that was taken.

    Args:
        tree: the one that was taken.
        other: the other.
    """
    theirs = dict(_chains(other))
    taken, instead = next(
        ((chain, theirs[name]) for name, chain in _chains(tree) if chain != theirs[name]),
        (tree.joint_names, other.joint_names),
    )
    if taken == instead:
        return Note("sense unknown")
    return Note("other order", joints=taken, instead=instead)


def _chains(tree: KinematicTree) -> list[tuple[str, tuple[str, ...]]]:
    """The SUs, and the joints before each."""
    return [
        (name, tuple(tree.joint_names[j] for j in tree.chain(int(joint))))
        for name, joint in zip(tree.su_names, tree.su_joint, strict=True)
    ]


def left_out(
    sampled: Sequence[Sampled], dof: int, name: str, pushed: tuple[str, ...], *, moved: bool
) -> Note:
    """A note on a joint that is no part of the tree, and on SUs that it pushes all the same.

    Args:
        sampled: the logs.
        dof: the joint among those of the logs.
        name: its name.
        pushed: SUs that it moves otherwise than any joint does.
        moved: whether it moved at all.
    """
    if not moved:
        return Note("joint left out", joints=(name,), detail="never moved")
    span = max(float(np.ptp(s.motion.q[:, dof])) for s in sampled)
    if pushed:
        return Note("moves otherwise", pushed, (name,), size=span)
    return Note("joint left out", joints=(name,), detail="not shown", size=span)
