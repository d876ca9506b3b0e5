"""A tree's joints and SUs are found in lists of any order."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from skin2urdf.structure.ordering import Ordering, places_of
from skin2urdf.structure.records import KinematicTree

TREE = KinematicTree(
    ("j0", "j1"), np.array([-1, 0]), ("revolute", "revolute"), ("a", "b"), np.array([0, 1])
)


def test_rows_are_those_of_the_trees_joints() -> None:
    listed = SimpleNamespace(dof_names=("j1", "still", "j0"), su_names=("b", "deaf", "a"))
    order = Ordering.of(TREE, listed)
    assert [listed.dof_names[d] for d in order.dof] == list(TREE.joint_names)
    assert [listed.su_names[u] for u in order.su] == list(TREE.su_names)
    # f0, then s of still-less j0 and j1, then tau of the same, among 1 + 2 * 3 rows.
    np.testing.assert_array_equal(order.rows, [0, 3, 1, 6, 4])


def test_what_is_not_listed_is_named() -> None:
    with pytest.raises(ValueError, match="j1"):
        places_of(TREE.joint_names, ("j0", "j2"))


def test_nothing_has_no_places() -> None:
    assert places_of((), ("a",)).shape == (0,)
