"""Branches may be where the log can not tell; what it does tell still counts in full."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skin2urdf.errors import UsageError
from skin2urdf.geometry.se3 import adjoint, exp, inverse
from skin2urdf.model.records import KinematicModel, OpenDirection
from skin2urdf.urdf.compare import compare
from skin2urdf.urdf.emit import emit
from skin2urdf.urdf.records import Comparison

Robots = Callable[..., KinematicModel]
ALONG, ABOUT = np.eye(6)[2], np.eye(6)[5]
"""A slide along the axis of the first joint, and a turn about it, in that joint's frame."""


@pytest.fixture
def fork(random_robot: Robots) -> KinematicModel:
    """Two branches on one joint: joints 1 and 2, and joint 3 and 4, with an SU on every segment."""
    rng = np.random.default_rng(0)
    return random_robot(rng, (-1, 0, 1, 0, 3), (0, 1, 1, 2, 2, 3, 3, 4, 4), ())


def beyond(model: KinematicModel, joint: int, xi: np.ndarray) -> OpenDirection:
    """Joint 1 or 3 and all beyond it moved by a twist of the first joint's frame."""
    return OpenDirection(
        {model.tree.joint_names[joint]: adjoint(inverse(model.T_parent_joint[joint])) @ xi}, {}
    )


def moved(model: KinematicModel, joint: int, xi: np.ndarray) -> KinematicModel:
    """The same, of the robot."""
    T = model.T_parent_joint.copy()
    T[joint] = exp(xi) @ T[joint]
    return replace(model, T_parent_joint=T)


def held(
    folder: Path,
    estimate: KinematicModel,
    truth: KinematicModel,
    directions: Sequence[OpenDirection] = (),
    anchors: Sequence[str] | None = None,
    align: str = "limbs",
) -> Comparison:
    paths = folder / "estimate.urdf", folder / "truth.urdf"
    for path, model in zip(paths, (estimate, truth), strict=True):
        limits = np.tile([-2.0, 2.0], (model.tree.n_joints, 1))
        path.write_text(emit(model, name="r", limits=limits, visuals=False))
    return compare(
        *paths, open_directions=directions, anchors=anchors, align=align,  # type: ignore[arg-type]
        n_configurations=40, rng=np.random.default_rng(1),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("slide", "turn"), [(0.4, 0.0), (-0.02, 0.0), (0.3, 0.9), (-0.5, 3.1), (0.1, -3.0), (0.0, 2.1)]
)
@pytest.mark.parametrize("align", ["limbs", "base"])
def test_a_branch_far_along_open_directions_is_no_error(
    tmp_path: Path, fork: KinematicModel, slide: float, turn: float, align: str
) -> None:
    estimate = moved(fork, 3, slide * ALONG + turn * ABOUT)
    directions = [beyond(estimate, 3, xi) for xi in (ALONG, ABOUT)]
    c = held(tmp_path, estimate, fork, directions, align=align)
    assert c.position.max < 1e-9
    assert c.orientation.max < 1e-9
    assert c.axis_distance.max < 1e-9
    assert c.axis_angle.max < 1e-7
    assert c.n_open == 2
    plain = held(tmp_path, estimate, fork, align=align)
    assert plain.position.rms > 0.1 * (abs(slide) + abs(turn))
    assert plain.n_open == 0


def test_either_branch_may_be_the_one_that_moves(tmp_path: Path, fork: KinematicModel) -> None:
    estimate = moved(fork, 3, 0.3 * ALONG)
    c = held(tmp_path, estimate, fork, [beyond(estimate, 1, ALONG)])
    # The SU on the first joint can not follow: it has no free direction here.
    assert c.position.max > 0.1
    free = {"su_0": np.concatenate([fork.T_joint_su[0, 2, :3], np.zeros(3)])[None]}
    text = {"unobservable": free, "open_directions": [beyond(estimate, 1, ALONG)]}
    c = compare(
        tmp_path / "estimate.urdf", tmp_path / "truth.urdf", **text,  # type: ignore[arg-type]
        n_configurations=40, rng=np.random.default_rng(1),
    )  # fmt: skip
    assert c.position.max < 1e-9


@pytest.mark.parametrize("slide", [0.0, 0.4])
def test_an_error_across_the_open_direction_counts_in_full(
    tmp_path: Path, fork: KinematicModel, slide: float
) -> None:
    """5 mm across the axis: as much as without anything open, wherever the branch has slid to."""
    across = moved(fork, 3, 0.005 * np.eye(6)[0])
    reference = held(tmp_path, across, fork)
    estimate = moved(across, 3, slide * ALONG)
    c = held(tmp_path, estimate, fork, [beyond(estimate, 3, ALONG)])
    assert c.position.rms == pytest.approx(reference.position.rms, rel=0.02)
    assert c.position.rms > 0.002
    assert c.axis_distance.rms == pytest.approx(reference.axis_distance.rms, rel=0.1)


def test_an_error_within_the_branch_counts_in_full(tmp_path: Path, fork: KinematicModel) -> None:
    T = fork.T_joint_su.copy()
    T[7] = T[7] @ exp(np.array([0.0, 0.005, 0.0, 0.02, 0.0, 0.0]))
    wrong = replace(fork, T_joint_su=T)
    reference = held(tmp_path, wrong, fork)
    estimate = moved(wrong, 3, 0.4 * ALONG + 2.0 * ABOUT)
    directions = [beyond(estimate, 3, xi) for xi in (ALONG, ABOUT)]
    c = held(tmp_path, estimate, fork, directions)
    assert c.position.rms == pytest.approx(reference.position.rms, rel=0.1)
    assert c.orientation.rms == pytest.approx(reference.orientation.rms, rel=0.1)


def test_a_branch_without_anchors_is_fitted_by_what_it_has(
    tmp_path: Path, fork: KinematicModel
) -> None:
    estimate = moved(fork, 3, 0.4 * ALONG)
    directions = [beyond(estimate, 3, ALONG)]
    anchors = ("su_1", "su_2", "su_3", "su_4")
    c = held(tmp_path, estimate, fork, directions, anchors=anchors)
    assert c.position.max < 1e-9
    assert set(c.alignments[0].anchors) == {*anchors, "su_5", "su_6", "su_7", "su_8"}


def test_what_stands_still_is_fitted_where_only_a_branch_that_moves_has_anchors(
    tmp_path: Path, fork: KinematicModel
) -> None:
    estimate = moved(fork, 3, 0.4 * ALONG)
    c = held(tmp_path, estimate, fork, [beyond(estimate, 3, ALONG)], anchors=("su_5", "su_6"))
    assert c.position.max < 1e-9
    assert {"su_0", "su_5"} < set(c.alignments[0].anchors)


def test_several_placements_may_move_together(tmp_path: Path, fork: KinematicModel) -> None:
    """The axis of a joint elsewhere, and what it carries back where it was for one position."""
    rng = np.random.default_rng(5)
    joints = {"joint_1": rng.standard_normal(6), "joint_2": rng.standard_normal(6)}
    direction = OpenDirection(joints, {"su_1": rng.standard_normal(6)})
    T, sus = fork.T_parent_joint.copy(), fork.T_joint_su.copy()
    for j, name in ((1, "joint_1"), (2, "joint_2")):
        T[j] = T[j] @ exp(0.01 * joints[name])
    sus[1] = sus[1] @ exp(0.01 * direction.sus["su_1"])
    estimate = replace(fork, T_parent_joint=T, T_joint_su=sus)
    assert held(tmp_path, estimate, fork).position.rms > 1e-3
    assert held(tmp_path, estimate, fork, [direction]).position.max < 1e-9


def test_a_direction_that_the_configurations_do_not_tell_is_left(
    tmp_path: Path, fork: KinematicModel
) -> None:
    """A motion of the whole limb is what the alignment does; nothing grows beyond bounds."""
    rng = np.random.default_rng(2)
    T = fork.T_joint_su @ exp(1e-3 * rng.standard_normal((fork.tree.n_sus, 6)))
    estimate = replace(fork, T_joint_su=T)
    whole = OpenDirection(
        {name: beyond(fork, j, ALONG).joints[name] for j, name in ((1, "joint_1"), (3, "joint_3"))},
        {"su_0": np.concatenate([T[0, 2, :3], np.zeros(3)])},
    )
    c, reference = held(tmp_path, estimate, fork, [whole]), held(tmp_path, estimate, fork)
    assert c.position.rms == pytest.approx(reference.position.rms, rel=1e-6)


def test_what_anchors_hardly_tell_from_the_base_moves_no_other_su_by_metres(
    tmp_path: Path, fork: KinematicModel
) -> None:
    """Both branches turned alike are a turn of the base, but for a little; su_0 stays behind."""
    rng = np.random.default_rng(3)
    T = fork.T_joint_su @ exp(1e-3 * rng.standard_normal((fork.tree.n_sus, 6)))
    wrong = replace(fork, T_joint_su=T)
    reference = held(tmp_path, wrong, fork)
    estimate = moved(wrong, 3, 0.25 * ALONG)
    little = ABOUT + 0.02 * np.eye(6)[3]
    both = OpenDirection(
        {**beyond(estimate, 1, ABOUT).joints, **beyond(estimate, 3, little).joints},
        {"su_0": 3.0 * np.eye(6)[0]},
    )
    slid = beyond(estimate, 3, ALONG)
    anchors = ("su_1", "su_2", "su_5", "su_6")
    c = held(tmp_path, estimate, fork, [both, slid], anchors=anchors)
    assert c.position.rms == pytest.approx(reference.position.rms, rel=0.5)


def test_what_moves_two_limbs_is_fitted_to_both_at_once(
    tmp_path: Path, random_robot: Robots
) -> None:
    """One limb's SUs hardly tell the direction: alone they would lead it far from the other's."""
    rng = np.random.default_rng(0)
    robot = random_robot(rng, (-1, 0, 1, -1, 3), (0, 1, 1, 2, 2, 3, 4, 4), ())
    joints = {
        "joint_1": rng.standard_normal(6),
        "joint_2": rng.standard_normal(6),
        "joint_4": 0.02 * rng.standard_normal(6),
    }
    direction = OpenDirection(joints, {})
    T = robot.T_parent_joint.copy()
    for name, xi in joints.items():
        j = robot.tree.joint_names.index(name)
        T[j] = T[j] @ exp(0.05 * xi)
    noise = exp(1e-3 * rng.standard_normal((robot.tree.n_sus, 6)))
    wrong = replace(robot, T_joint_su=robot.T_joint_su @ noise)
    reference = held(tmp_path, wrong, robot)
    estimate = replace(wrong, T_parent_joint=T)
    assert held(tmp_path, estimate, robot).position.rms > 10 * reference.position.rms
    c = held(tmp_path, estimate, robot, [direction])
    assert c.position.rms == pytest.approx(reference.position.rms, rel=0.1)


def test_directions_of_another_robot_are_refused(tmp_path: Path, fork: KinematicModel) -> None:
    with pytest.raises(UsageError, match="'elsewhere'"):
        held(tmp_path, fork, fork, [OpenDirection({"elsewhere": ALONG}, {})])
