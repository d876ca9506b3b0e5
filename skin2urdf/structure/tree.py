"""From activity to a kinematic tree: merging, nesting, repair of uncertain bits (paper II-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
    # What mends one pair of columns most cheaply may leave another that nothing mends: the last
    # bit that was changed then stays as it was.
    waiting: list[tuple[Bool, F64, list[Note]]] = [(evidence > 0, np.abs(evidence), [])]
    refused: list[_Conflict] = []
    # Where there are more dead ends than DoFs, the bits contradict each other throughout.
    while waiting and len(refused) <= len(dof_names):
        bits, sure, notes = waiting.pop()
        conflict = _conflict(bits, sure)
        if conflict is None:
            return bits, notes
        if conflict.certain:
            refused.append(conflict)
            continue
        u, column = conflict.undecided
        mended, decided = bits.copy(), sure.copy()
        mended[u, column] = ~bits[u, column]
        decided[u, column] = np.inf
        taken: Detail = "active" if mended[u, column] else "inactive"
        note = Note("undecided", (su_names[u],), (dof_names[column],), taken)
        waiting += [(bits, decided, notes), (mended, decided, [*notes, note])]
    (d, e), sus = refused[0].pair, [su_names[u] for u in refused[0].rows]
    raise StructureError(
        f"the activity of {dof_names[d]} and {dof_names[e]} contradicts a kinematic tree: "
        f"some SUs move with either alone and some with both (least certain: {', '.join(sus)})",
        "look for a DoF that moves along with another one (mimic or coupled joints), a closed "
        "kinematic loop, or an SU that touches two segments; record one DoF at a time from several "
        "poses",
        sus=sus,
        dofs=[dof_names[d], dof_names[e]],
    )


@dataclass(frozen=True)
class _Conflict:
    """Two columns that cross, and the cheapest way to mend that.

    Attributes:
        pair: the columns.
        rows: rows of which one bit has to change each.
        undecided: row and column of the most certain of those bits.
        cost: its certainty, then that of all of them together.
    """

    pair: tuple[int, int]
    rows: tuple[int, ...]
    undecided: tuple[int, int]
    cost: tuple[float, float]

    @property
    def certain(self) -> bool:
        """Whether it rests on certain bits alone, so that no other change mends it either."""
        return self.cost[0] > CERTAIN


def _conflict(bits: Bool, sure: F64) -> _Conflict | None:
    """A crossing pair of columns that nothing mends, else the one that is cheapest to mend."""
    shared = bits.T.astype(np.int64) @ bits
    own = np.diag(shared)
    crossing = (shared > 0) & (shared < own[:, None]) & (shared < own)
    found = [
        _cheapest_of(bits, sure, (int(d), int(e)))
        for d, e in zip(*np.nonzero(np.triu(crossing)), strict=True)
    ]
    return min(found, key=lambda c: (not c.certain, c.cost), default=None)


def _cheapest_of(bits: Bool, sure: F64, pair: tuple[int, int]) -> _Conflict:
    """How two columns that cross are mended most cheaply: no row with both, or with one alone."""
    a, b = bits[:, pair].T
    columns = np.array(pair)[sure[:, pair].argmin(axis=1)]
    price = sure[:, pair].min(axis=1)
    ways = []
    for way in (a & b, a & ~b, b & ~a):
        rows = np.flatnonzero(way)
        u = rows[price[rows].argmax()]
        cost = float(price[u]), float(price[rows].sum())
        bit = int(u), int(columns[u])
        ways.append(_Conflict(pair, tuple(int(u) for u in rows), bit, cost))
    return min(ways, key=lambda c: c.cost)


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
