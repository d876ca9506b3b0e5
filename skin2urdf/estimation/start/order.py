"""Order of DoFs that the activity matrix can not tell apart: inside joints, across bare segments.

Seen from an SU, the axis of a DoF and its lever arm move only when a DoF between it and the SU
moves. So the outermost of several DoFs is the one whose column of the SU's Jacobian is explained
by a constant axis and constant offsets, once the joints beyond it are undone; it is peeled off and
the next one is looked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.blocks import FeatureBlocks, feature_blocks
from skin2urdf.estimation.start.peeling import Candidate, Peeled, Readings, candidates
from skin2urdf.notes import Detail, Note
from skin2urdf.signals.records import Features
from skin2urdf.structure.records import KinematicTree

_MARGIN = 2.0
"""Ratio of misfits from which one DoF counts as further out than the next best."""


def ordered(tree: KinematicTree, features: Features) -> KinematicTree:
    """The tree with the DoFs of every multi-DoF joint in the order the features show.

    Args:
        tree: a tree whose activity matrix is right.
        features: the measurements.
    """
    groups = list(_groups(tree))
    if not groups:
        return tree
    blocks = feature_blocks(features, tree)
    order = list(range(tree.n_joints))
    notes: list[Note] = []
    for group in sorted(groups, key=lambda g: -len(tree.chain(g[-1]))):
        found, margin = _order(tree, blocks, group, order)
        names = tuple(tree.joint_names[j] for j in found)
        for place, joint in zip(group, found, strict=True):
            order[place] = joint
        detail: Detail = "" if margin > _MARGIN else "weak"
        notes.append(Note("order from motion", joints=names, detail=detail))
    return replace(
        tree,
        joint_names=tuple(tree.joint_names[j] for j in order),
        joint_types=tuple(tree.joint_types[j] for j in order),
        notes=(*tree.notes, *notes),
    )


def _groups(tree: KinematicTree) -> Iterator[list[int]]:
    """Runs of joints with nothing but each other between them, from the RS outwards."""
    children = [np.flatnonzero(tree.parent == j) for j in range(tree.n_joints)]
    carries = {int(j) for j in tree.su_joint}
    for j in range(tree.n_joints):
        p = int(tree.parent[j])
        if p >= 0 and p not in carries and len(children[p]) == 1:
            continue
        run = [j]
        while run[-1] not in carries and len(children[run[-1]]) == 1:
            run.append(int(children[run[-1]][0]))
        if len(run) > 1:
            yield run


def _order(
    tree: KinematicTree, blocks: FeatureBlocks, group: list[int], order: list[int]
) -> tuple[list[int], float]:
    """Joints of a group from the RS outwards, and the smallest margin of any choice."""
    su = _nearest_su(tree, group[-1])
    columns = list(tree.chain(int(tree.su_joint[su])))
    outer = [j for j in columns if j not in group and group[-1] in tree.chain(j)]
    readings = Readings.of(blocks, su)
    peeled = Peeled.nothing(len(readings.q))

    def fit(joint: int) -> Candidate:
        slides = bool(tree.prismatic[joint])
        return candidates(readings, columns.index(joint), peeled, slides=slides)[0]

    def beyond(joint: int, axis: F64) -> Peeled:
        slides = bool(tree.prismatic[joint])
        return peeled.beyond(axis, readings.q[:, columns.index(joint)], slides=slides)

    for place in reversed(outer):
        peeled = beyond(order[place], fit(order[place]).axis)
    left, margin = list(group), np.inf
    found: list[int] = []
    while left:
        fits = {j: fit(j) for j in left}
        ranked = sorted(left, key=lambda j: fits[j].per_freedom)
        best = ranked[0]
        if len(ranked) > 1:
            second = fits[ranked[1]].per_freedom
            margin = min(margin, second / max(fits[best].per_freedom, 1e-12))
        peeled = beyond(best, fits[best].axis)
        found.insert(0, best)
        left.remove(best)
    return found, margin


def _nearest_su(tree: KinematicTree, joint: int) -> int:
    """The SU beyond a joint with the fewest joints in between."""
    beyond = [u for u, j in enumerate(tree.su_joint) if joint in tree.chain(int(j))]
    return min(beyond, key=lambda u: len(tree.chain(int(tree.su_joint[u]))))
