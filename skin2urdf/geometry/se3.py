"""Rigid transforms and their twists, vectorised over leading axes.

A twist is (linear [m], angular [rad]) in R^6, a wrench accordingly (force, moment); ``exp(xi)`` is
the transform after following the twist for one unit of time. For a constant twist this is exact
for finite displacements, not only for small ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skin2urdf.arrays import F64
from skin2urdf.geometry.so3 import left_jacobian, rotation_exp, rotation_log, skew

_SMALL = 1e-4
"""Angle [rad] below which two terms of a series are more accurate than the quotient."""


def placement(R: F64, p: F64) -> F64:
    """(..., 4, 4) homogeneous transforms from rotations (..., 3, 3) and translations (..., 3)."""
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = p
    T[..., 3, 3] = 1.0
    return T


def inverse(T: F64) -> F64:
    """(..., 4, 4) inverses of homogeneous transforms."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return placement(Rt, -(Rt @ T[..., :3, 3:])[..., 0])


def screw(axis: str, angle: ArrayLike, shift: ArrayLike) -> F64:
    """Turn about and shift along one coordinate axis.

    Args:
        axis: "x", "y" or "z".
        angle: (...) turn [rad].
        shift: (...) shift [m], broadcast against ``angle``.

    Returns:
        (..., 4, 4) rigid transforms.
    """
    angle, shift = np.broadcast_arrays(np.asarray(angle, float), np.asarray(shift, float))
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    T = np.zeros((*angle.shape, 4, 4))
    T[..., 3, 3] = T[..., k, k] = 1.0
    T[..., i, i] = T[..., j, j] = np.cos(angle)
    T[..., j, i] = np.sin(angle)
    T[..., i, j] = -T[..., j, i]
    T[..., k, 3] = shift
    return T


def exp(twist: F64) -> F64:
    """Rigid transforms (..., 4, 4) of twists (..., 6) [m, rad]."""
    w = twist[..., 3:]
    return placement(rotation_exp(w), (left_jacobian(w) @ twist[..., :3, None])[..., 0])


def log(T: F64, *, long_way: bool = False) -> F64:
    """Twists (..., 6) [m, rad] of rigid transforms (..., 4, 4).

    Args:
        T: rigid transforms.
        long_way: take the rotation by more than pi the other way round instead of the one by at
            most pi; where there is no rotation there is no other way either.
    """
    vector = rotation_log(T[..., :3, :3])
    if long_way:
        length = np.linalg.norm(vector, axis=-1, keepdims=True)
        vector = vector * (1.0 - 2.0 * np.pi / np.where(length > 1e-12, length, np.inf))
    W = skew(vector)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    small = angle < _SMALL
    half = np.where(small, 1.0, angle) / 2.0
    k = np.where(
        small, 1.0 / 12.0 + angle**2 / 720.0, (1.0 - half / np.tan(half)) / (4.0 * half**2)
    )
    V_inverse = np.eye(3) - W / 2.0 + k * (W @ W)
    linear = np.einsum("...ij,...j->...i", V_inverse, T[..., :3, 3])
    return np.concatenate([linear, vector], axis=-1)


def adjoint(T_a_b: F64) -> F64:
    """(..., 6, 6) matrices that turn twists seen in b into the same twists seen in a."""
    R, p = T_a_b[..., :3, :3], T_a_b[..., :3, 3]
    A = np.zeros((*T_a_b.shape[:-2], 6, 6))
    A[..., :3, :3] = A[..., 3:, 3:] = R
    A[..., :3, 3:] = skew(p) @ R
    return A
