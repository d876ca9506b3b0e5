"""One rigid transform between two base frames, from the poses of the same SUs in both."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.geometry import se3
from skin2urdf.geometry.se3 import inverse
from skin2urdf.urdf.descent import descended

ARM = 0.1
"""Lever arm that makes lengths of angles [m/rad]: 1 deg weighs as much as 1.75 mm."""

_SCALE = np.array([1.0, 1.0, 1.0, ARM, ARM, ARM])
_MAX_STEPS = 30


def align(
    T_est_su: F64, T_true_su: F64, free: list[F64], anchors: Bool | None = None
) -> tuple[F64, F64]:
    """Fit base frames onto each other, with SUs free to move where the log can not see them.

    Minimises, over the transform X = T_true_est of the base frames and one displacement D_u per
    SU, the sum over configurations and SUs of ``|log((X T_est_su D_u)^-1 T_true_su)|^2``, the
    angular part weighed by :data:`ARM`. D_u moves the SU in its own frame along its free
    directions only; those then count neither here nor for the errors that remain.

    Args:
        T_est_su: (N, U, 4, 4) SU poses in the estimate's base, N configurations, U SUs.
        T_true_su: (N, U, 4, 4) the same SUs at the same configurations in the true base.
        free: U arrays (k, 6), k from 0 to 5: twists in the SU's own frame, linear part [m] first,
            angular part [rad] times :data:`ARM`; rows need not be orthonormal.
        anchors: (U,) the SUs that X is fitted to, at least one; all of them where not given. The
            others are displaced only.

    Returns:
        (4, 4) X = T_true_est and (U, 4, 4) D = T_su_moved, displacements of the SUs.
    """
    on = np.ones(len(free), dtype=bool) if anchors is None else anchors
    P = np.stack([projector(directions) for directions in free])
    D = np.empty((len(free), 4, 4))
    X, D[on] = _fit(T_est_su[:, on], T_true_su[:, on], P[on])
    D[~on] = displace(X @ T_est_su[:, ~on], T_true_su[:, ~on], P[~on])
    return X, D


def _fit(T_est_su: F64, T_true_su: F64, P: F64) -> tuple[F64, F64]:
    """X and D of :func:`align` over all given SUs, whose projectors are P (U, 6, 6).

    Gauss-Newton with the displacements eliminated: the cost is linear in the number of SUs.
    """
    fits = [_from(X, T_est_su, T_true_su, P) for X in starts(T_est_su, T_true_su, P)]
    _, X, D = min(fits, key=lambda fit: fit[0])
    return X, D


def starts(T_est_su: F64, T_true_su: F64, P: F64) -> list[F64]:
    """First transforms X of :func:`align`, of which the one that leads to the better fit lasts.

    Places that are free by decimetres turn everything where they count, so that where all SUs are
    free to move it begins from their orientations as well.

    Args:
        T_est_su: (N, U, 4, 4) SU poses in the estimate's base.
        T_true_su: (N, U, 4, 4) the same SUs at the same configurations in the true base.
        P: (U, 6, 6) projectors onto each SU's free directions.
    """
    ranks = np.array([np.linalg.matrix_rank(p) for p in P])
    firm = ranks == ranks.min()
    begun = [kabsch(T_est_su[:, firm], T_true_su[:, firm])]
    if ranks.min() > 0:
        begun.append(kabsch(_turned(T_est_su[:, firm]), _turned(T_true_su[:, firm])))
    return begun


def _turned(T: F64) -> F64:
    """Frames as they are turned, all in one place."""
    R = np.array(T)
    R[..., :3, 3] = 0.0
    return R


def _from(X: F64, T_est_su: F64, T_true_su: F64, P: F64) -> tuple[float, F64, F64]:
    """Cost, X and D where Gauss-Newton ends from a first X.

    SUs that are all free along about the same axis leave X nearly free along it as well.
    """

    def left(here: tuple[F64, F64]) -> F64:
        X, D = here
        return np.asarray(se3.log(inverse(X @ T_est_su @ D) @ T_true_su) * _SCALE)

    def linear(here: tuple[F64, F64], r: F64) -> tuple[F64, Callable[[F64], tuple[F64, F64]]]:
        X, D = here
        A = _SCALE[:, None] * se3.adjoint(inverse(T_est_su @ D))

        def moved(step: F64) -> tuple[F64, F64]:
            return X @ se3.exp(step), D @ _displacement(P, (r - A @ step).mean(axis=0))

        # What a displacement takes up is the mean along its directions. It is projected out of A,
        # and thereby out of r: the rest is orthogonal to it.
        return (A - P @ A.mean(axis=0)).reshape(-1, 6), moved

    begin = X, _first_displacements(X @ T_est_su, T_true_su, P)
    (X, D), cost = descended(begin, left, linear)
    return cost, X, D


def displace(T_est_su: F64, T_true_su: F64, P: F64) -> F64:
    """(U, 4, 4) displacements along free directions that fit each SU best; bases coincide.

    Args:
        T_est_su: (N, U, 4, 4) SU poses of the estimate.
        T_true_su: (N, U, 4, 4) true SU poses in the same base frame.
        P: (U, 6, 6) projectors onto each SU's free directions, see :func:`align`.
    """
    best = _first_displacements(T_est_su, T_true_su, P)
    if not P.any():
        return best
    best_cost = np.full(len(P), np.inf)
    D = best
    for _ in range(_MAX_STEPS):
        r = se3.log(inverse(T_est_su @ D) @ T_true_su) * _SCALE
        cost = np.sum(r**2, axis=(0, 2))
        better = cost < best_cost
        if not better.any():
            break
        best = np.where(better[:, None, None], D, best)
        best_cost = np.minimum(cost, best_cost)
        D = best @ _displacement(P, r.mean(axis=0))
    return best


def kabsch(T_est_su: F64, T_true_su: F64) -> F64:
    """Closed-form (4, 4) transform T_true_est that maps frames onto frames (..., 4, 4).

    Each frame stands for its origin and the tips of its axes at such a length that a small turn
    by an angle weighs as much as a shift by :data:`ARM` times the angle (Kabsch 1976, Umeyama
    1991).
    """
    est, true = (_points(T.reshape(-1, 4, 4)) for T in (T_est_su, T_true_su))
    origin, tips = slice(0, 1), slice(1, 4)
    centre_est, centre_true = est[:, origin].mean(axis=(0, 1)), true[:, origin].mean(axis=(0, 1))
    H = np.einsum("nki,nkj->ij", est[:, origin] - centre_est, true[:, origin] - centre_true)
    H = H + np.einsum("nki,nkj->ij", est[:, tips], true[:, tips])
    U, _, Vt = np.linalg.svd(H)
    sign = np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)])
    T = np.eye(4)
    T[:3, :3] = Vt.T @ sign @ U.T
    T[:3, 3] = centre_true - T[:3, :3] @ centre_est
    return T


def _points(T: F64) -> F64:
    """(n, 4, 3): the origins [m] and the scaled axes of frames (n, 4, 4)."""
    axes = np.swapaxes(T[:, :3, :3], 1, 2) * (ARM / np.sqrt(2.0))
    return np.concatenate([T[:, None, :3, 3], axes], axis=1)


def projector(directions: F64) -> F64:
    """(6, 6) orthogonal projector onto the row space of ``directions`` (k, 6)."""
    if not len(directions):
        return np.zeros((6, 6))
    return np.asarray(np.linalg.pinv(directions, rcond=1e-9) @ directions)


def _first_displacements(T_est_su: F64, T_true_su: F64, P: F64) -> F64:
    """(U, 4, 4) displacements to start from: the best of a few guesses for each SU.

    A displacement near half a turn reads as +pi at some configurations and as -pi at others, so
    a mean over them means nothing. One configuration is followed either way round instead.
    """
    if not P.any():  # as of most robots: no SU may be displaced
        return np.tile(np.eye(4), (len(P), 1, 1))
    error = inverse(T_est_su[0]) @ T_true_su[0]
    ways = [se3.log(error, long_way=long_way) * _SCALE for long_way in (False, True)]
    guesses = [_displacement(P, way) for way in (np.zeros_like(ways[0]), *ways)]
    left = [se3.log(inverse(T_est_su @ D) @ T_true_su) * _SCALE for D in guesses]
    best = np.argmin([np.sum(r**2, axis=(0, 2)) for r in left], axis=0)
    return np.asarray(np.stack(guesses)[best, np.arange(len(P))])


def _displacement(P: F64, error: F64) -> F64:
    """(U, 4, 4) displacements along the part of scaled twists (U, 6) that P (U, 6, 6) keeps."""
    return se3.exp(np.einsum("uij,uj->ui", P, error) / _SCALE)
