"""Vectors along samples against the same, sample by sample."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.geometry import series
from skin2urdf.geometry.so3 import axis_rotation, skew

RNG = np.random.default_rng(5)
V, W = RNG.standard_normal((2, 4, 3, 7))


def test_cross_products_and_products_with_matrices_are_those_of_each_sample() -> None:
    A = RNG.standard_normal((4, 3, 3, 7))
    assert series.cross(V, W) == pytest.approx(np.cross(V, W, axis=1))
    assert series.applied(A, V) == pytest.approx(np.einsum("kijn,kjn->kin", A, V))


def test_rotations_are_those_of_rodrigues() -> None:
    axis = V[:, :, 0] / np.linalg.norm(V[:, :, 0], axis=1, keepdims=True)
    angle = RNG.uniform(-3.0, 3.0, (4, 7))
    each = axis_rotation(axis[:, None], angle)
    assert np.moveaxis(series.rotations(axis, angle), -1, 1) == pytest.approx(each)


def test_a_metre_along_each_axis_is_accelerated_as_on_a_turning_body() -> None:
    found = series.per_metre(V, W)
    omega, alpha = (skew(np.moveaxis(x, 1, 2)) for x in (V, W))
    expected = alpha + omega @ omega
    # The axis of the offset comes first: a column of the matrix.
    assert np.moveaxis(found, 3, 1).swapaxes(2, 3) == pytest.approx(expected)
