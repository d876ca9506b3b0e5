"""What branches may do unseen is found from rank, and really changes no reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from synthetic import exact_coefficients, random_features, random_state

from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.problem.state import State, identifiable
from skin2urdf.estimation.solve.estimate import Estimate, EstimationSettings, estimate
from skin2urdf.estimation.uncertainty.bounds import moved_sus
from skin2urdf.estimation.uncertainty.observability import Observability, observability
from skin2urdf.geometry.se3 import exp
from skin2urdf.geometry.so3 import axis_rotation
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.records import OpenDirection
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features, StaticMoves
from skin2urdf.structure.records import KinematicTree

PLAIN = EstimationSettings(
    priors=Priors(bias=0.0, scale=0.0, cross=0.0, gravity=GRAVITY), intrinsics=False
)


def tree_of(parent: Sequence[int], prismatic: Sequence[int] = ()) -> KinematicTree:
    """One SU on every segment."""
    D = len(parent)
    return KinematicTree(
        tuple(f"joint{j}" for j in range(D)),
        np.array(parent),
        tuple("prismatic" if j in prismatic else "revolute" for j in range(D)),
        tuple(f"su{j}" for j in range(D)),
        np.arange(D),
    )


FORK = tree_of((-1, 0, 1, 2, 0, 4))
"""Two branches on the first joint: joints 1 to 3, and 4 and 5."""


def robot(
    tree: KinematicTree, tilt: float = 0.6, parallel: Sequence[int] = (), seed: int = 0
) -> State:
    """A random robot: the first axis tilted by so much, some axes parallel to their parents'."""
    state = random_state(np.random.default_rng(seed), tree, intrinsics=0.0)
    joints = state.T_parent_joint.copy()
    joints[0, :3, :3] = axis_rotation(np.array([1.0, 0.0, 0.0]), np.array(tilt))
    joints[0, :3, 3] = 0.0
    joints[list(parallel), :3, :3] = np.eye(3)
    return replace(state, T_parent_joint=joints)


def seen(
    tree: KinematicTree, state: State, setting: EstimationSettings = PLAIN
) -> tuple[Estimate, Observability]:
    features = random_features(np.random.default_rng(1), tree, state, 12, 0.02, shuffle=False)
    found = estimate(features, tree, setting)
    return found, observability(found)


def moved(tree: KinematicTree, state: State, direction: OpenDirection, amplitude: float) -> State:
    """A state moved along a direction, as its definition has it."""
    joints, sus = state.T_parent_joint.copy(), state.T_joint_su.copy()
    for name, xi in direction.joints.items():
        joints[tree.joint_names.index(name)] @= exp(amplitude * xi)
    for name, xi in direction.sus.items():
        sus[tree.su_names.index(name)] @= exp(amplitude * xi)
    return replace(state, T_parent_joint=joints, T_joint_su=sus)


def misfit(found: Estimate, state: State) -> float:
    """Chi-squared of the readings alone."""
    return float(found.cost.at(state).chi2_by_block().sum())


@pytest.mark.parametrize(
    ("tree", "tilt", "parallel", "count"),
    [
        (FORK, 0.6, (), 1),  # a slide
        (FORK, 0.0, (), 2),  # a slide and a turn
        (tree_of((-1, 0, 0, 0, 1, 2, 3)), 0.6, (), 2),  # three branches
        (tree_of((-1, 0, 1, 2, 1, 4)), 0.6, (1,), 1),  # on the second of two parallel axes
        (tree_of((-1, 0, 1, 2, 0, 4)), 0.6, (1, 4), 1),  # parallel axes in both branches
        (tree_of((-1, 0, 1, 2, 1, 4), (1,)), 0.6, (), 1),  # a sliding joint between
        (tree_of((-1, 0, 1, 2, 3, 4)), 0.0, (), 0),  # no branch
        (tree_of((-1, 0, 1, 2, 0, 4, -1, 6, 7, -1)), 0.6, (), 1),  # beside other limbs
        (tree_of((-1, 0, 1, 2, 3, 0, 5, -1, -1), (0,)), 0.6, (), 0),  # limbs on a slide
        (tree_of((-1, 0, 1, 2, 1, 4)), 0.6, (), 0),  # nothing is open beyond two skew axes
    ],
)
def test_as_many_as_there_are_are_found_and_no_reading_changes(
    tree: KinematicTree, tilt: float, parallel: Sequence[int], count: int
) -> None:
    found, observed = seen(tree, robot(tree, tilt, parallel))
    assert observed.n_open == count
    at_best = misfit(found, found.state)
    for direction in observed.open_directions:
        for amplitude in (-1.0, 0.7):
            there = moved(tree, found.state, direction, amplitude)
            assert misfit(found, there) - at_best < 1.0


def test_a_second_log_with_the_base_tilted_closes_the_turn() -> None:
    tilted = np.array([[0.0, 0.0, 1.0], [0.0, np.sin(0.5), np.cos(0.5)]])
    _, observed = seen(FORK, replace(robot(FORK, tilt=0.0), up=tilted))
    (slide,) = observed.open_directions
    np.testing.assert_allclose(slide.joints["joint4"][3:], 0.0, atol=1e-3)


def test_the_axis_of_a_joint_that_never_moved_is_open() -> None:
    """It may be anywhere, while the segment beyond stays where it was seen."""
    state, rng = robot(FORK), np.random.default_rng(4)
    q = rng.uniform(-2.0, 2.0, (12, FORK.n_joints))
    q[:, 1] = 0.3
    found = at(FORK, state, q, still=1)
    observed = observability(found)
    assert observed.n_open == 5
    assert {j for j, v in enumerate(observed.joint_verdict) if v != "not observable"} == {0, 3, 5}
    # Two slides along axis 0, for link 1 might be one with link 0 as well, and three of axis 1.
    rigid, of_axis = observed.open_directions[:2], observed.open_directions[2:]
    assert [set(each.joints) for each in rigid] == [{"joint2"}, {"joint4"}]
    for direction in of_axis:
        assert set(direction.joints) == {"joint1", "joint2"}
        assert set(direction.sus) == {"su1"}
        assert misfit(found, moved(FORK, state, direction, 1e-3)) < 1.0
        shifted = {**direction.joints, "joint1": -direction.joints["joint1"]}
        wrong = OpenDirection(shifted, direction.sus)
        assert misfit(found, moved(FORK, state, wrong, 1e-3)) > 20.0


def at(tree: KinematicTree, state: State, q: np.ndarray, still: int) -> Estimate:
    """The truth as an estimate from perfect features in which one joint has no pattern."""
    P, D, U = len(q), tree.n_joints, tree.n_sus
    excited = np.delete(np.arange(1 + 2 * D), [1 + still, 1 + D + still])
    information = np.zeros((P, U, 1 + 2 * D, 1 + 2 * D))
    information[:, :, excited, excited] = 1e3
    log, per_su = np.zeros(P, dtype=np.int64), np.zeros(U)
    features = Features(
        tree.su_names, tree.joint_names, q, log, exact_coefficients(tree, state, q, log),
        Information.of(information), np.full((P, U, 3), 0.02), per_su, per_su,
        StaticMoves(np.zeros(0), np.zeros(0), np.zeros((0, U, 3))),
    )  # fmt: skip
    cost = Cost(tree, feature_blocks(features, tree), PLAIN.priors)
    count = cost.blocks.count
    return Estimate(
        tree, state, 0.0, np.zeros((P, U)), count, np.ones((P, U)), 0, cost,
        identifiable(tree, 1, intrinsics=False), (0.0,), cost.priors,
    )  # fmt: skip


def test_the_smaller_branch_moves_and_its_joint_is_told() -> None:
    _, observed = seen(FORK, robot(FORK))
    (direction,) = observed.open_directions
    assert set(direction.joints) == {"joint4"}
    assert not direction.sus
    assert observed.joint_verdict[4] == "not observable"
    assert "not observable" not in np.delete(observed.joint_verdict, 4)
    np.testing.assert_array_equal(moved_sus(FORK, [direction]), [[0, 0, 0, 0, 1, 1]])


def test_a_slide_is_a_metre_along_the_axis_and_a_turn_a_radian_about_it() -> None:
    found, observed = seen(FORK, robot(FORK, tilt=0.0))
    slide, turn = (each.joints["joint4"] for each in observed.open_directions)
    T = found.state.T_parent_joint[4]
    np.testing.assert_allclose(T[:3, :3] @ slide[:3], np.sign(slide[:3] @ T[2, :3]) * np.eye(3)[2],
                               atol=1e-3)  # fmt: skip
    np.testing.assert_allclose(slide[3:], 0.0, atol=1e-3)
    assert np.linalg.norm(turn[3:]) == pytest.approx(1.0)
    # A turn about the axis leaves the foot of the joint's origin on the axis where it is.
    after = T @ exp(1.0 * turn)
    assert np.linalg.norm(after[:2, 3]) == pytest.approx(np.linalg.norm(T[:2, 3]), abs=1e-3)
    assert after[2, 3] == pytest.approx(T[2, 3], abs=1e-3)


def test_the_urdf_gets_the_shortest_offset_along_an_open_direction() -> None:
    """0.4 m between the branches in truth; a weak prior holds them near each other."""
    state = robot(FORK)
    joints = state.T_parent_joint.copy()
    joints[1, 2, 3], joints[4, 2, 3] = 0.2, -0.2
    found, _ = seen(FORK, replace(state, T_parent_joint=joints))
    offset = found.state.T_parent_joint[[1, 4], 2, 3]
    assert abs(offset[0] - offset[1]) < 0.05


def test_a_prior_is_no_observation() -> None:
    """However near to each other origins are held: the log alone tells where branches are."""
    near = replace(PLAIN, priors=replace(PLAIN.priors, position=0.01))
    _, observed = seen(FORK, robot(FORK), near)
    assert observed.n_open == 1
    assert len(observed.su_unobservable[0]) == 1


def test_frames_elsewhere_on_the_axes_see_the_same_motion() -> None:
    """Twists follow the joint frames when these are slid along and turned about their axes."""
    rng = np.random.default_rng(3)
    state = robot(FORK)
    direction = OpenDirection({"joint4": rng.standard_normal(6)}, {"su5": rng.standard_normal(6)})
    changes = np.zeros((FORK.n_joints, 6))
    changes[:, [2, 5]] = rng.standard_normal((FORK.n_joints, 2))
    T_new_old = exp(changes)
    joints = state.T_parent_joint @ np.linalg.inv(T_new_old)
    joints[1:] = T_new_old[FORK.parent[1:]] @ joints[1:]
    sus = T_new_old[FORK.su_joint] @ state.T_joint_su
    other = replace(state, T_parent_joint=joints, T_joint_su=sus)
    there = direction.seen_from(dict(zip(FORK.joint_names, T_new_old, strict=True)))
    for before, after in ((state, other), (moved(FORK, state, direction, 0.4),
                                           moved(FORK, other, there, 0.4))):  # fmt: skip
        np.testing.assert_allclose(poses(after), poses(before), atol=1e-12)


def poses(state: State) -> np.ndarray:
    """(U, 4, 4) SU poses with every joint at 0.7."""
    T = np.empty_like(state.T_parent_joint)
    turn = exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.7]))
    for j, parent in enumerate(FORK.parent):
        T[j] = (T[parent] if parent >= 0 else np.eye(4)) @ state.T_parent_joint[j] @ turn
    return np.asarray(T[FORK.su_joint] @ state.T_joint_su)
