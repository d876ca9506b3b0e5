"""Merging SUs to segments and DoFs to joints (paper II-B.2; Algorithm 1, lines 4 and 5)."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.paper.exploration.records import Group


def merge_sus(activity: Bool) -> tuple[tuple[Group, ...], Bool]:
    """Merge identical rows: SUs on the same segment meet the same activity (line 4).

    Args:
        activity: (U, D) activity matrix.

    Returns:
        S groups of SUs in the order of their first SU, and the (S, D) matrix of their rows.
    """
    groups: dict[bytes, list[int]] = {}
    for u, row in enumerate(np.ascontiguousarray(activity, dtype=bool)):
        groups.setdefault(row.tobytes(), []).append(u)
    merged = tuple(tuple(group) for group in groups.values())
    return merged, np.asarray(activity, dtype=bool)[[group[0] for group in merged]]


def merge_dofs(activity: Bool) -> tuple[tuple[Group, ...], Bool]:
    """Merge identical columns: DoFs of the same joint move the same SUs (line 5).

    Args:
        activity: (S, D) activity matrix, of SUs or of segments.

    Returns:
        J groups of DoFs in the order of their first DoF, and the (S, J) matrix of their columns.
    """
    groups, rows = merge_sus(np.asarray(activity, dtype=bool).T)
    return groups, rows.T
