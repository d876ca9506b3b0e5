"""Order of DoFs that the activity matrix can not tell apart: inside joints, across bare segments.

Seen from an SU, the axis of a DoF and its lever arm move only when a DoF between it and the SU
moves. So the outermost of several DoFs is the one whose column of the SU's Jacobian is explained
by a constant axis and constant offsets, once the joints beyond it are undone; it is peeled off and
the next one is looked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.blocks import FeatureBlocks, feature_blocks
from skin2urdf.estimation.inward import constant_axis
from skin2urdf.model.spatial import axis_rotation, skew
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
    notes: list[str] = []
    for group in sorted(groups, key=lambda g: -len(tree.chain(g[-1]))):
        found, margin = _order(tree, blocks, group, order)
        names = " > ".join(tree.joint_names[j] for j in found)
        for place, joint in zip(group, found, strict=True):
            order[place] = joint
        doubt = "" if margin > _MARGIN else "; the log shows the order weakly"
        notes.append(f"no SU sits between {names}: their order follows from the motion{doubt}")
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


@dataclass(frozen=True, eq=False)
class _Peeled:
    """An SU's Jacobian with its outer joints undone.

    Attributes:
        R: (P, 3, 3) turns vectors from the SU's frame to the current segment's, both aligned at
            position zero.
        inner: rotations (P, 3, 3) from each peeled segment to the current one, the SU's first.
    """

    R: F64
    inner: tuple[F64, ...]

    def beyond(self, axis: F64, q: F64) -> _Peeled:
        """One more joint undone, with constant axis (3,) at positions q (P,)."""
        turn = axis_rotation(axis, q)
        identity = np.broadcast_to(np.eye(3), turn.shape)
        return _Peeled(turn @ self.R, (*(turn @ E for E in self.inner), identity))


def _order(
    tree: KinematicTree, blocks: FeatureBlocks, group: list[int], order: list[int]
) -> tuple[list[int], float]:
    """Joints of a group from the RS outwards, and the smallest margin of any choice."""
    su = _nearest_su(tree, group[-1])
    columns = list(tree.chain(int(tree.su_joint[su])))
    outer = [j for j in columns if j not in group and group[-1] in tree.chain(j)]
    ok: Bool = np.asarray(np.isfinite(blocks.noise[:, su]).all(axis=1))
    P = int(ok.sum())
    identity = np.broadcast_to(np.eye(3), (P, 3, 3))
    peeled = _Peeled(identity, (identity,))
    reading = _Reading(tree, blocks, su, ok, columns)
    for place in reversed(outer):
        joint = order[place]
        axis, _ = reading.fit(joint, peeled)
        peeled = peeled if tree.prismatic[joint] else peeled.beyond(axis, reading.q(joint))
    left, margin = list(group), np.inf
    found: list[int] = []
    while left:
        fits = {j: reading.fit(j, peeled) for j in left}
        ranked = sorted(left, key=lambda j: fits[j][1])
        best = ranked[0]
        if len(ranked) > 1:
            margin = min(margin, fits[ranked[1]][1] / max(fits[best][1], 1e-12))
        if not tree.prismatic[best]:
            peeled = peeled.beyond(fits[best][0], reading.q(best))
        found.insert(0, best)
        left.remove(best)
    return found, margin


def _nearest_su(tree: KinematicTree, joint: int) -> int:
    """The SU beyond a joint with the fewest joints in between."""
    beyond = [u for u, j in enumerate(tree.su_joint) if joint in tree.chain(int(j))]
    return min(beyond, key=lambda u: len(tree.chain(int(tree.su_joint[u]))))


@dataclass(frozen=True, eq=False)
class _Reading:
    """One SU's features, by joint of the tree."""

    tree: KinematicTree
    blocks: FeatureBlocks
    su: int
    ok: Bool
    columns: list[int]

    def q(self, joint: int) -> F64:
        """(P,) positions of a joint."""
        return np.asarray(self.blocks.q[self.ok, joint])

    def fit(self, joint: int, peeled: _Peeled) -> tuple[F64, float]:
        """Constant axis of a joint in the current frame, and how badly it fits.

        The misfit is chi-squared per degree of freedom of ``s = f0 x k`` and of ``tau = k x r``,
        with r a sum of constant offsets in the peeled segments' frames.
        """
        blocks, i = self.blocks, self.columns.index(joint)
        L = blocks.chains.joint.shape[1]
        noise2 = (blocks.noise[self.ok, self.su] ** 2).mean(axis=1)
        y = blocks.coefficients[self.ok, self.su]
        variance = blocks.variance[self.ok, self.su] * noise2[:, None]
        f0, s, tau = ((peeled.R @ y[:, r, :, None])[..., 0] for r in (0, 1 + i, 1 + L + i))
        var_s, var_tau = variance[:, 1 + i], variance[:, 1 + L + i]
        seen = np.isfinite(var_tau)
        if not seen.any():
            return np.array([0.0, 0.0, 1.0]), np.inf
        w = np.where(seen, 1 / np.sqrt(np.where(seen, var_tau, 1.0) + 1e-8), 0.0)
        if self.tree.prismatic[joint]:
            k = (tau * w[:, None] ** 2).sum(axis=0)
            k = k / np.linalg.norm(k)
            misfit = float((((tau - k) * w[:, None]) ** 2).sum())
            return k, misfit / max(1, 3 * int(seen.sum()) - 2)
        k = constant_axis(f0, s, tau, var_s, var_tau)[0]
        across = np.concatenate([skew(k) @ E for E in peeled.inner], axis=2) * w[:, None, None]
        A, b = across.reshape(-1, across.shape[2]), (tau * w[:, None]).reshape(-1)
        offsets, _, rank, _ = np.linalg.lstsq(A, b, rcond=1e-6)
        misfit = float(np.sum((A @ offsets - b) ** 2))
        both = np.isfinite(var_s)
        ws = np.where(both, 1 / np.sqrt(np.where(both, var_s, 1.0) + 1e-4), 0.0)
        misfit += float(np.sum(((s @ k) * ws) ** 2))
        freedom = 3 * int(seen.sum()) + int(both.sum()) - int(rank) - 2
        return k, misfit / max(1, freedom)
