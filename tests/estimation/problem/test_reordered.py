"""Two orders of neighbouring joints that move SUs alike along an L, and otherwise elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.reordered import apart, elsewhere, reordered
from skin2urdf.estimation.problem.state import State
from skin2urdf.geometry.se3 import exp
from skin2urdf.structure.ordering import bare_neighbours
from skin2urdf.structure.records import JointType, KinematicTree


def robot(kinds: tuple[JointType, JointType], seed: int) -> tuple[KinematicTree, State]:
    """A chain of four joints, of which no SU sits between the second two."""
    rng = np.random.default_rng(seed)
    types: tuple[JointType, ...] = ("revolute", *kinds, "revolute")
    tree = KinematicTree(
        ("a", "b", "c", "d"), np.arange(-1, 3), types, ("one", "two", "tip"), np.array([0, 2, 3])
    )
    placed = exp(rng.uniform(-1.0, 1.0, (7, 6)))
    return tree, State(
        placed[:4], placed[4:], np.array([[0.0, 0.0, 1.0]]), np.zeros((3, 3)), np.zeros((3, 6))
    )


def along_an_l(n: int) -> tuple[F64, F64]:
    """(N, 4) positions, of which the second joint moves before the third, and speeds."""
    share = np.linspace(0.0, 1.0, n)
    q, qd = np.zeros((2 * n, 4)), np.zeros((2 * n, 4))
    q[:, 0] = q[:, 3] = np.linspace(-1.0, 1.0, 2 * n)
    q[:, 2] = 0.3
    q[:n, 1], q[n:, 1] = 0.9 * share, 0.9
    q[n:, 2] = 0.3 - 1.1 * share
    qd[:n, 1], qd[n:, 2] = 0.9, -1.1
    return q, qd


def by_joint(tree: KinematicTree, q: F64) -> dict[str, F64]:
    """Positions (N, D) by the names of joints."""
    return dict(zip(tree.joint_names, q.T, strict=True))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    "kinds", [("revolute", "revolute"), ("prismatic", "revolute"), ("revolute", "prismatic")]
)
def test_the_other_order_carries_sus_alike_where_joints_moved_in_turn(
    kinds: tuple[JointType, JointType], seed: int
) -> None:
    tree, state = robot(kinds, seed)
    q, qd = along_an_l(30)
    assert bare_neighbours(tree.parent, tree.su_joint) == [2]
    other = reordered(tree, state, 2, q, qd**2)
    assert other[0].joint_names == ("a", "c", "b", "d")
    assert other[0].joint_types == ("revolute", *kinds[::-1], "revolute")
    assert max(apart((tree, state), other, by_joint(tree, q))) < 1e-12
    assert elsewhere((tree, state), other, by_joint(tree, q)) > 0.01


def test_two_that_slide_may_follow_each_other_either_way() -> None:
    tree, state = robot(("prismatic", "prismatic"), 3)
    q, qd = along_an_l(30)
    other = reordered(tree, state, 2, q, qd**2)
    assert elsewhere((tree, state), other, by_joint(tree, q)) < 1e-12


def test_the_other_order_is_another_robot_where_joints_moved_together() -> None:
    tree, state = robot(("revolute", "revolute"), 4)
    q = np.random.default_rng(4).uniform(-1.0, 1.0, (50, 4))
    other = reordered(tree, state, 2, q, np.ones_like(q))
    assert apart((tree, state), other, by_joint(tree, q))[1] > 0.1


def test_a_joint_that_one_robot_lacks_moves_the_sus_of_the_other_alone() -> None:
    tree, state = robot(("revolute", "revolute"), 5)
    without = KinematicTree(
        ("a", "b", "c"), np.arange(-1, 2), tree.joint_types[:3], tree.su_names, np.array([0, 2, 2])
    )
    fewer = replace(state, T_parent_joint=state.T_parent_joint[:3])
    q = by_joint(tree, np.random.default_rng(5).uniform(-1.0, 1.0, (50, 4)))
    assert elsewhere((tree, state), (without, fewer), q) > 0.01
    still = {**q, "d": np.zeros(1)}
    T = state.T_joint_su.copy()
    T[2] = state.T_parent_joint[3] @ T[2]
    assert elsewhere((without, replace(fewer, T_joint_su=T)), (tree, state), still) < 1e-12
