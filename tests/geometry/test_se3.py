"""Exponential, logarithm and adjoint agree with Pinocchio's and with each other."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skin2urdf.geometry import se3

DIRECTIONS = arrays(float, 6, elements=st.floats(-1, 1))
SIZES = st.one_of(
    st.sampled_from([0.0, 1e-12, 1e-5, 1e-4, 1.1e-4, 9.9e-3, 1.1e-2]), st.floats(0, 3.0)
)


def twist(direction: np.ndarray, angle: float) -> np.ndarray:
    length = np.linalg.norm(direction[3:])
    turn = direction[3:] * (angle / length) if length > 1e-6 else np.zeros(3)
    return np.concatenate([direction[:3], turn])


@given(DIRECTIONS, SIZES)
def test_exp_and_log_are_pinocchios(direction: np.ndarray, angle: float) -> None:
    xi = twist(direction, angle)
    T = se3.exp(xi)
    np.testing.assert_allclose(T, pin.exp6(pin.Motion(xi)).homogeneous, atol=1e-12)
    np.testing.assert_allclose(se3.log(T), xi, atol=1e-9)


@given(DIRECTIONS, st.floats(0.01, 3.1))
def test_the_long_way_round_ends_at_the_same_place(direction: np.ndarray, angle: float) -> None:
    xi = twist(direction, angle)
    T = se3.exp(xi)
    other = se3.log(T, long_way=True)
    np.testing.assert_allclose(se3.exp(other), T, atol=1e-8)
    if xi[3:].any():
        np.testing.assert_allclose(np.linalg.norm(other[3:]), 2 * np.pi - angle)
    else:
        np.testing.assert_array_equal(other, se3.log(T))


@given(DIRECTIONS, DIRECTIONS)
def test_adjoint_moves_twists_between_frames(a: np.ndarray, b: np.ndarray) -> None:
    T = se3.exp(a)
    np.testing.assert_allclose(se3.adjoint(T), pin.SE3(T).action, atol=1e-12)
    moved = se3.exp(se3.adjoint(T) @ b)
    np.testing.assert_allclose(moved, T @ se3.exp(b) @ np.linalg.inv(T), atol=1e-9)


def test_all_are_vectorised() -> None:
    xi = np.random.default_rng(0).uniform(-1, 1, (3, 4, 6))
    T = se3.exp(xi)
    assert T.shape == (3, 4, 4, 4)
    np.testing.assert_allclose(se3.log(T), xi, atol=1e-12)
    np.testing.assert_allclose(se3.adjoint(T)[1, 2], se3.adjoint(T[1, 2]), atol=0)
    assert se3.log(np.zeros((0, 4, 4))).shape == (0, 6)
