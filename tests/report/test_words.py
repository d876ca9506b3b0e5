"""Unobservable directions in words: the right words for constructed cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from skin2urdf.model.records import KinematicModel
from skin2urdf.report.words import ARM, TILT_REMEDY, Unknown, unknowns
from skin2urdf.structure.records import KinematicTree

UP = np.array([[0.0, 0.0, 1.0]])
NOTHING = np.zeros((0, 6))


def transform(rotation: Rotation, position: tuple[float, float, float]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), position
    return T


def arm(tilts: tuple[float, ...], *, kinds: str = "", seed: int = 0) -> KinematicModel:
    """A chain with an SU at its end; ``tilts`` are turns of the axes about x [rad]."""
    n = len(tilts)
    tree = KinematicTree(
        tuple(f"j{i + 1}" for i in range(n)),
        np.arange(-1, n - 1),
        tuple("prismatic" if kind == "p" else "revolute" for kind in kinds.ljust(n, "r")),
        ("su",),
        np.array([n - 1]),
    )
    joints = [transform(Rotation.from_euler("x", a), (0.1, 0.2, 0.3)) for a in tilts]
    su = transform(Rotation.random(random_state=seed), (0.05, -0.04, 0.2))
    return KinematicModel(tree, np.array(joints).reshape(n, 4, 4), su[None])


def along(model: KinematicModel) -> np.ndarray:
    """Twist of the SU along the axis of its joint."""
    return np.r_[model.T_joint_su[0, 2, :3], 0, 0, 0]


def about(model: KinematicModel) -> np.ndarray:
    """Twist of the SU about that axis, by finite differences of the motion itself."""
    T, step = model.T_joint_su[0], 1e-6
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0, 0, step]).as_matrix()
    change = np.linalg.inv(T) @ turn @ T
    angular = Rotation.from_matrix(change[:3, :3]).as_rotvec()
    return np.r_[change[:3, 3], ARM * angular] / step


def words(model: KinematicModel, *rows: np.ndarray, up: np.ndarray = UP) -> tuple[Unknown, ...]:
    basis = np.linalg.qr(np.array(rows).T)[0].T if rows else NOTHING
    (found,) = unknowns(model, [basis], up)
    assert all("su" in unknown.what and unknown.joint in unknown.what for unknown in found)
    return found


def test_nothing_unknown_is_not_mentioned() -> None:
    assert words(arm((0.5, 1.0))) == ()


@given(seed=st.integers(0, 1000), mix=st.floats(0, 6.28))
def test_slide_and_turn_are_told_apart_in_any_basis(seed: int, mix: float) -> None:
    model = arm((0.0,), seed=seed)
    a, b = np.linalg.qr(np.array([along(model), about(model)]).T)[0].T
    rows = np.cos(mix) * a + np.sin(mix) * b, np.cos(mix) * b - np.sin(mix) * a
    slide, turn = words(model, *rows)
    assert (slide.part, slide.joint, slide.cause) == ("slide", "j1", "one joint")
    assert slide.remedy == ""
    assert (turn.part, turn.joint, turn.cause) == ("turn", "j1", "vertical axis")
    assert turn.remedy == TILT_REMEDY


def test_a_turn_about_a_tilted_axis_is_not_put_down_to_the_vertical() -> None:
    model = arm((0.5,))
    (turn,) = words(model, about(model))
    assert (turn.part, turn.joint, turn.cause) == ("turn", "j1", "little motion")
    assert "j1" in turn.remedy
    # With one tilted log among several, the axis is not vertical in all of them.
    model = arm((0.0,))
    tilted = np.array([[0, 0, 1.0], [0, np.sin(0.4), np.cos(0.4)]])
    (turn,) = words(model, about(model), up=tilted)
    assert turn.cause == "little motion"


def test_bias_hides_a_tilt_where_gravity_keeps_still() -> None:
    model = arm((0.0,))
    sideways = np.r_[0, 0, 0, np.cross(model.T_joint_su[0, 2, :3], [1.0, 0.3, 0.2])]
    tilt = words(model, along(model), about(model), sideways)[-1]
    assert (tilt.part, tilt.cause) == ("tilt", "bias")
    assert tilt.remedy == TILT_REMEDY


def test_parallel_axes_are_named() -> None:
    model = arm((0.4, 0.0, 0.0))
    (slide,) = words(model, along(model))
    assert (slide.part, slide.joint, slide.cause) == ("slide", "j3", "parallel axes")
    assert all(name in slide.why for name in model.tree.joint_names)
    assert slide.remedy == ""


def test_a_slide_that_other_motion_would_show() -> None:
    model = arm((0.0, 1.0))
    (slide,) = words(model, along(model))
    assert (slide.part, slide.joint, slide.cause) == ("slide", "j2", "little motion")
    assert "j1" in slide.remedy
    assert "j2" not in slide.remedy


def test_an_su_that_is_only_pushed() -> None:
    model = arm((0.4,), kinds="p")
    (position,) = words(model, *np.eye(6)[:3])
    assert (position.part, position.cause) == ("position", "pushed")
    assert "j1" in position.why
    _, turn = words(model, *np.eye(6)[:3], np.r_[0, 0, 0, model.T_joint_su[0, 2, :3]])
    assert (turn.part, turn.cause) == ("orientation", "bias")
    (unknown,) = words(arm((0.4, 1.0), kinds="pp"), along(model))
    assert (unknown.part, unknown.cause) == ("position", "little motion")


def test_a_slide_after_the_last_turn_does_not_hide_its_axis() -> None:
    model = arm((0.4, 0.0, 0.7), kinds="prp")
    T_turn_su = model.T_parent_joint[2] @ model.T_joint_su[0]
    (slide,) = words(model, np.r_[T_turn_su[2, :3], 0, 0, 0])
    assert (slide.part, slide.joint, slide.cause) == ("slide", "j2", "one joint")


def test_an_unmoved_position_of_a_turned_su() -> None:
    (position,) = words(arm((0.4, 1.0)), *np.eye(6)[:3])
    assert (position.part, position.cause) == ("position", "little motion")
    assert position.remedy


def test_directions_of_no_special_kind() -> None:
    (unknown,) = words(arm((0.4, 1.0)), np.array([0.3, 0.1, 0.2, 0.05, 0.01, 0.09]))
    assert (unknown.part, unknown.cause) == ("pose", "little motion")
    (unknown,) = words(arm((0.4, 1.0)), np.array([0, 0, 0, 0.5, 0.1, 0.9]))
    assert (unknown.part, unknown.cause) == ("orientation", "little motion")
    assert all(name in unknown.remedy for name in ("j1", "j2"))


def test_all_directions() -> None:
    (unknown,) = words(arm((0.4,)), *np.eye(6))
    assert (unknown.part, unknown.cause) == ("pose", "silence")


@pytest.mark.parametrize(("count", "said"), [(0, 0), (3, 1), (4, 2), (6, 1)])
def test_an_su_on_the_reference_segment(count: int, said: int) -> None:
    model = arm((0.4,))
    tree = KinematicTree(("j1",), np.array([-1]), ("revolute",), ("su",), np.array([-1]))
    still = KinematicModel(tree, model.T_parent_joint, model.T_joint_su)
    found = words(still, *np.eye(6)[:count])
    assert len(found) == said
    assert all(unknown.cause == "still" for unknown in found)


def test_one_line_says_all() -> None:
    assert str(Unknown("pose", "still", "a", "b", "c")) == "a: b; c"
    assert str(Unknown("pose", "still", "a", "b")) == "a: b"
