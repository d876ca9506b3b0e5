"""Rotations: matrices, rotation vectors, and what is done with them, over leading axes.

A rotation vector w is the axis times the angle [rad]. :func:`left_jacobian` is the matrix J of
``exp(w + dw) = exp(J dw) exp(w)`` to first order; it is also what a translation takes on its way
along a screw (:func:`skin2urdf.geometry.se3.exp`).
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64

_SMALL = 1e-2
"""Angle [rad] below which a quotient of differences is a series.

Three terms of it are exact to 1e-16 there; the quotient's relative error is 1e-15 over the square
of the angle.
"""


def skew(v: F64) -> F64:
    """(..., 3, 3) matrices with ``skew(v) @ x == cross(v, x)`` for v of shape (..., 3)."""
    m = np.zeros((*v.shape, 3))
    m[..., 0, 1] = -v[..., 2]
    m[..., 0, 2] = v[..., 1]
    m[..., 1, 0] = v[..., 2]
    m[..., 1, 2] = -v[..., 0]
    m[..., 2, 0] = -v[..., 1]
    m[..., 2, 1] = v[..., 0]
    return m


def force_per_position(w: F64, wd: F64) -> F64:
    """(3, 3, N) ``[wd]x + [w]x [w]x``: specific force per position of a point in a moving frame.

    Args:
        w: (3, N) angular velocity in the frame [rad/s], and
        wd: (3, N) angular acceleration [rad/s^2]; samples last, where NumPy is fastest.

    Returns:
        By which the specific force at a point is larger than that at the origin [1/s^2].
    """
    A = w[:, None] * w
    A[range(3), range(3)] -= (w * w).sum(axis=0)
    x, y, z = wd
    A[0, 1] -= z
    A[0, 2] += y
    A[1, 0] += z
    A[1, 2] -= x
    A[2, 0] -= y
    A[2, 1] += x
    return A


def cross(a: F64, b: F64) -> F64:
    """Cross product over the last axis with broadcasting; several times faster than NumPy's."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    out = np.empty((*np.broadcast_shapes(a.shape, b.shape)[:-1], 3))
    out[..., 0] = a1 * b2 - a2 * b1
    out[..., 1] = a2 * b0 - a0 * b2
    out[..., 2] = a0 * b1 - a1 * b0
    return out


def axis_rotation(axis: F64, angle: F64) -> F64:
    """(..., 3, 3) rotations by ``angle`` (...) [rad] about unit ``axis`` (..., 3) (Rodrigues)."""
    K = skew(np.asarray(axis, dtype=np.float64))
    angle = np.asarray(angle, dtype=np.float64)[..., None, None]
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K))


def rotation_exp(w: F64) -> F64:
    """(..., 3, 3) rotation by the rotation vector w (..., 3) [rad]."""
    angle = np.linalg.norm(w, axis=-1)
    K = skew(w)
    half = angle / 2
    a = np.sinc(angle / np.pi)[..., None, None]
    b = (0.5 * np.sinc(half / np.pi) ** 2)[..., None, None]
    return np.asarray(np.eye(3) + a * K + b * (K @ K))


def rotation_log(R: F64) -> F64:
    """(..., 3) rotation vectors [rad] of rotations R (..., 3, 3), angle in [0, pi]."""
    from scipy.spatial.transform import Rotation

    flat = R.reshape(-1, 3, 3)
    vectors = Rotation.from_matrix(flat).as_rotvec() if len(flat) else np.zeros((0, 3))
    return np.asarray(vectors.reshape(R.shape[:-1]))


def left_jacobian(w: F64) -> F64:
    """(..., 3, 3) left Jacobian of SO(3) at rotation vectors w (..., 3) [rad]."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    K = skew(w)
    # (1 - cos a) / a^2 and (a - sin a) / a^3.
    b = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    small = angle < _SMALL
    safe = np.where(small, 1.0, angle)
    series = 1 / 6 - angle**2 / 120 + angle**4 / 5040
    c = np.where(small, series, (safe - np.sin(safe)) / safe**3)
    return np.asarray(np.eye(3) + b * K + c * (K @ K))


def frame_with_z(z: F64) -> F64:
    """(..., 3, 3) rotations whose third column is the unit vector z (..., 3).

    The rotation is the shortest one that takes (0, 0, 1) to z, so an axis near (0, 0, 1) gives
    a frame near identity.
    """
    x, y, c = z[..., 0], z[..., 1], z[..., 2]
    R = np.zeros((*z.shape, 3))
    # 1 / (1 + c), without its cancellation near c = -1.
    across = x * x + y * y
    down = (c < 0) & (across < 1e-300)
    k = np.where(c < 0, 1 - c, 1.0) / np.where(c < 0, np.where(down, 1.0, across), 1 + c)
    R[..., 0, 0] = 1 - x * x * k
    R[..., 0, 1] = R[..., 1, 0] = -x * y * k
    R[..., 1, 1] = 1 - y * y * k
    R[..., 0, 2], R[..., 1, 2] = x, y
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = -x, -y, c
    R[down] = np.diag([1.0, -1.0, -1.0])
    return R


def wahba(body: F64, reference: F64, weights: F64) -> tuple[F64, F64]:
    """Rotation that best maps reference vectors onto body vectors (Wahba's problem, by SVD).

    Args:
        body: (..., N, 3) vectors in the body frame.
        reference: (..., N, 3) the same vectors in the reference frame.
        weights: (N,) or broadcastable to (..., N).

    Returns:
        R_ref_body (..., 3, 3) with ``reference ~ R_ref_body @ body`` and the singular values
        (..., 3) of the profile matrix; the last two tell how well the rotation is determined.
    """
    B = np.swapaxes(reference * weights[..., None], -1, -2) @ body
    U, sv, Vt = np.linalg.svd(B)
    sign = np.linalg.det(U) * np.linalg.det(Vt)
    U = U.copy()
    U[..., :, 2] *= sign[..., None]
    return np.asarray(U @ Vt), sv


def fibonacci_sphere(n: int) -> F64:
    """(n, 3) nearly uniform unit vectors, on a golden spiral (Swinbank and Purser 2006)."""
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    azimuth = np.pi * (1 + np.sqrt(5)) * i
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=1)


def spread_out(directions: F64, most: int) -> F64:
    """The first of each neighbourhood of 15 degrees among unit vectors (n, 3), ``most`` at most."""
    kept: list[F64] = []
    for direction in directions[: 20 * most]:
        if all(direction @ other < np.cos(np.deg2rad(15.0)) for other in kept):
            kept.append(direction)
        if len(kept) == most:
            break
    return np.array(kept)
