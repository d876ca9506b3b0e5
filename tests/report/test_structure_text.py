"""Activity matrix and tree as text and for scripts."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from skin2urdf.errors import StructureError
from skin2urdf.notes import Note
from skin2urdf.paper.exploration import explore
from skin2urdf.report.exploration import as_document, as_text, limbs
from skin2urdf.report.notes import note_words
from skin2urdf.report.plain import dumps
from skin2urdf.structure.activity import Activity
from skin2urdf.structure.records import KinematicTree
from skin2urdf.survey import Explored


def forked() -> Explored:
    """Trunk ``t`` with arms ``a`` and ``b``, a DoF nobody feels, and one SU per segment."""
    sus, dofs = ("s_tip", "s_base", "s_trunk", "s_b"), ("a", "b", "idle", "t")
    static = np.array(
        [
            [9.0, 0.01, 0.01, 8.0],
            [0.01, 0.01, 0.01, 0.02],
            [0.01, 0.01, 0.01, 12.0],
            [0.7, 5.0, 0.01, 9.0],
        ]
    )
    activity = Activity(
        sus,
        dofs,
        static,
        np.zeros((4, 4)),
        np.ones(4),
        np.array([True, True, False, True]),
        np.ones(4, dtype=bool),
    )
    tree = KinematicTree(
        ("t", "a", "b"),
        np.array([-1, 0, 0]),
        ("revolute", "revolute", "prismatic"),
        sus,
        np.array([1, -1, 0, 2]),
    )
    steps = explore(activity.matrix, sus, dofs, excited=activity.excited)
    return Explored(activity, steps, tree, None, (Note("bare base"),))


def test_the_matrix_is_in_the_order_of_the_tree() -> None:
    lines = as_text(forked()).splitlines()
    rows = [line.split() for line in lines[3:7]]
    assert [row[0] for row in rows] == ["s_base", "s_trunk", "s_tip", "s_b"]
    assert rows[0][1:] == ["."] * 4
    active = [[cell != "." and not cell.startswith("0") for cell in row[1:]] for row in rows]
    assert active == [
        [False] * 4,
        [True, False, False, False],
        [True, True, False, False],
        [True, False, True, False],
    ]
    legend = [line.split(maxsplit=2) for line in lines[7:11]]
    assert [entry[1] for entry in legend] == ["t", "a", "b", "idle"]
    assert [len(entry) > 2 for entry in legend] == [False, False, False, True]


def test_what_was_never_recorded_together_has_a_sign_of_its_own() -> None:
    explored = forked()
    static, dynamic = (np.array(explored.activity.static), np.array(explored.activity.dynamic))
    static[0, 1] = dynamic[0, 1] = np.nan
    apart = replace(explored, activity=replace(explored.activity, static=static, dynamic=dynamic))
    before, after = (as_text(one).splitlines()[3:7] for one in (explored, apart))
    assert [row.split().count("-") for row in before] == [0, 0, 0, 0]
    assert [row.split().count("-") for row in after] == [0, 0, 1, 0]
    assert after[2].split()[0] == explored.activity.su_names[0]


def test_the_tree_names_joints_and_what_they_carry() -> None:
    lines = as_text(forked()).splitlines()
    at = next(n for n, line in enumerate(lines) if line.startswith("base "))
    drawn = [line.split() for line in lines[at : at + 4]]
    assert [row[-1] for row in drawn] == ["[s_base]", "[s_trunk]", "[s_tip]", "[s_b]"]
    assert [row[1:3] for row in drawn[1:]] == [
        ["t", "(revolute)"], ["a", "(revolute)"], ["b", "(prismatic)"]
    ]  # fmt: skip
    # What a joint carries is drawn further in.
    depth = [line.index("─") for line in lines[at + 1 : at + 4]]
    assert depth[0] < depth[1] == depth[2]
    assert [line.split()[-3:] for line in lines if line.startswith("limb ")] == [
        ["t", ">", "a"], ["t", ">", "b"]
    ]  # fmt: skip
    (words,) = note_words(forked().notes)
    assert any(line.endswith(words) for line in lines)


def test_limbs_run_from_the_base_to_every_end() -> None:
    tree = forked().tree
    assert tree is not None
    assert limbs(tree) == [(0, 1), (0, 2)]


def test_the_document_says_the_same() -> None:
    document = as_document(forked())
    assert json.loads(dumps(document)) == document
    assert document["limbs"] == [["t", "a"], ["t", "b"]]
    assert document["tree"]["sus"] == {"s_tip": "a", "s_base": None, "s_trunk": "t", "s_b": "b"}
    assert np.array(document["activity"]["matrix"]).sum() == 5
    assert "idle" in [dof for v in document["violations"] for dof in v["dofs"]]


def test_a_contradiction_still_shows_its_matrix() -> None:
    contradiction = replace(forked(), tree=None, contradiction=StructureError("a loop"))
    text = as_text(contradiction)
    assert "s_trunk" in text
    assert "limb" not in text
    assert as_document(contradiction)["contradiction"] == "a loop"
    assert as_document(contradiction)["tree"] is None
