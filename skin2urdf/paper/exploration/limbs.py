"""Connection sequences, end effectors and limbs (paper II-B.4; Algorithm 1, lines 6, 8 and 9)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import Bool, Int
from skin2urdf.paper.exploration.records import Limb


def connection_sequences(triangular: Bool) -> tuple[tuple[int, ...], ...]:
    """Joints from the RS to each segment, read from the row vectors (line 6).

    Args:
        triangular: (N + 1, N) strictly lower triangular activity matrix.

    Returns:
        For each of the N + 1 segments its joints, from the RS outwards.
    """
    return tuple(tuple(int(n) for n in np.flatnonzero(row)) for row in triangular)


def end_effectors(connectivity: Int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Segments at which limbs end (line 8).

    Args:
        connectivity: (N, 2) segments that each joint connects; segment 0 is the RS.

    Returns:
        "True" end effectors, which connect to exactly one joint (the leaves), and "false" ones,
        which connect to more than two and can be the reference of sub-limbs. The RS is neither.
    """
    joints_at = np.bincount(connectivity.ravel(), minlength=len(connectivity) + 1)
    joints_at[0] = 0
    true = tuple(int(s) for s in np.flatnonzero(joints_at == 1))
    false = tuple(int(s) for s in np.flatnonzero(joints_at > 2))
    return true, false


def limbs(
    connectivity: Int, reference: int, true: Sequence[int], false: Sequence[int]
) -> tuple[Limb, ...]:
    """Serial sequences from a reference segment to end effectors (line 9).

    Args:
        connectivity: (N, 2) segments that each joint connects, RS side first.
        reference: 0 for the RS, or a false end effector whose sub-limbs are asked for.
        true: the true end effectors.
        false: the false end effectors.

    Returns:
        From the RS, one limb for every end effector, in the order of the segments. From a false
        end effector, one for every end effector next to it (not for those beyond the next).
    """
    ends = set(true) | set(false)
    found = []
    for end in sorted(ends - {reference}):
        segments, joints = [end], []
        while segments[-1] != 0 and segments[-1] != reference:
            joint = segments[-1] - 1
            joints.append(joint)
            segments.append(int(connectivity[joint, 0]))
        passes = reference != 0 and bool(ends & set(segments[1:-1]))
        if segments[-1] == reference and not passes:
            found.append(Limb(tuple(segments[::-1]), tuple(joints[::-1]), end in true))
    return tuple(found)
