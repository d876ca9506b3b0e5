"""The structure of a robot as text: activity matrix, tree and limbs."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from skin2urdf.arrays import Int
from skin2urdf.report.document import activity_document
from skin2urdf.report.notes import note_documents, note_words
from skin2urdf.report.plain import to_plain
from skin2urdf.report.tables import bullets, table
from skin2urdf.structure.activity import Activity
from skin2urdf.structure.ordering import Ordering
from skin2urdf.structure.records import KinematicTree
from skin2urdf.survey import Explored

_MOTION = """\
The log has no patterns around poses: what is looked for is a tree that explains gravity at rest
and the accelerations of the moves."""
_UNCERTAIN = 2.0
"""Evidence within this factor of what it takes is marked as uncertain."""


def as_text(explored: Explored) -> str:
    """Activity matrix in the order of the tree, the tree, its limbs, and notes."""
    seen, tree = explored.activity, explored.tree
    sus, dofs = _order(seen, tree)
    lines = [_MOTION, ""] if explored.from_motion else [*_matrix(seen, sus, dofs), ""]
    # Without patterns a matrix that no tree stands behind tells nothing.
    told = tree is not None or not explored.from_motion
    if tree is not None:
        lines += ["kinematic tree", *_tree(tree), "", *_limbs(tree)]
    violated = [f"{v.words}; {v.remedy}" for v in explored.exploration.violations if told]
    lines += bullets("Not as the structural exploration expects it", violated)
    lines += bullets("Notes", note_words(explored.notes))
    return "\n".join(lines) + "\n"


def as_document(explored: Explored) -> dict[str, Any]:
    """Everything in :func:`as_text` for a script."""
    tree = explored.tree
    joints = tree.joint_names if tree else ()
    document: dict[str, Any] = to_plain(
        {
            "from_motion": explored.from_motion,
            "activity": activity_document(explored.activity),
            "tree": None
            if tree is None
            else {
                "joints": [
                    {"name": name, "parent": joints[p] if p >= 0 else None, "type": kind}
                    for name, p, kind in zip(joints, tree.parent, tree.joint_types, strict=True)
                ],
                "sus": {
                    name: joints[j] if j >= 0 else None
                    for name, j in zip(tree.su_names, tree.su_joint, strict=True)
                },
            },
            "limbs": [[joints[j] for j in limb] for limb in limbs(tree)] if tree else [],
            "violations": [asdict(violation) for violation in explored.exploration.violations],
            "contradiction": str(explored.contradiction) if explored.contradiction else None,
            "notes": note_words(explored.notes),
            "noted": note_documents(explored.notes),
        }
    )
    return document


def limbs(tree: KinematicTree) -> list[tuple[int, ...]]:
    """Serial sequences of joints from the reference segment to every end effector."""
    inner = {int(parent) for parent in tree.parent}
    return [tree.chain(j) for j in range(tree.n_joints) if j not in inner]


def _order(seen: Activity, tree: KinematicTree | None) -> tuple[Int, Int]:
    """Order of SUs and DoFs that brings the matrix near to a triangle."""
    dofs = list(range(len(seen.dof_names)))
    if tree is None:
        columns = np.argsort(-seen.matrix.sum(axis=0), kind="stable")
        return np.argsort(seen.matrix.sum(axis=1), kind="stable"), columns
    inside = Ordering.of(tree, seen).dof.tolist()
    columns = np.array([*inside, *(d for d in dofs if d not in inside)], dtype=np.int64)
    joint = dict(zip(tree.su_names, map(int, tree.su_joint), strict=True))
    last = [joint.get(name, tree.n_joints) for name in seen.su_names]
    return np.argsort(last, kind="stable"), columns


def _matrix(seen: Activity, sus: Int, dofs: Int) -> list[str]:
    """The activity matrix with its evidence."""
    evidence, active, tested = np.exp(seen.evidence), seen.matrix, seen.tested
    rows = [
        (
            seen.su_names[u],
            *(
                _cell(float(evidence[u, d]), bool(active[u, d])) if tested[u, d] else "-"
                for d in dofs
            ),
        )
        for u in sus
    ]
    head = ("SU", *(str(i + 1) for i in range(len(dofs))))
    numbered = [(str(i + 1), seen.dof_names[d], _remark(seen, int(d))) for i, d in enumerate(dofs)]
    width = max((len(name) for _, name, _ in numbered), default=0)
    return [
        "activity: evidence over what it takes; 1 and more is active, . is less, ? is within a "
        f"factor of {_UNCERTAIN:g}, - was never recorded together",
        *table(head, rows, "<" + ">" * len(dofs)),
        *(f"{n:>3}  {name:{width}}  {remark}".rstrip() for n, name, remark in numbered),
    ]


def _cell(evidence: float, active: bool) -> str:
    """One bit with its evidence."""
    doubt = "?" if 1 / _UNCERTAIN < evidence < _UNCERTAIN else ""
    if not active:
        return f"{evidence:.1f}{doubt}" if doubt else "."
    return f"{min(evidence, 999):.{1 if evidence < 9.95 else 0}f}{doubt}"


def _remark(seen: Activity, dof: int) -> str:
    """What is odd about a DoF."""
    if not seen.excited[dof]:
        return "never moves"
    return "" if seen.matrix[:, dof].any() else "moves no SU"


def _tree(tree: KinematicTree) -> list[str]:
    """The tree, one joint per line, with the SUs it carries."""
    lines = [f"base{_carried(tree, -1)}"]

    def grow(parent: int, indent: str) -> None:
        children = [int(j) for j in np.flatnonzero(tree.parent == parent)]
        for j in children:
            last = j == children[-1]
            name, kind = tree.joint_names[j], tree.joint_types[j]
            lines.append(f"{indent}{'└' if last else '├'}─ {name} ({kind}){_carried(tree, j)}")
            # A single chain needs no deeper indent for every joint, a fork does.
            grow(j, indent + ("   " if last else "│  "))

    grow(-1, "")
    return lines


def _carried(tree: KinematicTree, joint: int) -> str:
    """SUs on a segment."""
    names = [tree.su_names[u] for u in np.flatnonzero(tree.su_joint == joint)]
    return f"  [{', '.join(names)}]" if names else "  [no SU]"


def _limbs(tree: KinematicTree) -> list[str]:
    """Limbs, one per line."""
    rows = []
    for i, limb in enumerate(limbs(tree)):
        names = [tree.joint_names[j] for j in limb]
        rows.append(f"limb {i + 1}: {len(names)} DoF: {' > '.join(names)}")
    return rows
