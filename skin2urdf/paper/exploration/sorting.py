"""Sorting to the strictly lower triangular form, and what it shows (paper II-B.3)."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import Bool, Int
from skin2urdf.paper.exploration.records import TriangularForm


def sorted_order(merged: Bool) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Order of rows and columns that brings a merged matrix to its strictly lower triangular form.

    A joint carries what it moves, so a joint comes before all joints whose columns its own
    contains; limbs stay together (depth first), otherwise the order of the input is kept. Null
    columns, which carry nothing, come last. Of a matrix that no tree has, the order makes the
    nearest thing to a triangle.

    Args:
        merged: (S, J) merged activity matrix without identical rows or columns.

    Returns:
        S row indices and J column indices, in sorted order.
    """
    sizes = merged.sum(axis=0)
    children: dict[int, list[int]] = {}
    for j in (int(j) for j in np.flatnonzero(sizes)):
        around = [
            int(k)
            for k in np.flatnonzero(sizes > sizes[j])
            if bool((merged[:, k] | ~merged[:, j]).all())
        ]
        parent = min(around, key=lambda k: sizes[k]) if around else -1
        children.setdefault(parent, []).append(j)
    columns: list[int] = []
    waiting = children.get(-1, [])[::-1]
    while waiting:
        columns.append(waiting.pop())
        waiting += children.get(columns[-1], [])[::-1]
    columns += [int(j) for j in np.flatnonzero(sizes == 0)]
    place = np.argsort(columns)
    # Sequences of joints from the RS outwards, in alphabetical order, walk the tree depth first.
    sequences = [sorted(int(p) for p in place[np.flatnonzero(row)]) for row in merged]
    rows = sorted(range(len(merged)), key=lambda s: sequences[s])
    return tuple(rows), tuple(columns)


def triangular_form(matrix: Bool) -> TriangularForm:
    """Check a sorted matrix: dimensions, strictly lower triangle, secondary diagonal.

    Args:
        matrix: (S, J) merged and sorted activity matrix.
    """
    n_segments, n_joints = matrix.shape
    dimensions = n_segments == n_joints + 1
    return TriangularForm(
        dimensions=dimensions,
        strictly_lower=not bool(np.triu(matrix).any()),
        secondary_diagonal=dimensions and bool(np.diagonal(matrix, offset=-1).all()),
    )


def reference_segment(matrix: Bool) -> int | None:
    """Row of the static reference segment, the null row (line 7); None where there is none.

    Args:
        matrix: (S, J) merged activity matrix without identical rows.
    """
    null = np.flatnonzero(~matrix.any(axis=1))
    return int(null[0]) if len(null) else None


def joint_segment_connectivity(triangular: Bool) -> Int:
    """The two segments that each joint connects (paper II-B.3).

    Walks along the secondary diagonal, from low to high indices. The row of the current element
    is identical to that of another segment except for this element: its column is the joint that
    connects the two.

    Args:
        triangular: (N + 1, N) matrix for which `triangular_form` holds.

    Returns:
        (N, 2) segments, the one on the side of the RS first.

    Raises:
        ValueError: no other row is identical to one of the diagonal's but for this element.
    """
    n_joints = triangular.shape[1]
    pairs = np.empty((n_joints, 2), dtype=np.int64)
    for n in range(n_joints):
        row = triangular[n + 1].copy()
        row[n] = False
        matches = np.flatnonzero((triangular == row).all(axis=1))
        if not len(matches):
            raise ValueError(f"no row matches that of segment {n + 1} except for joint {n}")
        pairs[n] = matches[0], n + 1
    return pairs
