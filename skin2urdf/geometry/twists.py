"""Exponential and logarithm of rigid transforms, vectorised.

A twist is (linear, angular) in R^6; ``exp(xi)`` is the transform after following it for one unit
of time. For a constant twist this is exact for finite displacements, not only for small ones.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.geometry.spatial import skew

_SMALL = 1e-4  # [rad]; below, series are more accurate than the quotients


def exp(twist: F64) -> F64:
    """Rigid transforms (..., 4, 4) of twists (..., 6) [m, rad]."""
    W = skew(twist[..., 3:])
    angle = np.linalg.norm(twist[..., 3:], axis=-1)[..., None, None]
    small = angle < _SMALL
    safe = np.where(small, 1.0, angle)
    s = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    c = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    t = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    WW = W @ W
    T = np.zeros((*twist.shape[:-1], 4, 4))
    T[..., :3, :3] = np.eye(3) + s * W + c * WW
    V = np.eye(3) + c * W + t * WW
    T[..., :3, 3] = np.einsum("...ij,...j->...i", V, twist[..., :3])
    T[..., 3, 3] = 1.0
    return T


def rotation_vector(R: F64) -> F64:
    """Axis times angle (..., 3) [rad] of rotations (..., 3, 3); the angle is at most pi."""
    from scipy.spatial.transform import Rotation

    flat = R.reshape(-1, 3, 3)
    vectors = Rotation.from_matrix(flat).as_rotvec() if len(flat) else np.zeros((0, 3))
    return np.asarray(vectors.reshape(R.shape[:-1]))


def log(T: F64, *, long_way: bool = False) -> F64:
    """Twists (..., 6) [m, rad] of rigid transforms (..., 4, 4).

    Args:
        T: rigid transforms.
        long_way: take the rotation by more than pi the other way round instead of the one by at
            most pi; where there is no rotation there is no other way either.
    """
    vector = rotation_vector(T[..., :3, :3])
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
