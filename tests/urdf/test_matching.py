"""Comparison with a file that has none of the SUs, and perhaps other names of joints."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skin2urdf.errors import UsageError
from skin2urdf.geometry import se3
from skin2urdf.model.records import KinematicModel
from skin2urdf.urdf.compare import compare
from skin2urdf.urdf.emit import emit
from skin2urdf.urdf.loading import load_robot
from skin2urdf.urdf.matching import fit_axes, matched_joints
from skin2urdf.urdf.records import Comparison

Robots = Callable[..., KinematicModel]


def written(path: Path, model: KinematicModel, names: Mapping[str, str] | None = None) -> Path:
    """A URDF of a robot, its joints renamed; without SUs where names are given."""
    limits = np.tile([-2.0, 2.0], (model.tree.n_joints, 1))
    root = ET.fromstring(emit(model, name="r", limits=limits, visuals=False))  # noqa: S314
    if names is not None:
        for element in [*root.findall("link"), *root.findall("joint")]:
            if element.get("name", "").startswith("su_"):
                root.remove(element)
            elif element.tag == "joint":
                name = element.get("name", "")
                element.set("name", names.get(name, name))
    path.write_text(ET.tostring(root, "unicode"))
    return path


def moved(model: KinematicModel, base: np.ndarray, shift: float = 0.0) -> KinematicModel:
    """The robot on another base, its last joint shifted."""
    T = model.T_parent_joint.copy()
    for j in np.flatnonzero(model.tree.parent < 0):
        T[j] = base @ T[j]
    T[-1, 0, 3] += shift
    return replace(model, T_parent_joint=T)


@pytest.fixture
def base() -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 2.0]).as_matrix()
    T[:3, 3] = [0.2, -0.1, 0.5]
    return T


def against(
    folder: Path, est: KinematicModel, true: KinematicModel, names: Mapping[str, str]
) -> Comparison:
    paths = written(folder / "est.urdf", est), written(folder / "true.urdf", true, names)
    return compare(*paths, n_configurations=30, rng=np.random.default_rng(0))


@pytest.mark.parametrize("other_names", [False, True])
def test_the_same_robot_without_sus_has_no_errors(
    random_robot: Robots, tmp_path: Path, base: np.ndarray, other_names: bool
) -> None:
    est = random_robot(np.random.default_rng(3))
    names = {f"joint_{j}": f"axis_{9 - j}" for j in range(5)} if other_names else {}
    c = against(tmp_path, est, moved(est, base), names)
    assert c.tree_equal
    assert c.placed
    assert dict(c.matched) == names
    assert len(c.sus) == 6
    assert c.position.max < 1e-8
    assert c.orientation.max < 1e-7
    assert c.axis_distance.max < 1e-8


def test_a_wrong_length_shows_whatever_the_joints_are_called(
    random_robot: Robots, tmp_path: Path, base: np.ndarray
) -> None:
    est = random_robot(np.random.default_rng(3), (-1, 0, 1, 2), (0, 1, 2, 3), ())
    names = {f"joint_{j}": f"a{j}" for j in range(4)}
    c = against(tmp_path, est, moved(est, base, 0.004), names)
    assert 0.0005 < c.axis_distance.max < 0.02


def test_mirrored_limbs_are_told_apart_by_where_their_axes_lie(
    random_robot: Robots, tmp_path: Path
) -> None:
    """Two limbs, each the other's mirror image: order in the file and pairs of axes say nothing."""
    left = random_robot(np.random.default_rng(8), (-1, 0, 1), (2,), ())
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])  # keeps frames right-handed, and turns the sense
    right = mirror @ left.T_parent_joint @ flip
    right[1:] = flip @ left.T_parent_joint[1:] @ flip
    robot = random_robot(np.random.default_rng(8), (-1, 0, 1, -1, 3, 4), (2, 5), ())
    robot = replace(robot, T_parent_joint=np.concatenate([left.T_parent_joint, right]))
    order = (3, 4, 5, 0, 1, 2)
    swapped = replace(
        robot,
        tree=replace(robot.tree, joint_names=tuple(f"axis_{j}" for j in order)),
        T_parent_joint=robot.T_parent_joint[list(order)],
    )
    est = load_robot(written(tmp_path / "est.urdf", robot))
    true = load_robot(written(tmp_path / "true.urdf", swapped, {}))
    assert matched_joints(est, true) == {f"joint_{j}": f"axis_{j}" for j in range(6)}


def test_limbs_that_are_built_alike_go_by_their_names(random_robot: Robots, tmp_path: Path) -> None:
    leg = random_robot(np.random.default_rng(4), (-1, 0), (1,), ())
    both = random_robot(np.random.default_rng(4), (-1, 0, -1, 2), (1, 3), ())
    both = replace(both, T_parent_joint=np.tile(leg.T_parent_joint, (2, 1, 1)))
    ours = replace(both.tree, joint_names=("L_HIP", "L_KNEE", "R_HIP", "R_KNEE"))
    theirs = replace(both.tree, joint_names=("right_hip", "right_knee", "left_hip", "left_knee"))
    est = load_robot(written(tmp_path / "est.urdf", replace(both, tree=ours)))
    true = load_robot(written(tmp_path / "true.urdf", replace(both, tree=theirs), {}))
    assert matched_joints(est, true) == {
        "L_HIP": "left_hip", "L_KNEE": "left_knee", "R_HIP": "right_hip", "R_KNEE": "right_knee",
    }  # fmt: skip


def test_joints_that_only_the_other_robot_has_are_passed_over(
    random_robot: Robots, tmp_path: Path
) -> None:
    whole = random_robot(np.random.default_rng(5), (-1, 0, 1, 2), (3,), ())
    tree = replace(
        whole.tree,
        joint_names=("a", "b", "d"),
        parent=np.array([-1, 0, 1]),
        joint_types=("revolute",) * 3,
        su_joint=np.array([2]),
    )
    T = whole.T_parent_joint
    est = KinematicModel(tree, np.stack([T[0], T[1], T[2] @ T[3]]), whole.T_joint_su)
    estimate = load_robot(written(tmp_path / "est.urdf", est))
    true = load_robot(written(tmp_path / "true.urdf", whole, {}))
    assert matched_joints(estimate, true) == {"a": "joint_0", "b": "joint_1", "d": "joint_3"}


def test_robots_that_share_nothing_are_refused(random_robot: Robots, tmp_path: Path) -> None:
    est = random_robot(np.random.default_rng(1), (-1, 0), (1,), ())
    true = random_robot(np.random.default_rng(1), (-1,), (0,), (0,))
    with pytest.raises(UsageError) as raised:
        against(tmp_path, est, true, {"joint_0": "slide"})
    assert raised.value.remedy


@pytest.mark.parametrize("parallel", [False, True])
def test_axes_are_laid_onto_each_other(base: np.ndarray, parallel: bool) -> None:
    """A slide and three revolute axes, all parallel as in a SCARA, or not."""
    rng = np.random.default_rng(6)
    w = np.tile([0.6, 0.0, 0.8], (5, 3, 1))
    if not parallel:
        w = rng.normal(size=(5, 3, 3))
        w /= np.linalg.norm(w, axis=-1, keepdims=True)
    points = rng.uniform(-0.5, 0.5, (5, 3, 3))
    turning = np.concatenate([-np.cross(w, points), w], axis=-1)
    slide = np.concatenate([w[:, :1], np.zeros((5, 1, 3))], axis=-1)
    axes = np.concatenate([turning, slide], axis=1)
    kinds = [True, True, True, False]
    X = fit_axes(axes, axes @ se3.adjoint(base).T, kinds)
    np.testing.assert_allclose(axes @ se3.adjoint(X).T, axes @ se3.adjoint(base).T, atol=1e-9)
