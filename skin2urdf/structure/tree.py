"""From activity to a kinematic tree: merging, nesting, repair of uncertain bits (paper II-B)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.errors import StructureError
from skin2urdf.notes import Detail, Note
from skin2urdf.signals.records import Features
from skin2urdf.structure.activity import CERTAIN, Activity, own_information
from skin2urdf.structure.joint_types import joint_type, pushed_alike
from skin2urdf.structure.records import KinematicTree


def kinematic_tree(activity: Activity, features: Features) -> KinematicTree:
    """The tree whose activity matrix the evidence shows.

    The SUs beyond a DoF form a set; in a tree any two such sets nest or are disjoint, and the
    parent of a DoF is the smallest set that contains its own. DoFs with equal sets form one
    multi-DoF joint, whose order the activity does not show.

    Args:
        activity: evidence for every SU and DoF.
        features: the measurements, for joint types.

    Raises:
        StructureError: no DoF moves any SU, or the evidence contradicts every tree.
    """
    heard: Int = np.flatnonzero(activity.heard).astype(np.int64)
    notes = [
        Note("su left out", (activity.su_names[u],), detail="no readings")
        for u in np.flatnonzero(~activity.heard)
    ]
    own = own_information(features)
    evidence = pushed_alike(features, own, activity)[heard]
    bits, repairs = nested(evidence, [activity.su_names[u] for u in heard], activity.dof_names)
    notes += repairs
    felt = bits.any(axis=0)
    for d in np.flatnonzero(~felt):
        why = _why(activity, heard, int(d))
        notes.append(Note("joint left out", joints=(activity.dof_names[d],), detail=why))
    if not felt.any():
        raise StructureError(
            "no SU is moved by any DoF: every row of the activity matrix is empty",
            "check that the joints moved during the log, and that the SUs sit on moving segments",
        )
    notes += _never_together(activity, heard, bits)
    if bits.any(axis=1).all():
        notes.append(Note("bare base"))
    dofs = sorted(np.flatnonzero(felt), key=lambda d: (-int(bits[:, d].sum()), int(d)))
    parent = _parents(bits[:, dofs])
    su_joint = _carriers(bits[:, dofs], parent)
    types = tuple(
        joint_type(features, own[:, :, d], activity, heard[bits[:, d]], int(d)) for d in dofs
    )
    return KinematicTree(
        tuple(activity.dof_names[d] for d in dofs),
        np.array(parent, dtype=np.int64),
        types,
        tuple(activity.su_names[u] for u in heard),
        np.array(su_joint, dtype=np.int64),
        tuple(notes),
    )


def _why(activity: Activity, heard: Int, dof: int) -> Detail:
    """Why a DoF is in no tree."""
    if not activity.excited[dof]:
        return "never moved"
    tested = activity.tested[heard, dof]
    if not tested.any():
        return "not alone"
    if not np.isfinite(activity.dynamic[heard, dof]).any():
        return "turns no gravity"
    return "felt by none" if tested.all() else "felt by none recorded"


def _never_together(activity: Activity, heard: Int, bits: Bool) -> list[Note]:
    """Notes on SUs that no log holds while some DoF moved, so that nothing ties them to it."""
    open_ = ~activity.tested[heard] & ~bits & bits.any(axis=0)
    groups: dict[bytes, list[int]] = {}
    for d in np.flatnonzero(open_.any(axis=0)):
        groups.setdefault(open_[:, d].tobytes(), []).append(int(d))
    return [
        Note(
            "never together",
            tuple(activity.su_names[u] for u in heard[open_[:, dofs[0]]]),
            tuple(activity.dof_names[d] for d in dofs),
        )
        for dofs in groups.values()
    ]


def nested(
    evidence: F64, su_names: Sequence[str], dof_names: Sequence[str]
) -> tuple[Bool, list[Note]]:
    """Activity bits whose columns nest, with the least certain bits changed where needed.

    Args:
        evidence: (U, D) log-evidence, positive for active.
        su_names: U names, for messages.
        dof_names: D names, for messages.

    Returns:
        (U, D) bits, and a note for every changed one.

    Raises:
        StructureError: a contradiction that rests on certain bits only.
    """
    bits, sure = evidence > 0, np.abs(evidence)
    notes: list[Note] = []
    while True:
        conflict = _cheapest_conflict(bits, sure)
        if conflict is None:
            return bits, notes
        cost, rows, column, d, e = conflict
        if cost > CERTAIN:
            sus = [su_names[u] for u in rows]
            raise StructureError(
                f"the activity of {dof_names[d]} and {dof_names[e]} contradicts a kinematic tree: "
                f"some SUs move with either alone and some with both (least certain: "
                f"{', '.join(sus)})",
                "look for a DoF that moves along with another one (mimic or coupled joints), a "
                "closed kinematic loop, or an SU that touches two segments; record one DoF at a "
                "time from several poses",
                sus=sus,
                dofs=[dof_names[d], dof_names[e]],
            )
        for u in rows:
            bits[u, column] = ~bits[u, column]
            # Once changed for the sake of the rest it stays, or two repairs would undo each other.
            sure[u, column] = np.inf
            taken: Detail = "active" if bits[u, column] else "inactive"
            notes.append(Note("undecided", (su_names[u],), (dof_names[column],), taken))


def _cheapest_conflict(bits: Bool, sure: F64) -> tuple[float, list[int], int, int, int] | None:
    """The crossing pair of columns that is cheapest to mend: cost, rows, column, pair."""
    best: tuple[float, list[int], int, int, int] | None = None
    shared = bits.T.astype(np.int64) @ bits
    own = np.diag(shared)
    crossing = (shared > 0) & (shared < own[:, None]) & (shared < own)
    for d, e in zip(*np.nonzero(np.triu(crossing)), strict=True):
        a, b = bits[:, d], bits[:, e]
        both, only_a, only_b = a & b, a & ~b, b & ~a
        options = ((both, d), (both, e), (only_a, d), (only_a, e), (only_b, d), (only_b, e))
        for rows, column in options:
            cost = float(sure[rows, column].max() + 1e-3 * sure[rows, column].sum())
            if best is None or cost < best[0]:
                best = (cost, [int(u) for u in np.flatnonzero(rows)], int(column), int(d), int(e))
    return best


def _parents(bits: Bool) -> list[int]:
    """Parent of each column among those before it: the smallest set that contains it."""
    parent = []
    for d in range(bits.shape[1]):
        containing = [
            e for e in range(d)
            if bool((bits[:, e] | ~bits[:, d]).all())
        ]  # fmt: skip
        parent.append(containing[-1] if containing else -1)
    return parent


def _carriers(bits: Bool, parent: Sequence[int]) -> list[int]:
    """The last joint before each SU: its active column deepest in the tree."""
    depth: list[int] = []
    for p in parent:
        depth.append(0 if p < 0 else depth[p] + 1)
    out = []
    for row in bits:
        active = np.flatnonzero(row)
        out.append(int(max(active, key=lambda d: depth[d])) if len(active) else -1)
    return out
