"""Limbs are compared each by itself; what is missing is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skin2urdf.errors import InsufficientDataError, UsageError
from skin2urdf.geometry import se3
from skin2urdf.geometry.se3 import inverse, screw
from skin2urdf.model.records import KinematicModel
from skin2urdf.urdf.compare import compare
from skin2urdf.urdf.emit import emit
from skin2urdf.urdf.records import Comparison

DEG = np.pi / 180
PARENT = (-1, 0, -1, 2, -1)
SU_JOINT = (0, 1, 1, 2, 3, 3, 4)
Against = Callable[..., Comparison]


@pytest.fixture
def against(tmp_path: Path) -> Against:
    """A function (estimate, truth, options) -> comparison of the two as URDFs."""

    def run(est: KinematicModel, true: KinematicModel, **options: Any) -> Comparison:
        paths = []
        for name, model in (("est", est), ("true", true)):
            limits = np.tile([-1.5, 2.0], (model.tree.n_joints, 1))
            paths.append(tmp_path / f"{name}.urdf")
            paths[-1].write_text(emit(model, name=name, limits=limits, visuals=False))
        rng = np.random.default_rng(0)
        return compare(*paths, rng=rng, **{"n_configurations": 30, **options})

    return run


@pytest.fixture
def robot(random_robot: Callable[..., KinematicModel]) -> KinematicModel:
    """Three limbs: two joints, a joint and a slide, one joint with one SU; and two base SUs."""
    rng = np.random.default_rng(1)
    return random_robot(rng, parent=PARENT, su_joint=(*SU_JOINT, -1, -1), prismatic=(3,))


def placed(model: KinematicModel, X: dict[int, np.ndarray]) -> KinematicModel:
    """The robot with some of its root joints, by index, moved in the base frame."""
    T = model.T_parent_joint.copy()
    for joint, T_new_base in X.items():
        T[joint] = T_new_base @ T[joint]
    return replace(model, T_parent_joint=T)


def moved_su(model: KinematicModel, su: int, xi: list[float]) -> KinematicModel:
    """The robot with one SU moved by a twist (m, rad) in its own frame."""
    T = model.T_joint_su.copy()
    T[su] = T[su] @ se3.exp(np.array(xi))
    return replace(model, T_joint_su=T)


def yawed(angle: float, *shift: float) -> np.ndarray:
    """Turn about z, then shift."""
    T = screw("z", angle, 0.0)
    T[:3, 3] = shift
    return T


def assert_zero(c: Comparison) -> None:
    assert c.position.max < 1e-9
    assert c.orientation.max < 1e-7
    assert c.axis_angle.max < 1e-7
    assert c.axis_distance.max < 1e-9
    assert c.tree_equal


numbers = st.floats(-3, 3)


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.lists(st.tuples(*[numbers] * 4), min_size=3, max_size=3))
def test_yaw_and_position_of_limbs_are_free(
    robot: KinematicModel, against: Against, places: list[tuple[float, ...]]
) -> None:
    X = {joint: yawed(*place) for joint, place in zip((0, 2, 4), places, strict=True)}
    c = against(placed(robot, X), robot, n_configurations=6)
    assert_zero(c)
    assert {each.limb for each in c.alignments} == {"joint_0", "joint_2", "joint_4"}
    for each in c.alignments:
        joint = int(str(each.limb)[-1])
        np.testing.assert_allclose(each.T_truth_estimate, inverse(X[joint]), atol=1e-7)
    assert c.tilt_between_limbs < 1e-7
    assert {su.name for su in c.sus} == {*robot.tree.su_names}


def test_one_transform_for_the_whole_robot_sees_the_limbs_places(
    robot: KinematicModel, against: Against
) -> None:
    c = against(robot, robot, align="base")
    assert_zero(c)
    assert [(each.limb, len(each.sus)) for each in c.alignments] == [(None, 9)]
    shifted = placed(robot, {2: yawed(0.0, 0.01, 0.0, 0.0)})
    assert against(shifted, robot, align="base").position.max > 2e-3
    assert_zero(against(shifted, robot, align="limbs"))


def test_limbs_that_disagree_on_gravity_are_told(robot: KinematicModel, against: Against) -> None:
    c = against(placed(robot, {2: screw("x", 0.3 * DEG, 0.0)}), robot)
    assert c.position.max < 1e-9
    assert c.tilt_between_limbs == pytest.approx(0.3 * DEG, rel=1e-6)
    assert c.to_dict()["tilt_between_limbs_deg"] == pytest.approx(0.3, rel=1e-6)
    assert {each["limb"] for each in c.to_dict()["alignments"]} == {"joint_0", "joint_2", "joint_4"}


def test_an_error_in_one_limb_stays_there(robot: KinematicModel, against: Against) -> None:
    c = against(moved_su(robot, 4, [2e-3, 0, 0, 0, 0, 0]), robot)
    for su in c.sus:
        wrong = su.name in {"su_3", "su_4", "su_5"}
        assert su.position is None or (su.position.max > 1e-4) == wrong


def test_base_sus_are_compared_by_their_tilt(robot: KinematicModel, against: Against) -> None:
    """Whatever their place and yaw; a tilt counts, against the gravity that the limbs tell."""
    T = robot.T_joint_su.copy()
    T[7] = yawed(2.5, 1.0, -2.0, 0.5) @ T[7]
    T[8] = screw("x", 0.2 * DEG, 0.0) @ yawed(-1.0, 0.0, 3.0, 0.0) @ T[8]
    everything = placed(replace(robot, T_joint_su=T), {0: yawed(0.7, 1, 1, 1)})
    errors = {su.name: su for su in against(everything, robot).sus}
    assert errors["su_7"].position is errors["su_8"].position is None
    assert errors["su_7"].n_unobservable == 4
    assert errors["su_7"].orientation is not None
    assert errors["su_7"].orientation.max < 1e-7
    assert errors["su_8"].orientation is not None
    assert errors["su_8"].orientation.max == pytest.approx(0.2 * DEG, rel=1e-3)
    # One transform for the whole robot knows the yaw, too.
    upright = replace(robot, T_joint_su=T)
    errors = {su.name: su for su in against(upright, robot, align="base").sus}
    assert errors["su_7"].position is None
    assert errors["su_7"].orientation is not None
    assert errors["su_7"].orientation.max == pytest.approx(2.5, rel=1e-6)


def test_only_base_sus_are_nothing_to_compare(
    random_robot: Callable[..., KinematicModel], robot: KinematicModel, against: Against
) -> None:
    hidden = dict.fromkeys(robot.tree.su_names[:7], np.eye(6))
    with pytest.raises(InsufficientDataError):
        against(robot, robot, unobservable=hidden)
    alone = random_robot(np.random.default_rng(2), parent=(), su_joint=(-1,), prismatic=())
    with pytest.raises(InsufficientDataError):
        against(alone, alone)


def test_a_limb_of_one_joint_and_one_su(
    random_robot: Callable[..., KinematicModel], against: Against
) -> None:
    """The joint's zero and the offset along its axis are free; the lever arm is not."""
    model = random_robot(np.random.default_rng(3), parent=(-1,), su_joint=(0,), prismatic=())
    T = model.T_joint_su.copy()
    T[0] = screw("z", 1.0, 0.5) @ T[0]
    along = se3.adjoint(inverse(model.T_joint_su[0])) @ [0, 0, 1, 0, 0, 0]
    for unobservable in (None, {"su_0": along[None]}):
        c = against(replace(model, T_joint_su=T), model, unobservable=unobservable)
        assert_zero(c)
    T[0] = screw("x", 0.0, 2e-3) @ T[0]
    c = against(replace(model, T_joint_su=T), model, unobservable={"su_0": along[None]})
    assert 1e-4 < c.position.rms < 2e-3
    assert np.isfinite([c.orientation.rms, c.axis_angle.rms, c.axis_distance.rms]).all()


@pytest.mark.parametrize("n_free", range(1, 6))
@pytest.mark.parametrize("seed", range(3))
def test_few_observable_directions_do_not_degenerate(
    random_robot: Callable[..., KinematicModel], against: Against, n_free: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    model = random_robot(rng, parent=(-1,), su_joint=(0,), prismatic=())
    rows = rng.standard_normal((n_free, 6))
    c = against(model, model, unobservable={"su_0": rows})
    assert_zero(c)
    c = against(moved_su(model, 0, list(1e-3 * rng.standard_normal(6))), model,
                unobservable={"su_0": rows})  # fmt: skip
    assert max(c.position.max, c.orientation.max, c.axis_angle.max) < 0.02
    assert c.axis_distance.max < 0.02


def test_well_determined_sus_align_their_limb(robot: KinematicModel, against: Against) -> None:
    """An SU that is off, or free in part, does not turn the frame the others are compared in."""
    off = moved_su(robot, 1, [0.03, 0, 0, 0, 0.2, 0])

    def others(**options: Any) -> float:
        c = against(off, robot, **options)
        return max(su.position.max for su in c.sus if su.position and su.name in {"su_0", "su_2"})

    assert others() > 1e-3
    assert others(anchors={"su_0", "su_2", "su_5"}) < 1e-9
    # SUs that are observable in all directions come first where nobody is named.
    assert others(unobservable={"su_1": np.eye(6)[[1]]}) < 1e-9
    c = against(off, robot, anchors=("su_2",), unobservable={"su_4": np.eye(6)[[1]]})
    assert [each.anchors for each in c.alignments] == [("su_2",), ("su_3", "su_5"), ("su_6",)]


def test_joints_of_limbs_that_show_nothing_are_left_out(
    robot: KinematicModel, against: Against
) -> None:
    c = against(robot, robot, unobservable={"su_6": np.eye(6)})
    assert_zero(c)
    assert c.not_observable == ("su_6",)
    assert c.joints_left_out == ("joint_4",)
    assert "joint_4" not in {joint.name for joint in c.joints}
    assert c.to_dict()["joints_left_out"] == ["joint_4"]


def without_last_joint(model: KinematicModel) -> KinematicModel:
    """The robot without its last joint, whose SUs then sit on the joint before."""
    tree, n = model.tree, model.tree.n_joints - 1
    return replace(
        model,
        tree=replace(
            tree,
            joint_names=tree.joint_names[:n],
            parent=tree.parent[:n],
            joint_types=tree.joint_types[:n],
            su_joint=np.where(tree.su_joint == n, tree.parent[n], tree.su_joint),
        ),
        T_parent_joint=model.T_parent_joint[:n],
    )


def test_a_joint_that_moves_an_su_and_is_missing_is_a_difference(
    random_robot: Callable[..., KinematicModel], against: Against
) -> None:
    chain = {"parent": (-1, 0, 1), "prismatic": ()}
    true = random_robot(np.random.default_rng(4), su_joint=(0, 1, 2, 2), **chain)
    c = against(without_last_joint(true), true)
    assert not c.tree_equal
    (d,) = c.tree_differences
    assert (d.kind, d.name, d.right) == ("missing joint", "joint_2", ("su_2", "su_3"))
    assert c.held_joints == ("joint_2",)
    # A joint that moves no SU can not be known.
    still = random_robot(np.random.default_rng(4), su_joint=(0, 1, 1), **chain)
    c = against(without_last_joint(still), still)
    assert_zero(c)


def test_an_expected_su_that_is_missing_is_a_difference(
    robot: KinematicModel, against: Against
) -> None:
    tree = robot.tree
    fewer = replace(
        robot,
        tree=replace(tree, su_names=tree.su_names[:6], su_joint=tree.su_joint[:6]),
        T_joint_su=robot.T_joint_su[:6],
    )
    assert against(fewer, robot).tree_equal
    c = against(fewer, robot, sus=tree.su_names)
    kinds = [(d.kind, d.name) for d in c.tree_differences]
    assert ("missing SU", "su_6") in kinds
    assert len(kinds) == 3
    # A joint that moves expected SUs only is missing, too.
    c = against(without_last_joint(fewer), robot, sus=["su_6"])
    assert [(d.kind, d.name, d.right) for d in c.tree_differences] == [
        ("missing joint", "joint_4", ("su_6",)), ("missing SU", "su_6", ())
    ]  # fmt: skip
    with pytest.raises(UsageError) as caught:
        against(robot, robot, sus=["ghost"])
    assert caught.value.argument == "ghost"
