"""The activity matrix by the paper's static test (Algorithm 1, lines 1 to 3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.errors import UsageError
from skin2urdf.signals.records import StaticMoves
from skin2urdf.structure.activity import STATIC_THRESHOLD


def static_activity(moves: StaticMoves, n_dofs: int, threshold: float = STATIC_THRESHOLD) -> Bool:
    """Threshold the static readings before and after one DoF at a time moved (lines 2 and 3).

    An entry is 1 where the mean reading of any of the three axes changed by more than the
    threshold (paper III), and by more than the other joints' small motions can have changed it.
    Several moves of a DoF are combined by OR.

    Args:
        moves: rests before and after single DoFs moved, of U SUs.
        n_dofs: number D of DoFs.
        threshold: change of a reading that counts [m/s^2]; the paper uses 0.05 g.

    Returns:
        (U, D) activity matrix; 0 where no move was recorded.
    """
    n_sus = moves.change.shape[1]
    active = np.zeros((n_sus, n_dofs), dtype=bool)
    least = np.maximum(threshold, moves.doubt)[:, None, None]
    changed = np.any(np.abs(np.nan_to_num(moves.change)) > least, axis=-1)
    for dof, row in zip(moves.dof, changed, strict=True):
        active[:, dof] |= row
    return active


def or_combination(matrices: Sequence[Bool]) -> Bool:
    """Combine activity matrices of the same robot by an element-wise OR (paper II-B.1).

    A DoF with a vertical axis turns no gravity vector. With a second matrix, recorded after the
    static segment was rotated by 90 degrees about a horizontal axis, no entry is falsely 0.

    Args:
        matrices: (U, D) matrices, one for each orientation of the static segment.

    Returns:
        (U, D) activity matrix.

    Raises:
        UsageError: no matrix, or matrices of different shapes.
    """
    if not matrices:
        raise UsageError("no activity matrix to combine", "give at least one")
    shapes = {np.shape(m) for m in matrices}
    if len(shapes) > 1:
        raise UsageError(
            f"activity matrices of different shapes can not be combined: {sorted(shapes)}",
            "use the same SUs and DoFs, in the same order, in all of them",
        )
    return np.asarray(np.any(np.stack(list(matrices)), axis=0), dtype=bool)
