"""Small vectorised pieces of rigid-body algebra; every function works on leading axes."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64


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

    flat = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(flat.reshape(R.shape[:-1]))


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
