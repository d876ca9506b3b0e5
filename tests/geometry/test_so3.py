"""Laws of the rotation group and of the closed forms on it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from skin2urdf.arrays import F64
from skin2urdf.geometry.se3 import inverse, placement
from skin2urdf.geometry.so3 import (
    axis_rotation,
    cross,
    frame_with_z,
    rotation_exp,
    rotation_log,
    skew,
    wahba,
)

numbers = st.floats(-10, 10, allow_subnormal=False)
vectors = arrays(np.float64, 3, elements=numbers)
stacks = arrays(np.float64, (4, 3), elements=numbers)
seeds = st.integers(0, 2**32 - 1)


def unit(v: F64) -> F64:
    length = float(np.linalg.norm(v))
    assume(length > 1e-6)
    return v / length


@given(vectors, stacks)
def test_skew_and_cross_are_the_cross_product(a: F64, b: F64) -> None:
    expected = np.cross(a, b)
    np.testing.assert_allclose(cross(a, b), expected, atol=1e-12)
    np.testing.assert_allclose((skew(a) @ b[..., None])[..., 0], expected, atol=1e-12)
    np.testing.assert_array_equal(skew(b), -np.swapaxes(skew(b), -1, -2))


def test_cross_broadcasts() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((5, 1, 3)), rng.standard_normal((4, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), atol=1e-15)


@given(vectors, st.floats(0, 3.1))
def test_exponential_and_logarithm_undo_each_other(direction: F64, angle: float) -> None:
    w = unit(direction) * angle
    R = rotation_exp(w)
    np.testing.assert_allclose(R, expm(skew(w)), atol=1e-13)
    np.testing.assert_allclose(rotation_log(R), w, atol=1e-7)


@given(stacks)
def test_the_exponential_is_a_rotation_and_its_inverse_the_opposite(w: F64) -> None:
    R = rotation_exp(w)
    np.testing.assert_allclose(R @ rotation_exp(-w), np.broadcast_to(np.eye(3), R.shape), atol=1e-9)
    np.testing.assert_allclose(np.swapaxes(R, 1, 2), rotation_exp(-w), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-8, 1e-4])
def test_small_rotations_are_exact(size: float) -> None:
    w = size * np.array([0.6, -0.48, 0.64])
    exact = np.eye(3) + skew(w) + skew(w) @ skew(w) / 2
    np.testing.assert_allclose(rotation_exp(w), exact, atol=1e-12, rtol=0)


@given(vectors, st.floats(-7, 7), st.floats(-7, 7))
def test_turns_about_one_axis_add_up(direction: F64, a: float, b: float) -> None:
    k = unit(direction)
    np.testing.assert_allclose(
        axis_rotation(k, a) @ axis_rotation(k, b), axis_rotation(k, a + b), atol=1e-12
    )
    np.testing.assert_allclose(axis_rotation(k, a), rotation_exp(a * k), atol=1e-12)
    np.testing.assert_allclose(axis_rotation(k, a) @ k, k, atol=1e-12)


@given(seeds)
def test_the_inverse_of_a_placement_leads_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = placement(Rotation.random(6, random_state=rng).as_matrix(), rng.standard_normal((6, 3)))
    np.testing.assert_allclose(T @ inverse(T), np.broadcast_to(np.eye(4), T.shape), atol=1e-14)


def assert_frame_with_z(z: F64) -> None:
    R = frame_with_z(z)
    np.testing.assert_allclose(R[..., 2], z, atol=1e-6)
    eye = np.broadcast_to(np.eye(3), R.shape)
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), eye, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-9)


@given(vectors)
def test_a_frame_has_the_z_axis_asked_for_by_the_shortest_turn(direction: F64) -> None:
    z = unit(direction)
    assume(z[2] > -0.999)
    assert_frame_with_z(z)
    np.testing.assert_allclose(frame_with_z(z)[:, 2], z, atol=1e-12)
    angle = np.linalg.norm(rotation_log(frame_with_z(z)))
    assert angle == pytest.approx(np.arctan2(np.hypot(z[0], z[1]), z[2]), abs=1e-6)


@given(st.floats(0, 2 * np.pi), st.floats(-9, -1))
def test_a_frame_is_a_rotation_next_to_the_opposite_of_z(azimuth: float, exponent: float) -> None:
    tilt = 10.0**exponent
    x, y = np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth)
    assert_frame_with_z(np.array([x, y, -np.cos(tilt)]))


def test_the_opposite_of_z_among_others() -> None:
    assert_frame_with_z(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]))
    np.testing.assert_array_equal(frame_with_z(np.array([0.0, 0.0, 1.0])), np.eye(3))


@given(seeds, st.integers(2, 8))
def test_wahba_recovers_a_rotation(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    R = Rotation.random(5, random_state=rng).as_matrix()
    body = rng.standard_normal((5, n, 3))
    spread = np.linalg.svd(body, compute_uv=False)
    assume(spread[:, 1].min() > 1e-3)
    reference = body @ np.swapaxes(R, 1, 2)
    found, singular = wahba(body, reference, rng.uniform(0.5, 2.0, n))
    np.testing.assert_allclose(found, R, atol=1e-7)
    assert (np.diff(singular, axis=-1) <= 0).all()


@given(seeds)
def test_wahba_finds_the_best_rotation_even_of_mirrored_vectors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    body = rng.standard_normal((6, 3))
    reference = body * [1.0, 1.0, -1.0] + 0.1 * rng.standard_normal((6, 3))
    weights = rng.uniform(0.1, 3.0, 6)
    R, _ = wahba(body, reference, weights)
    assert np.linalg.det(R) == pytest.approx(1.0)

    def loss(R: F64) -> F64:
        return (weights * ((reference - body @ np.swapaxes(R, -1, -2)) ** 2).sum(axis=-1)).sum(-1)

    others = Rotation.random(200, random_state=rng).as_matrix()
    nearby = rotation_exp(0.01 * rng.standard_normal((50, 3))) @ R
    assert loss(R) <= min(loss(others).min(), loss(nearby).min()) + 1e-9
