"""Closed-form start, inwards: peel one joint after the other off an SU's chain.

In the SU's own frame the axis of the last joint is the same in every pose: ``tau_n`` and ``s_n``
are perpendicular to it and ``s_n = f0 x k``. Undoing that joint's known rotation in every pose
makes the next axis constant in turn, down to the base. Needs measured slopes s, and nothing but
one SU at the tip of each limb.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.blocks import FeatureBlocks
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.start.orientation import Orientations, with_all_sus
from skin2urdf.estimation.start.peeling import Peeled, Readings, candidates
from skin2urdf.geometry.so3 import frame_with_z, wahba
from skin2urdf.structure.records import KinematicTree

_MOST_HYPOTHESES = 8


@dataclass(frozen=True, eq=False)
class _Limb:
    """What one SU shows of its chain, in its frame at position zero.

    Attributes:
        axes: (n, 3) axes.
        up: (G, 3) unit vectors opposite to gravity; NaN for logs in which it was not heard.
        misfit: chi-squared that speaks against it.
    """

    axes: F64
    up: F64
    misfit: float


def inward_starts(
    tree: KinematicTree, blocks: FeatureBlocks, priors: Priors
) -> Iterator[Orientations]:
    """Starts from the outermost SU of every limb; several where an axis' sense is open.

    Limbs that share joints are turned onto each other by the shared axes and gravity; limbs
    that share none keep an arbitrary relative yaw, which nothing in the data determines.
    """
    tips = _tips(tree, blocks)
    combinations: list[list[_Limb]] = [[]]
    for su in tips:
        both = [[*c, limb] for c in combinations for limb in _peel(tree, blocks, su)]
        both.sort(key=lambda limbs: sum(limb.misfit for limb in limbs))
        combinations = both[:_MOST_HYPOTHESES]
    for combination in combinations:
        axes = np.full((tree.n_joints, 3), np.nan)
        up = np.zeros((int(blocks.log.max(initial=0)) + 1, 3))
        up[:] = np.nan
        for su, limb in zip(tips, combination, strict=True):
            k, h = limb.axes, limb.up
            chain = list(tree.chain(int(tree.su_joint[su])))
            R = _onto_base(axes[chain], k, up, h)
            new = np.isnan(axes[chain]).any(axis=1)
            axes[np.array(chain)[new]] = k[new] @ R.T
            up = np.where(np.isnan(up), h @ R.T, up)
        axes = np.where(np.isnan(axes), (0.0, 0.0, 1.0), axes)
        up = np.where(np.isnan(up), (0.0, 0.0, 1.0), up)
        # The limb that came first need not be in the first log, whose up is z.
        R = frame_with_z(up[0]).T
        axes, up = axes @ R.T, up @ R.T
        yield with_all_sus(tree, blocks, axes, up, priors)


def _tips(tree: KinematicTree, blocks: FeatureBlocks) -> list[int]:
    """SUs whose chains together cover every joint, longest chains and best data first."""
    data = np.isfinite(blocks.noise).all(axis=-1).sum(axis=0)
    order = sorted(range(tree.n_sus), key=lambda u: (-int(blocks.chains.length[u]), -int(data[u])))
    covered: set[int] = set()
    tips = []
    for u in order:
        chain = set(tree.chain(int(tree.su_joint[u])))
        if not chain <= covered:
            tips.append(u)
            covered |= chain
    return tips


def _onto_base(known: F64, k: F64, up: F64, h: F64) -> F64:
    """R_base_tip that turns a limb's axes k and ups h onto what is already in the base frame."""
    shared = np.isfinite(known).all(axis=1)
    logs = np.isfinite(up).all(axis=1) & np.isfinite(h).all(axis=1)
    reference = np.concatenate([known[shared], up[logs]])
    body = np.concatenate([k[shared], h[logs]])
    if not len(body):
        heard = h[np.isfinite(h).all(axis=1)]
        return np.asarray(frame_with_z(heard[0]).T) if len(heard) else np.eye(3)
    if len(body) < 2:
        return np.asarray(frame_with_z(reference[0]) @ frame_with_z(body[0]).T)
    R, _ = wahba(body, reference, np.ones(len(body)))
    return R


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """Axes (n, 3) of the joints peeled off so far, the last one first, and what speaks against."""

    peeled: Peeled
    axes: tuple[F64, ...]
    misfit: float


def _peel(tree: KinematicTree, blocks: FeatureBlocks, su: int) -> list[_Limb]:
    """Axes and up vectors as an SU shows them, the most constant ones first.

    Which sense of an axis is right shows further in: undone in the wrong one, a joint leaves the
    axes before it, or their lever arms, moving.
    """
    chain = list(tree.chain(int(tree.su_joint[su])))
    readings = Readings.of(blocks, su)
    beam = [_Hypothesis(Peeled.nothing(len(readings.q)), (), 0.0)]
    for i in reversed(range(len(chain))):
        slides = bool(tree.prismatic[chain[i]])
        extended = [
            _Hypothesis(
                h.peeled.beyond(c.axis, readings.q[:, i], slides=slides),
                (*h.axes, c.axis),
                h.misfit + c.misfit,
            )
            for h in beam
            for c in candidates(readings, i, h.peeled, slides=slides)
        ]
        beam = sorted(extended, key=lambda h: h.misfit)[:_MOST_HYPOTHESES]
    log = blocks.log[np.isfinite(blocks.noise[:, su]).all(axis=1)]
    limbs = []
    for h in beam:
        f0 = (h.peeled.R @ readings.f0[..., None])[..., 0]
        up = np.full((int(blocks.log.max(initial=0)) + 1, 3), np.nan)
        for g in np.unique(log):
            mean = f0[log == g].mean(axis=0)
            up[g] = mean / np.linalg.norm(mean)
        limbs.append(_Limb(np.array(h.axes[::-1]).reshape(-1, 3), up, h.misfit))
    return limbs
