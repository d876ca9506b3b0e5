from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skin2urdf.arrays import Bool
from skin2urdf.errors import StructureError, UsageError
from skin2urdf.paper.exploration import (
    Exploration,
    connection_sequences,
    end_effectors,
    explore,
    joint_segment_connectivity,
    limbs,
    merge_dofs,
    merge_sus,
    or_combination,
    reference_segment,
    require_tree,
    sorted_order,
    static_activity,
    triangular_form,
)
from skin2urdf.signals.records import StaticMoves

G = 9.81


@dataclass(frozen=True)
class Tree:
    """A known tree: joint n hangs on segment ``parent[n]`` and carries segment n + 1."""

    parent: tuple[int, ...]
    dofs: tuple[int, ...]  # the joint of each DoF, in the order of the log
    sus: tuple[int, ...]  # the segment of each SU, in the order of the log

    def path(self, segment: int) -> list[int]:
        """Joints from the RS to a segment."""
        joints: list[int] = []
        while segment:
            joints.insert(0, segment - 1)
            segment = self.parent[segment - 1]
        return joints

    def activity(self) -> Bool:
        """(U, D) activity matrix."""
        return np.array([[j in self.path(s) for j in self.dofs] for s in self.sus])


@st.composite
def trees(draw: st.DrawFn) -> Tree:
    """Trees of up to 12 joints with 1 to 3 DoFs each, and 1 to 3 SUs on every segment."""
    n = draw(st.integers(1, 12))
    parent = tuple(draw(st.integers(0, j)) for j in range(n))
    dofs = [j for j in range(n) for _ in range(draw(st.integers(1, 3)))]
    sus = [s for s in range(n + 1) for _ in range(draw(st.integers(1, 3)))]
    return Tree(parent, tuple(draw(st.permutations(dofs))), tuple(draw(st.permutations(sus))))


def explored(activity: Bool, **flags: Bool) -> Exploration:
    U, D = activity.shape
    return explore(activity, [f"su{u}" for u in range(U)], [f"d{d}" for d in range(D)], **flags)


def matrix(rows: str) -> Bool:
    """``"-,A,AB"``: three SUs; the second moves with DoF A, the third with A and B."""
    cells = rows.split(",")
    D = max(ord(c) - 64 for row in cells for c in row if c != "-")
    return np.array([[chr(65 + d) in row for d in range(D)] for row in cells])


@given(trees())
@settings(deadline=None)
def test_any_tree_is_recovered_exactly(tree: Tree) -> None:
    found = explored(tree.activity())
    assert not found.violations
    assert found.form.holds
    true_of = {}  # segment found -> segment of the tree, by the SUs it carries
    for s, sus in enumerate(found.segments):
        (true_of[s],) = {tree.sus[u] for u in sus}
        assert len(sus) == tree.sus.count(true_of[s])
    assert true_of[0] == 0
    assert len(true_of) == len(tree.parent) + 1
    for n, dofs in enumerate(found.joints):
        (joint,) = {tree.dofs[d] for d in dofs}
        assert len(dofs) == tree.dofs.count(joint)
        inner, outer = found.connectivity[n]
        assert (true_of[inner], true_of[outer]) == (tree.parent[joint], joint + 1)
        assert outer == n + 1


@given(trees())
@settings(deadline=None)
def test_limbs_run_from_the_reference_to_every_end_effector(tree: Tree) -> None:
    found = explored(tree.activity())
    degree = np.bincount([*tree.parent, *range(1, len(tree.parent) + 1)])
    degree[0] = 0
    assert len(found.true_end_effectors) == np.sum(degree == 1)
    assert len(found.false_end_effectors) == np.sum(degree > 2)
    ends = {*found.true_end_effectors, *found.false_end_effectors}
    assert {limb.end_effector for limb in found.limbs} == ends
    for limb in (*found.limbs, *found.sub_limbs):
        assert limb.is_true == (limb.end_effector in found.true_end_effectors)
        assert len(limb.segments) == len(limb.joints) + 1
        for k, n in enumerate(limb.joints):
            assert tuple(found.connectivity[n]) == limb.segments[k : k + 2]
    assert all(limb.reference == 0 for limb in found.limbs)
    assert all(limb.reference in found.false_end_effectors for limb in found.sub_limbs)
    # Each end effector beyond a false one is reached from the nearest of those.
    assert not any(set(limb.segments[1:-1]) & ends for limb in found.sub_limbs)
    beyond = [x for x in ends if any(set(c.segments[:-1]) & ends for c in found.limbs
                                     if c.end_effector == x)]  # fmt: skip
    assert sorted(limb.end_effector for limb in found.sub_limbs) == sorted(beyond)


@given(trees())
@settings(deadline=None)
def test_the_steps_of_algorithm_1_agree_with_the_whole(tree: Tree) -> None:
    activity = tree.activity()
    found = explored(activity)
    sus, by_segment = merge_sus(activity)
    dofs, merged = merge_dofs(by_segment)
    assert (sus, dofs) == (found.merged_sus, found.merged_dofs)
    np.testing.assert_array_equal(merged, found.merged)
    # Merging columns first makes no difference.
    np.testing.assert_array_equal(merge_sus(merge_dofs(activity)[1])[1], merged)
    rows, columns = sorted_order(merged)
    triangular = merged[np.ix_(rows, columns)]
    np.testing.assert_array_equal(triangular, found.triangular)
    assert triangular_form(triangular).holds
    assert reference_segment(triangular) == 0
    assert connection_sequences(triangular) == found.sequences
    connectivity = joint_segment_connectivity(triangular)
    np.testing.assert_array_equal(connectivity, found.connectivity)
    true, false = end_effectors(connectivity)
    assert limbs(connectivity, 0, true, false) == found.limbs


def test_the_arm_of_figure_5() -> None:
    order = np.array([4, 0, 7, 2, 6, 1, 5, 3])
    arm = np.tri(8, 7, -1, dtype=bool)
    found = explored(arm[order])
    np.testing.assert_array_equal(found.triangular, arm)
    assert found.segments == tuple((int(u),) for u in np.argsort(order))
    assert found.connectivity.tolist() == [[n, n + 1] for n in range(7)]
    (limb,) = found.limbs
    assert limb.segments == tuple(range(8))
    assert found.dofs_of(limb) == tuple(f"d{d}" for d in range(7))
    assert found.sus_of(limb)[0] == "su1"
    assert found.true_end_effectors == (7,)
    assert not found.false_end_effectors
    assert not found.violations


def test_a_palm_is_a_false_end_effector() -> None:
    found = explored(matrix("-,A,AB,ABC,ABD,ABDE,F"))
    assert found.false_end_effectors == (2,)
    assert [limb.segments for limb in found.limbs] == [
        (0, 1, 2), (0, 1, 2, 3), (0, 1, 2, 4, 5), (0, 6),
    ]  # fmt: skip
    assert [limb.is_true for limb in found.limbs] == [False, True, True, True]
    assert [limb.segments for limb in found.sub_limbs] == [(2, 3), (2, 4, 5)]


def test_limbs_stay_together_and_keep_the_order_of_the_log() -> None:
    found = explored(matrix("-,B,A,BD,AC"))
    assert found.joints == ((0,), (2,), (1,), (3,))


@pytest.mark.parametrize(
    ("rows", "kind", "sus", "dofs"),
    [
        ("A,AB,ABC", "no static segment", ("su0", "su1", "su2"), ("d0",)),
        ("A,B", "no static segment", ("su0", "su1"), ()),
        ("-,AB,AC", "segment without SU", (), ("d0",)),
        ("-,A,B,AB", "closed loop", ("su3",), ("d0", "d1")),
        ("-,A,B,AB,AB,ABC", "closed loop", ("su3", "su4"), ("d0", "d1")),
        ("-,A,B,C,ABC,ABC", "closed loop", ("su4", "su5"), ("d0", "d1", "d2")),
        ("-,A,AB,CB,CBD", "coupled DoFs", ("su3", "su4"), ("d1", "d2")),
        ("-,A,AB,BC,ABCD", "missed reaction", ("su3",), ("d0", "d1")),
        ("-,A,AB,ABC,ABC,ABC,ABC,BC", "missed reaction", ("su7",), ("d0", "d1")),
        ("-,A,A,AB,AB,B,ABC", "missed reaction", ("su5",), ("d0", "d1")),
    ],
)
def test_a_violation_is_recognised(
    rows: str, kind: str, sus: tuple[str, ...], dofs: tuple[str, ...]
) -> None:
    (violation,) = explored(matrix(rows)).violations
    assert (violation.kind, violation.sus, violation.dofs) == (kind, sus, dofs)
    assert violation.words.startswith(kind)
    assert violation.remedy


def test_missing_rows_break_the_form_but_not_the_tree() -> None:
    found = explored(matrix("AB,AC,D"))
    assert {v.kind for v in found.violations} == {"no static segment", "segment without SU"}
    assert not found.form.dimensions
    assert not found.form.holds
    assert found.is_tree
    assert found.segments == ((), (), (0,), (1,), (2,))
    assert found.false_end_effectors == (1,)
    assert require_tree(found) is found


def test_a_dof_without_reaction_is_no_joint() -> None:
    activity = np.hstack([matrix("-,A,AB"), np.zeros((3, 2), dtype=bool)])
    found = explored(activity, excited=np.array([True, True, True, False]))
    assert [(v.kind, v.dofs) for v in found.violations] == [
        ("end effector without SU", ("d2",)), ("DoF without motion", ("d3",)),
    ]  # fmt: skip
    assert found.joints == ((0,), (1,))
    assert not found.form.holds


def test_sus_without_readings_are_no_reference_segment() -> None:
    found = explored(matrix("-,A,-,AB"), heard=np.array([True, True, False, True]))
    assert found.segments == ((0,), (1,), (3,))
    (violation,) = found.violations
    assert (violation.kind, violation.sus) == ("SU without readings", ("su2",))


def test_a_crossing_matrix_has_no_tree_and_is_refused_with_its_names() -> None:
    found = explored(matrix("-,A,B,AB"))
    assert not found.is_tree
    assert not found.limbs
    assert found.connectivity.shape == (0, 2)
    with pytest.raises(StructureError) as caught:
        require_tree(found)
    assert caught.value.sus == ("su3",)
    assert caught.value.dofs == ("d0", "d1")


@given(st.integers(0, 2**32 - 1), st.integers(1, 14), st.integers(1, 10), st.floats(0.0, 1.0))
@settings(deadline=None)
def test_any_matrix_at_all_is_explored(seed: int, U: int, D: int, density: float) -> None:
    activity = np.random.default_rng(seed).random((U, D)) < density
    found = explored(activity)
    placed = [u for sus in found.segments for u in sus]
    assert sorted(placed) == list(range(U))
    assert (
        sorted(d for dofs in found.joints for d in dofs)
        == np.flatnonzero(activity.any(axis=0)).tolist()
    )
    if found.is_tree:
        # The tree reproduces the matrix that it was read from.
        of_dof = {d: n for n, dofs in enumerate(found.joints) for d in dofs}
        for s, sus in enumerate(found.segments):
            active = {d for d in of_dof if of_dof[d] in found.sequences[s]}
            assert all(set(np.flatnonzero(activity[u])) == active for u in sus)
        assert triangular_form(found.triangular).holds
    else:
        assert not found.limbs


def test_a_triangular_form_that_is_no_tree() -> None:
    # Dimensions, triangle and diagonal are right, and yet DoF B moves what hangs on C.
    found = explored(matrix("-,A,AB,BC"))
    assert found.form.holds
    assert not found.is_tree
    with pytest.raises(ValueError):
        joint_segment_connectivity(found.triangular)


def test_or_of_two_orientations_fills_the_vertical_axis() -> None:
    arm = np.tri(4, 3, -1, dtype=bool)
    upright, turned = arm.copy(), arm.copy()
    upright[:, 0] = False
    turned[:, 2] = False
    np.testing.assert_array_equal(or_combination([upright, turned]), arm)
    kinds = [v.kind for v in explored(upright).violations]
    assert kinds == ["end effector without SU"]
    with pytest.raises(UsageError):
        or_combination([arm, arm[:2]])
    with pytest.raises(UsageError):
        or_combination([])


def test_static_activity_thresholds_single_axes() -> None:
    change = np.zeros((3, 2, 3))
    change[0, 0, 1] = -0.051 * G
    change[0, 1] = 0.049 * G  # three axes below the threshold, though together above it
    change[1, 1] = np.nan
    change[2, 1, 0] = 0.06 * G
    moves = StaticMoves(dof=np.array([0, 2, 2]), distance=np.ones(3), change=change)
    active = static_activity(moves, 3)
    np.testing.assert_array_equal(active, [[True, False, False], [False, False, True]])
    assert static_activity(moves, 3, threshold=0.04 * G)[1, 0]


def test_names_must_fit() -> None:
    arm = np.tri(3, 2, -1, dtype=bool)
    with pytest.raises(UsageError, match="2"):
        explore(arm, ["a", "b"], ["x", "y"])
    with pytest.raises(UsageError, match=r"\bb\b"):
        explore(arm, ["a", "b", "b"], ["x", "y"])
    with pytest.raises(StructureError):
        explore(arm, ["a", "b", "c"], ["x", "y"], heard=np.zeros(3, dtype=bool))
