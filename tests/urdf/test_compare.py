"""The comparison sees what differs, and nothing that may be chosen freely."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_robots import Joint, robot_of

from skin2urdf.errors import InsufficientDataError, UsageError
from skin2urdf.geometry import se3
from skin2urdf.geometry.se3 import inverse, screw
from skin2urdf.model.canonical import canonical
from skin2urdf.model.records import KinematicModel
from skin2urdf.urdf.alignment import ARM
from skin2urdf.urdf.compare import compare, random_positions
from skin2urdf.urdf.differences import tree_differences
from skin2urdf.urdf.emit import emit
from skin2urdf.urdf.loading import load_robot
from skin2urdf.urdf.records import Comparison

Robots = Callable[..., KinematicModel]
DEG = np.pi / 180


@pytest.fixture
def against(tmp_path: Path) -> Callable[..., Comparison]:
    """A function (estimate, truth, options) -> comparison of the two as URDFs."""

    def run(est: KinematicModel, true: KinematicModel, **options: Any) -> Comparison:
        paths = []
        for name, model in (("est", est), ("true", true)):
            limits = np.tile([-1.5, 2.0], (model.tree.n_joints, 1))
            path = tmp_path / f"{name}.urdf"
            path.write_text(emit(model, name=name, limits=limits))
            paths.append(path)
        rng = np.random.default_rng(0)
        return compare(*paths, rng=rng, **{"n_configurations": 60, **options})

    return run


def displaced(model: KinematicModel, su: int, xi: np.ndarray) -> KinematicModel:
    """The model with one SU moved by a twist (m, rad) in its own frame."""
    T = model.T_joint_su.copy()
    T[su] = T[su] @ se3.exp(np.asarray(xi, float))
    return replace(model, T_joint_su=T)


def based(model: KinematicModel, T_new_base: np.ndarray) -> KinematicModel:
    """The same robot described from another base frame."""
    T_joint, T_su = model.T_parent_joint.copy(), model.T_joint_su.copy()
    roots, base_sus = model.tree.parent < 0, model.tree.su_joint < 0
    T_joint[roots], T_su[base_sus] = T_new_base @ T_joint[roots], T_new_base @ T_su[base_sus]
    return replace(model, T_parent_joint=T_joint, T_joint_su=T_su)


def assert_zero(c: Comparison) -> None:
    assert c.position.max < 1e-9
    assert c.orientation.max < 1e-9
    assert c.axis_angle.max < 1e-9
    assert c.axis_distance.max < 1e-9
    assert c.tree_equal


def test_a_robot_equals_itself(random_robot: Robots, against: Callable[..., Comparison]) -> None:
    model = random_robot(np.random.default_rng(0))
    c = against(model, model)
    assert_zero(c)
    assert {su.name for su in c.sus} == {*model.tree.su_names}
    assert {joint.name for joint in c.joints} == {*model.tree.joint_names}
    assert [each.limb for each in c.alignments] == ["joint_0"]
    np.testing.assert_allclose(c.alignments[0].T_truth_estimate, np.eye(4), atol=1e-9)
    assert c.not_observable == c.joints_left_out == c.unmatched == c.held_joints == ()


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_the_base_frame_is_free(
    random_robot: Robots, against: Callable[..., Comparison], xi: list[float]
) -> None:
    model = random_robot(np.random.default_rng(1))
    X = se3.exp(np.array(xi) * [1, 1, 1, 0.5, 0.5, 0.5])
    c = against(model, based(model, X), n_configurations=10)
    assert_zero(c)
    np.testing.assert_allclose(c.alignments[0].T_truth_estimate, X, atol=1e-8)


def test_joint_frames_are_free_on_their_axes(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    rng = np.random.default_rng(2)
    model = random_robot(rng)
    n = model.tree.n_joints
    slide = np.concatenate([screw("z", rng.uniform(-2, 2, n), rng.uniform(-1, 1, n)), [np.eye(4)]])
    T_joint = inverse(slide[model.tree.parent]) @ model.T_parent_joint @ slide[:-1]
    T_su = inverse(slide[model.tree.su_joint]) @ model.T_joint_su
    slid = replace(model, T_parent_joint=T_joint, T_joint_su=T_su)
    assert np.abs(T_joint - model.T_parent_joint).max() > 0.1
    assert_zero(against(slid, model))
    assert_zero(against(canonical(model), model))


@pytest.mark.parametrize(
    ("xi", "mm", "deg"),
    [
        ([1e-3, 0, 0, 0, 0, 0], 1.0, 0.0),
        ([0, 0, 0, 0, 0.1 * DEG, 0], 0.0, 0.1),
        ([0, -1e-3, 0, 0.1 * DEG, 0, 0], 1.0, 0.1),
    ],
)
def test_a_known_error_of_one_su_is_reported_as_such(
    random_robot: Robots,
    against: Callable[..., Comparison],
    xi: list[float],
    mm: float,
    deg: float,
) -> None:
    # Many SUs, so that the alignment can not hide the one error.
    model = random_robot(np.random.default_rng(3), su_joint=(0, 1, 2, 3, 4) * 8)
    c = against(displaced(model, 12, np.array(xi)), model)
    by_name = {su.name: su for su in c.sus}
    wrong = by_name.pop("su_12")
    assert wrong.position is not None
    assert wrong.orientation is not None
    assert wrong.position.rms * 1e3 == pytest.approx(mm, abs=0.05)
    assert wrong.orientation.rms / DEG == pytest.approx(deg, abs=0.005)
    assert wrong.position.max >= wrong.position.rms
    assert all(su.position is not None and su.position.max < 1e-4 for su in by_name.values())
    n = model.tree.n_sus
    assert c.position.rms * 1e3 == pytest.approx(mm / np.sqrt(n), abs=0.02)
    assert c.tree_equal


def test_a_known_error_of_an_axis_is_reported_as_such(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    model = random_robot(np.random.default_rng(4))
    shift = screw("x", 0.0, 2e-3)
    T_joint, T_su = model.T_parent_joint.copy(), model.T_joint_su.copy()
    T_joint[4] = T_joint[4] @ shift
    on_it = model.tree.su_joint == 4
    T_su[on_it] = inverse(shift) @ T_su[on_it]
    c = against(replace(model, T_parent_joint=T_joint, T_joint_su=T_su), model)
    joint = next(j for j in c.joints if j.name == "joint_4")
    assert joint.distance is not None
    assert joint.distance.rms == pytest.approx(2e-3, rel=0.5)
    assert joint.angle.max < 0.5 * DEG
    prismatic = next(j for j in c.joints if j.joint_type == "prismatic")
    assert prismatic.distance is None


def test_a_joint_that_counts_the_other_way_is_half_a_turn_off(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    model = random_robot(np.random.default_rng(5), su_joint=(0, 0, 0, 1, 2, 3, 4) * 3)
    T_joint, T_su = model.T_parent_joint.copy(), model.T_joint_su.copy()
    flip = screw("x", np.pi, 0.0)
    T_joint[4] = T_joint[4] @ flip
    on_it = model.tree.su_joint == 4
    T_su[on_it] = flip @ T_su[on_it]
    c = against(replace(model, T_parent_joint=T_joint, T_joint_su=T_su), model)
    joint = next(j for j in c.joints if j.name == "joint_4")
    assert joint.angle.rms == pytest.approx(np.pi, abs=0.5)


def test_nearly_equal_axes_are_near_where_the_robot_is(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    """Two lines 1 mm apart at the SUs that cross 10 m away are 1 mm apart, not 0."""
    model = random_robot(np.random.default_rng(6), parent=(-1, 0), su_joint=(0,) * 20 + (1, 1, 1))
    tilt = screw("x", 1e-4, 0.0) @ screw("y", 0.0, 1e-3)
    T_joint, T_su = model.T_parent_joint.copy(), model.T_joint_su.copy()
    T_joint[1] = T_joint[1] @ tilt
    # A base frame far away is free, too: it does not choose where the distance is taken.
    far = screw("x", 0.0, 20.0) @ screw("y", 0.0, 20.0) @ screw("z", 0.0, 20.0)
    tilted = based(replace(model, T_parent_joint=T_joint), far)
    c = against(tilted, based(replace(model, T_joint_su=T_su), far))
    joint = next(j for j in c.joints if j.name == "joint_1")
    assert joint.distance is not None
    assert joint.distance.rms == pytest.approx(1e-3, rel=0.2)


def test_another_order_of_joints_is_another_tree(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    model = random_robot(np.random.default_rng(7))
    names = ("joint_1", "joint_0", *model.tree.joint_names[2:])
    swapped = replace(model, tree=replace(model.tree, joint_names=names))
    c = against(swapped, model)
    assert not c.tree_equal
    (d,) = (d for d in c.tree_differences if d.name == "su_1")
    assert (d.kind, d.found, d.right) == ("chain", ("joint_1",), ("joint_0",))


def test_another_parent_and_another_type_are_another_tree(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    model = random_robot(np.random.default_rng(8))
    rehung = replace(model.tree, parent=np.array([-1, 0, 1, 2, 3]))
    c = against(replace(model, tree=rehung), model)
    assert [d.name for d in c.tree_differences] == ["su_5", "su_6"]

    sliding = random_robot(np.random.default_rng(8), prismatic=())
    c = against(sliding, model)
    (d,) = c.tree_differences
    assert (d.kind, d.name, d.found, d.right) == ("type", "joint_2", ("revolute",), ("prismatic",))
    assert "joint_2" not in {joint.name for joint in c.joints}


def test_a_joint_the_estimate_lacks_is_held_and_named(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    true = random_robot(np.random.default_rng(9), su_joint=(0, 1, 2, 2, 3))
    tree = true.tree
    est = replace(
        true,
        tree=replace(
            tree,
            joint_names=tree.joint_names[:4],
            parent=tree.parent[:4],
            joint_types=tree.joint_types[:4],
        ),
        T_parent_joint=true.T_parent_joint[:4],
    )
    c = against(est, true)
    assert_zero(c)
    assert c.held_joints == ("joint_4",)
    c = against(true, est)
    assert [(d.kind, d.name) for d in c.tree_differences] == [("extra joint", "joint_4")]


def test_unobservable_directions_do_not_count(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    model = random_robot(np.random.default_rng(10))
    free = np.array([[0.6, 0.8, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1.0]])
    along = np.array([0.06, 0.08, 0, 0, 0, 0])
    wrong = displaced(model, 3, along)
    assert against(wrong, model).position.max > 0.05
    c = against(wrong, model, unobservable={"su_3": free})
    assert_zero(c)
    assert next(su for su in c.sus if su.name == "su_3").n_unobservable == 2
    across = displaced(wrong, 3, np.array([0, 0, 1e-3, 0, 0, 0]))
    c = against(across, model, unobservable={"su_3": free})
    su = next(su for su in c.sus if su.name == "su_3")
    assert su.position is not None
    assert su.position.rms == pytest.approx(1e-3, rel=0.3)


@pytest.mark.parametrize("angle", [0.1, -1.5, 3.0, np.pi, -3.1])
def test_a_finite_turn_about_an_unobservable_axis_does_not_count(
    random_robot: Robots, against: Callable[..., Comparison], angle: float
) -> None:
    """What only a vertical first axis moves may sit anywhere on a circle about it."""
    model = random_robot(np.random.default_rng(11))
    xi_su = se3.adjoint(inverse(model.T_joint_su[1])) @ [0, 0, 0, 0, 0, 1]
    direction = xi_su * [1, 1, 1, ARM, ARM, ARM]
    direction /= np.linalg.norm(direction)
    turned = displaced(model, 1, angle * xi_su)
    # Errors of the chain, so that the SU's error is a little more than half a turn at some
    # configurations and a little less at others.
    noise = se3.exp(1e-5 * np.random.default_rng(12).standard_normal((5, 6)))
    turned = replace(turned, T_parent_joint=turned.T_parent_joint @ noise)
    c = against(turned, model, unobservable={"su_1": direction[None]})
    assert c.position.max < 1e-4
    assert c.orientation.max < 1e-4


def test_an_su_on_the_base_does_not_disturb_the_alignment(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    """Of an SU on the reference segment a log tells roll and pitch; all else may be anything."""
    model = random_robot(np.random.default_rng(13))
    T = model.T_joint_su.copy()
    T[0, :3, 3] += [0.5, -2.0, 0.3]
    T[0, :3, :3] = screw("z", 2.0, 0.0)[:3, :3] @ T[0, :3, :3]
    yaw_su = np.concatenate([np.zeros(3), model.T_joint_su[0, 2, :3]])
    free = np.vstack([np.eye(6)[:3], yaw_su])
    c = against(replace(model, T_joint_su=T), model, unobservable={"su_0": free})
    assert_zero(c)
    su = next(su for su in c.sus if su.name == "su_0")
    assert su.position is None
    assert su.orientation is not None
    assert c.to_dict()["sus"]["su_0"]["position_mm"] is None

    # What is not told is no error of zero that would flatter the overall figures.
    both = displaced(replace(model, T_joint_su=T), 3, np.array([1e-3, 0, 0, 0, 0, 1e-3]))
    c = against(both, model, unobservable={"su_0": free})
    squares = [su.position.rms**2 for su in c.sus if su.position is not None]
    assert len(squares) == model.tree.n_sus - 1
    assert c.position.rms == pytest.approx(np.sqrt(np.mean(squares)))
    c = against(both, model, unobservable={"su_3": np.eye(6)[3:]})
    squares = [su.orientation.rms**2 for su in c.sus if su.orientation is not None]
    assert len(squares) == model.tree.n_sus - 1
    assert c.orientation.rms == pytest.approx(np.sqrt(np.mean(squares)))

    for nothing in (np.eye(6), np.eye(6)[3:]):  # its position is free anyway
        c = against(replace(model, T_joint_su=T), model, unobservable={"su_0": nothing})
        assert_zero(c)
        assert c.not_observable == ("su_0",)
        assert "su_0" not in {su.name for su in c.sus}


def test_nothing_in_common_or_observable_is_an_error(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    model = random_robot(np.random.default_rng(14))
    with pytest.raises(InsufficientDataError):
        against(model, model, unobservable=dict.fromkeys(model.tree.su_names, np.eye(6)))
    with pytest.raises(UsageError, match="su_1"):
        against(model, model, unobservable={"su_1": np.ones((2, 5))})
    for wrong in ({"align": "arms"}, {"n_configurations": 0}):
        with pytest.raises(UsageError) as caught:
            against(model, model, **wrong)
        assert caught.value.argument in wrong


def test_an_su_the_truth_lacks_is_named(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    model = random_robot(np.random.default_rng(15))
    names = ("ghost", *model.tree.su_names[1:])
    c = against(replace(model, tree=replace(model.tree, su_names=names)), model)
    assert c.unmatched == ("ghost",)
    assert_zero(c)


def test_the_dictionary_is_json_in_mm_and_deg(
    random_robot: Robots, against: Callable[..., Comparison]
) -> None:
    model = random_robot(np.random.default_rng(16))
    c = against(displaced(model, 2, np.array([0, 0, 5e-3, 0, 0, 0])), model)
    content = json.loads(json.dumps(c.to_dict(), allow_nan=False))
    assert content["tree_equal"] is True
    assert content["overall"]["position_mm"]["rms"] == pytest.approx(c.position.rms * 1e3)
    assert content["overall"]["axis_angle_deg"]["max"] == pytest.approx(c.axis_angle.max / DEG)
    assert {*content["sus"]} == {*model.tree.su_names}
    assert content["joints"]["joint_2"]["axis_distance_mm"] is None


def test_configurations_stay_inside_both_limits(tmp_path: Path) -> None:
    def robot(name: str, limits: str) -> Path:
        """A robot of two joints with ``limits``; in robot x joint b has none."""
        joints = ""
        for joint, kind in (("a", "revolute"), ("b", "continuous" if name == "x" else "revolute")):
            joints += (
                f"<link name='{joint}l'/><joint name='{joint}' type='{kind}'>"
                f"<parent link='base'/><child link='{joint}l'/><axis xyz='0 1 0'/>"
                f"<limit effort='1' velocity='1' {limits}/></joint>"
            )
        path = tmp_path / f"{name}.urdf"
        path.write_text(f"<robot name='r'><link name='base'/>{joints}</robot>")
        return path

    est = load_robot(robot("y", "lower='-1' upper='2'"))
    true = load_robot(robot("x", "lower='1.5' upper='3'"))
    rng = np.random.default_rng(0)
    q = random_positions(est, true, ["a", "b"], 500, rng)
    assert 1.5 <= q[:, 0].min() < 1.51
    assert 1.99 < q[:, 0].max() <= 2
    assert -1 <= q[:, 1].min() < -0.9
    assert 1.9 < q[:, 1].max() <= 2
    apart = load_robot(robot("x", "lower='5' upper='6'"))
    q = random_positions(est, apart, ["a"], 500, rng)
    assert -1 <= q.min() < q.max() <= 2
    q = random_positions(true, apart, ["b"], 500, rng)
    assert -np.pi <= q.min() < -3
    assert 3 < q.max() <= np.pi


@pytest.mark.parametrize("parent", [(-1,), (-1, 0)])
def test_small_robots_equal_themselves(
    random_robot: Robots, against: Callable[..., Comparison], parent: tuple[int, ...]
) -> None:
    n = len(parent)
    model = random_robot(np.random.default_rng(17), parent=parent, su_joint=(n - 1,))
    c = against(model, model, n_configurations=3)
    assert c.tree_equal
    assert c.position.max < 1e-12
    assert len(c.joints) == n


@pytest.mark.parametrize(
    ("kinds", "tilt", "equal"),
    [
        (("revolute", "prismatic"), 0.0, True),
        (("revolute", "prismatic"), 0.1, False),
        (("prismatic", "prismatic"), 0.1, True),
        (("revolute", "revolute"), 0.1, False),
    ],
)
def test_an_order_that_no_motion_shows_is_no_difference(
    kinds: tuple[str, str], tilt: float, equal: bool, tmp_path: Path
) -> None:
    """Two joints along one axis, or square to each other, and one that both carry."""
    first, second = (
        Joint(name, -1, kind, xyz=(0.0, 0.0, 0.0)) for name, kind in zip("ab", kinds, strict=True)
    )
    last = Joint("c", 1, "revolute", rpy=(1.0, 0.0, 0.0))
    robots = []
    for i, (near, far) in enumerate(((first, second), (second, first))):
        folder = tmp_path / str(i)
        folder.mkdir()
        chain = (near, replace(far, parent=0, rpy=(tilt, 0.0, 0.0)), last)
        robots.append(load_robot(robot_of(chain, folder).urdf))
    assert (not tree_differences(*robots, ["link_c"])) == equal
