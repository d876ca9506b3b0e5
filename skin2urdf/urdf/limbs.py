"""Alignment of an estimated robot with the true one, limb by limb.

Limbs on one reference segment are connected by nothing but gravity: from one log their yaw and
their position relative to each other can not be known (paper II-C.5; design section 6). So each
limb, all that lies beyond one joint on the reference segment, takes a rigid transform of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.urdf.alignment import align, displace, projector
from skin2urdf.urdf.records import Alignment

Align = Literal["limbs", "base"]
"""One transform per limb, or one for the whole robot."""

ON_BASE = ""
"""Stands for the reference segment where a limb is named by its first joint."""


@dataclass(frozen=True, eq=False)
class Aligned(Record):
    """An estimated robot laid onto the true one.

    Attributes:
        T_base_su: (N, U, 4, 4) estimated SU poses in the true base frame.
        alignments: the transforms, one per limb or one in all.
    """

    T_base_su: F64
    alignments: tuple[Alignment, ...]

    def transform(self, limb: str) -> F64 | None:
        """(4, 4) T_truth_estimate of a limb; None where no SU of it could be aligned."""
        for alignment in self.alignments:
            if alignment.limb in (None, limb):
                return alignment.T_truth_estimate
        return None


def anchors_of(limbs: Sequence[str], trust: Int, moved: Bool) -> Bool:
    """(U,) the SUs that limbs are aligned by.

    A limb is aligned by its SUs of the highest trust: one that is hardly determined would else turn
    the frame in which all others are compared. Where an open direction moves none of these, the
    best that it moves join them. Where open directions move all of these, the best that none moves
    join them, since it is relative to those that all is open.

    Args:
        limbs: U names of limbs.
        trust: (U,) the higher, the more an SU is to be trusted.
        moved: (K, U) the SUs that each open direction moves.
    """
    anchors = np.zeros(len(limbs), dtype=bool)
    for limb in set(limbs):
        members = np.array([each == limb for each in limbs])
        on = members & (trust == trust[members].max())
        for mine in moved & members:
            if mine.any() and not (mine & on).any():
                on |= mine & (trust == trust[mine].max())
        still = members & ~moved.any(axis=0)
        if still.any() and not (still & on).any():
            on |= still & (trust == trust[still].max())
        anchors |= on
    return anchors


def align_robot(
    T_est_su: F64,
    T_true_su: F64,
    names: Sequence[str],
    limbs: Sequence[str],
    free: Sequence[F64],
    *,
    anchors: Bool,
    how: Align,
) -> Aligned:
    """Lay an estimated robot onto the true one.

    An SU on the reference segment is laid onto the truth by the transform of the limb with the
    most such SUs, the leading one (of equals the last by name). Its position and its yaw must be
    among its free directions.

    Args:
        T_est_su: (N, U, 4, 4) SU poses in the estimate's base frame, z up.
        T_true_su: (N, U, 4, 4) the same SUs in the true base frame.
        names: U names.
        limbs: U names of the first joint before each SU, or :data:`ON_BASE`; at least one joint.
        free: U arrays (k, 6) of directions, see :func:`skin2urdf.urdf.alignment.align`.
        anchors: (U,) SUs to align by, see :func:`anchors_of`.
        how: one transform per limb, or one for the whole robot.
    """
    T_aligned = np.empty_like(T_est_su)

    def fit(limb: str | None, rows: list[int]) -> Alignment:
        on = anchors[rows]
        X, D = align(T_est_su[:, rows], T_true_su[:, rows], [free[u] for u in rows], on)
        T_aligned[:, rows] = X @ T_est_su[:, rows] @ D
        carried = [names[u] for u in rows]
        by = tuple(name for name, holds in zip(carried, on, strict=True) if holds)
        return Alignment(limb, tuple(carried), by, X)

    if how == "base":
        return Aligned(T_aligned, (fit(None, list(range(len(names)))),))
    members = {limb: [u for u, each in enumerate(limbs) if each == limb] for limb in limbs}
    rest = members.pop(ON_BASE, [])
    found = tuple(fit(limb, rows) for limb, rows in members.items())
    if rest:
        leading = max(found, key=lambda each: (len(each.anchors), each.limb))
        T = leading.T_truth_estimate @ T_est_su[:, rest]
        P = np.stack([projector(free[u]) for u in rest])
        T_aligned[:, rest] = T @ displace(T, T_true_su[:, rest], P)
    return Aligned(T_aligned, found)
