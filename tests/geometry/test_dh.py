"""Extended DH: exact for every placement, and canonical frames leave the robot as it was."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from skin2urdf.geometry.dh import (
    PARALLEL_SINE,
    ExtendedDh,
    dh_of_placement,
    joint_placement,
    prismatic_placement,
)
from skin2urdf.geometry.se3 import inverse, screw
from skin2urdf.model.canonical import canonical
from skin2urdf.model.records import KinematicModel
from skin2urdf.structure.records import KinematicTree

ANGLES = st.one_of(
    st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi, -np.pi, 1e-9, 1e-4, np.pi - 1e-6]),
    st.floats(-np.pi, np.pi),
)
LENGTHS = st.one_of(st.sampled_from([0.0, 1e-13, 0.3]), st.floats(-1.5, 1.5))


@st.composite
def placements(draw: st.DrawFn) -> np.ndarray:
    """Any rigid placement, special angles (parallel, opposite, perpendicular) favoured."""
    T = np.eye(4)
    for axis in draw(st.permutations("xyz")):
        T = T @ screw(axis, draw(ANGLES), draw(LENGTHS))
    return T


def positions(model: KinematicModel, q: np.ndarray) -> np.ndarray:
    """(U, 4, 4) placements of the SUs in the base frame, by the product of all transforms."""
    T_base_joint = []
    for j, parent in enumerate(model.tree.parent):
        prismatic = model.tree.joint_types[j] == "prismatic"
        motion = screw("z", 0.0, q[j]) if prismatic else screw("z", q[j], 0.0)
        T_base_parent = np.eye(4) if parent < 0 else T_base_joint[parent]
        T_base_joint.append(T_base_parent @ model.T_parent_joint[j] @ motion)
    T_base_joint.append(np.eye(4))
    return np.stack([T_base_joint[j] for j in model.tree.su_joint]) @ model.T_joint_su


def random_transforms(rng: np.random.Generator, n: int) -> np.ndarray:
    """(n, 4, 4) placements; a third of them with parallel and a third with perpendicular axes."""
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.random(n, random_state=rng).as_matrix()
    T[:, :3, 3] = rng.uniform(-0.5, 0.5, (n, 3))
    for i in range(n):
        special = [None, (0.0, np.pi, 0.001), (np.pi / 2, -np.pi / 2)][i % 3]
        if special is not None:
            alpha = rng.choice(special)
            T[i] = screw("z", *rng.uniform(-1, 1, 2)) @ screw("x", alpha, rng.uniform(0, 1))
            T[i] = T[i] @ screw("z", *rng.uniform(-1, 1, 2))
    return T


def random_model(rng: np.random.Generator, n_joints: int, n_sus: int) -> KinematicModel:
    tree = KinematicTree(
        joint_names=tuple(f"j{j}" for j in range(n_joints)),
        parent=np.array([int(rng.integers(-1, j)) if j else -1 for j in range(n_joints)]),
        joint_types=tuple(rng.choice(["revolute", "revolute", "prismatic"], n_joints).tolist()),
        su_names=tuple(f"su{u}" for u in range(n_sus)),
        su_joint=rng.integers(-1, n_joints, n_sus),
    )
    placed = random_transforms(rng, n_joints + n_sus)
    return KinematicModel(tree, placed[:n_joints], placed[n_joints:])


@given(placements())
@example(np.eye(4))
@example(screw("x", np.pi, 0.2))
def test_any_placement_survives_the_round_trip(T: np.ndarray) -> None:
    dh = dh_of_placement(T)
    np.testing.assert_allclose(dh.placement(), T, atol=1e-12)
    if dh.hayati:
        assert abs(dh.turn) <= np.pi / 2
    else:
        assert dh.a >= -1e-12
    # The shifts stay within what PARALLEL_SINE promises.
    reach = np.linalg.norm(T[:3, 3])
    assert max(abs(dh.d), abs(dh.shift)) <= reach * (1 + 1 / PARALLEL_SINE) + 1e-12


def test_the_two_forms_are_those_of_the_definition() -> None:
    theta0, d, a, alpha, turn, shift = 0.3, 0.1, 0.2, 1.1, -0.4, 0.05
    paper = screw("z", theta0, d) @ screw("x", alpha, a) @ screw("z", turn, shift)
    numbers = dh_of_placement(paper)
    assert not numbers.hayati
    got = [numbers.theta0, numbers.d, numbers.a, numbers.alpha, numbers.turn, numbers.shift]
    np.testing.assert_allclose(got, [theta0, d, a, alpha, turn, shift], atol=1e-12)

    alpha, turn = 0.01, 0.02
    hayati = screw("z", theta0, d) @ screw("x", alpha, a) @ screw("y", turn, shift)
    numbers = dh_of_placement(hayati)
    assert numbers.hayati
    got = [numbers.theta0, numbers.d, numbers.a, numbers.alpha, numbers.turn, numbers.shift]
    np.testing.assert_allclose(got, [theta0, d, a, alpha, turn, shift], atol=1e-12)


def test_paper_form_is_the_matrix_of_equation_5() -> None:
    t, d, a, al = 0.7, 0.3, 0.2, -1.2
    ct, stt, ca, sa = np.cos(t), np.sin(t), np.cos(al), np.sin(al)
    expected = [
        [ct, -stt * ca, stt * sa, a * ct],
        [stt, ct * ca, -ct * sa, a * stt],
        [0, sa, ca, d],
        [0, 0, 0, 1],
    ]
    dh = ExtendedDh(t, d, a, al, 0.0, 0.0, hayati=False)  # type: ignore[arg-type]
    np.testing.assert_allclose(dh.placement(), expected, atol=1e-15)


def test_leading_axes_are_vectorised() -> None:
    T = random_transforms(np.random.default_rng(1), 24).reshape(4, 6, 4, 4)
    dh = dh_of_placement(T)
    assert dh.theta0.shape == (4, 6)
    assert 0 < dh.hayati.sum() < 24
    np.testing.assert_allclose(dh.placement(), T, atol=1e-12)
    np.testing.assert_allclose(dh_of_placement(T[2, 3]).placement(), T[2, 3], atol=1e-12)
    np.testing.assert_allclose(inverse(T) @ T, np.broadcast_to(np.eye(4), T.shape), atol=1e-12)


@given(placements())
@example(np.eye(4))
@example(screw("x", np.pi, 0.0))
@example(screw("y", np.pi, 0.3))
def test_joint_needs_four_numbers_and_keeps_its_axis(T: np.ndarray) -> None:
    dh, residual = joint_placement(T)
    np.testing.assert_allclose(dh.placement() @ residual, T, atol=1e-11)
    screw_z = screw("z", np.arctan2(residual[1, 0], residual[0, 0]), residual[2, 3])
    np.testing.assert_allclose(residual, screw_z, atol=1e-10)
    assert dh.shift == 0
    assert dh.a >= -1e-12
    assert dh.d == 0 if dh.hayati else dh.turn == 0
    # Read back as a full placement it is the same numbers: one convention, not two.
    again = dh_of_placement(dh.placement())
    if again.hayati == dh.hayati and dh.a > 1e-6:
        np.testing.assert_allclose(again.placement(), dh.placement(), atol=1e-11)
        np.testing.assert_allclose([again.a, again.d], [dh.a, dh.d], atol=1e-9)
        np.testing.assert_allclose([again.turn, again.shift], [dh.turn, dh.shift], atol=1e-9)


@pytest.mark.parametrize("alpha", [0.0, 1e-12, 1e-6, 1e-3, 0.049, 0.051, np.pi - 1e-6, np.pi])
def test_nearly_parallel_axes_keep_finite_offsets(alpha: float) -> None:
    T = screw("z", 0.4, 0.1) @ screw("x", alpha, 0.3) @ screw("z", 0.0, 0.2)
    dh, _ = joint_placement(T)
    assert bool(dh.hayati) == (np.sin(alpha) < PARALLEL_SINE)
    assert abs(dh.d) <= 0.2 + 1e-9
    assert 0.29 < dh.a < 0.32


@given(placements())
def test_prismatic_joint_needs_its_direction_only(T: np.ndarray) -> None:
    dh, residual = prismatic_placement(T)
    np.testing.assert_allclose(dh.placement() @ residual, T, atol=1e-11)
    assert dh.a == dh.d == dh.shift == 0
    np.testing.assert_allclose(residual[:3, 2], [0, 0, 1], atol=1e-11)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 6))
def test_canonical_leaves_the_robot_as_it_was(seed: int, n_joints: int, n_sus: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, n_joints, n_sus)
    result = canonical(model)
    for q in rng.uniform(-2, 2, (4, n_joints)):
        np.testing.assert_allclose(positions(result, q), positions(model, q), atol=1e-9)
    np.testing.assert_allclose(canonical(result).T_parent_joint, result.T_parent_joint, atol=1e-9)
    # Prismatic joints have no place, and revolute ones no more than four numbers.
    assert not result.T_parent_joint[model.tree.prismatic, :3, 3].any()
    dh = dh_of_placement(result.T_parent_joint)
    np.testing.assert_allclose(dh.shift, 0, atol=1e-9)
    np.testing.assert_allclose(np.where(dh.hayati, dh.d, dh.turn), 0, atol=1e-9)


def test_canonical_undoes_free_choices_of_joint_frames() -> None:
    """Frames turned about and slid along their axes are the same robot, and become the same."""
    rng = np.random.default_rng(7)
    tree = KinematicTree(
        ("a", "b", "c"), np.array([-1, 0, 1]), ("revolute",) * 3, ("su",), np.array([2])
    )
    T = np.stack([screw("z", *rng.uniform(-1, 1, 2)) @ screw("x", 1.2, 0.3) for _ in range(4)])
    slides = screw("z", rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3))
    moved = T.copy()
    moved[:3] = moved[:3] @ slides
    moved[1:] = inverse(slides) @ moved[1:]
    first = canonical(KinematicModel(tree, T[:3], T[3:]))
    second = canonical(KinematicModel(tree, moved[:3], moved[3:]))
    assert np.abs(moved - T).max() > 0.1
    np.testing.assert_allclose(second.T_parent_joint, first.T_parent_joint, atol=1e-12)
    np.testing.assert_allclose(second.T_joint_su, first.T_joint_su, atol=1e-12)


def test_leading_index_minus_one_is_the_base() -> None:
    """An SU on the reference segment stays where it is, whatever the joints' frames become."""
    rng = np.random.default_rng(3)
    tree = KinematicTree(("a",), np.array([-1]), ("revolute",), ("s", "t"), np.array([-1, 0]))
    placed = random_transforms(rng, 3)
    result = canonical(KinematicModel(tree, placed[:1], placed[1:]))
    np.testing.assert_array_equal(result.T_joint_su[0], placed[1])
