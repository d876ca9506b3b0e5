"""Vectors (..., 3, N) and matrices (..., 3, 3, N) along N samples, which come last.

A product of small matrices costs NumPy far more than its sums do; with the samples last, each of
these is one pass over all of them.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.geometry.so3 import skew


def cross(a: F64, b: F64) -> F64:
    """(..., 3, N) cross products, with broadcasting."""
    a0, a1, a2 = a[..., 0, :], a[..., 1, :], a[..., 2, :]
    b0, b1, b2 = b[..., 0, :], b[..., 1, :], b[..., 2, :]
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0, :] = a1 * b2 - a2 * b1
    out[..., 1, :] = a2 * b0 - a0 * b2
    out[..., 2, :] = a0 * b1 - a1 * b0
    return out


def applied(A: F64, x: F64) -> F64:
    """(..., 3, N) vectors ``A x`` by matrices A (..., 3, 3, N), with broadcasting."""
    out = np.empty(np.broadcast_shapes(A.shape[:-2] + A.shape[-1:], x.shape))
    for i in range(3):
        row = out[..., i, :]
        np.multiply(A[..., i, 0, :], x[..., 0, :], out=row)
        row += A[..., i, 1, :] * x[..., 1, :]
        row += A[..., i, 2, :] * x[..., 2, :]
    return out


def rotations(axis: F64, angle: F64) -> F64:
    """(..., 3, 3, N) rotations by ``angle`` (..., N) [rad] about unit ``axis`` (..., 3)."""
    K = skew(axis)
    angle = angle[..., None, None, :]
    whole = np.eye(3)[..., None] + np.sin(angle) * K[..., None]
    return np.asarray(whole + (1 - np.cos(angle)) * (K @ K)[..., None])


def per_metre(omega: F64, alpha: F64) -> F64:
    """Acceleration of a point per metre of its offset, on a body that turns [1/s^2].

    Args:
        omega: (..., 3, N) angular velocity [rad/s], and
        alpha: (..., 3, N) angular acceleration [rad/s^2], in the frame that is wanted.

    Returns:
        (..., 3, 3, N), the first of the threes being the axis of the offset.
    """
    out = np.asarray(omega[..., :, None, :] * omega[..., None, :, :])
    square = (omega * omega).sum(axis=-2)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[..., i, i, :] -= square
        out[..., i, j, :] += alpha[..., k, :]
        out[..., i, k, :] -= alpha[..., j, :]
    return out
