"""Extended Denavit-Hartenberg placements (paper eq. 5 and 7), with Hayati's form near parallel.

A placement is ``Rz(theta0) Tz(d) Tx(a) Rx(alpha)`` followed by one of two extensions:

* the paper's ``Rz(theta_acc) Tz(d_acc)`` (eq. 7), or
* ``Ry(beta) Ty(b)`` where the two z axes are nearly parallel. There the common normal, and
  with it ``d`` and ``d_acc``, runs off to infinity, and a small turn of an axis is no longer a
  small change of the numbers (Hayati & Mirmirani, J. Robotic Systems 2(4), 1985).

Either way six numbers, exact for any rigid placement. A joint needs four of them, because its
frame may be turned about and slid along its own axis without changing the robot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.geometry.se3 import inverse, screw

PARALLEL_SINE = 0.05
"""Below this sine of the angle between two z axes (about 3 deg) they count as nearly parallel.

The paper's offsets are then at most 20 times the distance between the frames.
"""

_COINCIDENT = 1e-12
"""Axes closer than this [m] intersect: the sign of ``a`` and its direction mean nothing there."""


@dataclass(frozen=True, eq=False)
class ExtendedDh(Record):
    """Extended DH numbers of placements; all arrays share one shape (...).

    Attributes:
        theta0: (...) turn about the parent's z axis [rad].
        d: (...) shift along the parent's z axis [m].
        a: (...) shift along the turned x axis [m].
        alpha: (...) turn about that x axis, from the parent's z axis to the child's [rad].
        turn: (...) turn of the extension [rad]: ``theta_acc`` about z, or ``beta`` about y.
        shift: (...) shift of the extension [m]: ``d_acc`` along z, or ``b`` along y.
        hayati: (...) True where the extension is Hayati's ``Ry(beta) Ty(b)``, False where it is
            the paper's ``Rz(theta_acc) Tz(d_acc)``.
    """

    theta0: F64
    d: F64
    a: F64
    alpha: F64
    turn: F64
    shift: F64
    hayati: Bool

    def placement(self) -> F64:
        """The (..., 4, 4) placements T_parent_child these numbers stand for."""
        extension = np.where(
            self.hayati[..., None, None],
            screw("y", self.turn, self.shift),
            screw("z", self.turn, self.shift),
        )
        return screw("z", self.theta0, self.d) @ screw("x", self.alpha, self.a) @ extension


def dh_of_placement(T_parent_child: F64, parallel_sine: float = PARALLEL_SINE) -> ExtendedDh:
    """Extended DH numbers of any rigid placement, exactly.

    In the paper's form ``a >= 0`` (the bounds of eq. 18) and alpha lies in (-pi, pi]; axes that
    intersect have alpha in [0, pi]. In Hayati's form the frame's own orientation fixes the
    direction of ``a``, which is therefore signed; ``|beta| <= pi/2``, so that parallel axes read
    alpha near 0 and anti-parallel ones alpha near pi.

    Args:
        T_parent_child: (..., 4, 4) rigid placements.
        parallel_sine: sine of the angle between the z axes below which Hayati's form is used.

    Returns:
        Numbers of shape (...) whose ``placement()`` is ``T_parent_child``.
    """
    T = np.asarray(T_parent_child, float)
    hayati = _nearly_parallel(T, parallel_sine)
    return _choose(hayati, _hayati_of_placement(T), _paper_of_placement(T, hayati))


def joint_placement(
    T_parent_joint: F64, parallel_sine: float = PARALLEL_SINE
) -> tuple[ExtendedDh, F64]:
    """The canonical frame on the same joint axis, described by four numbers.

    The four are (theta0, d, a, alpha) with the extension 0 [paper eq. 5] or, for nearly parallel
    axes, (theta0, a, alpha, beta) with ``d = b = 0``; always ``a >= 0``. The origin is the foot of
    the common normal on the child's axis, or where that axis pierces the parent's xy plane.

    Args:
        T_parent_joint: (..., 4, 4) placements of joints that turn about their z axis.
        parallel_sine: see :func:`dh_of_placement`.

    Returns:
        The canonical numbers, and (..., 4, 4) the residual ``T_canonical_given``, a screw about z.
        It commutes with the joint's own motion, so that left-multiplying it onto all that the
        joint carries leaves the robot as it was.
    """
    T = np.asarray(T_parent_joint, float)
    hayati = _nearly_parallel(T, parallel_sine)
    paper = _paper_of_placement(T, hayati)
    zero = np.zeros_like(paper.turn)
    paper = replace(paper, turn=zero, shift=zero)
    canonical = _choose(hayati, _hayati_of_axis(T), paper)
    return canonical, inverse(canonical.placement()) @ T


def prismatic_placement(
    T_parent_joint: F64, parallel_sine: float = PARALLEL_SINE
) -> tuple[ExtendedDh, F64]:
    """The canonical frame of a prismatic joint: only the direction of its axis matters.

    Its origin is put onto the parent's, so ``a = d = 0``.

    Args:
        T_parent_joint: (..., 4, 4) placements of joints that slide along their z axis.
        parallel_sine: see :func:`dh_of_placement`.

    Returns:
        As :func:`joint_placement`; the residual is a turn about z and any translation, which
        also commutes with the joint's motion.
    """
    T = np.asarray(T_parent_joint, float)
    at_parent = T.copy()
    at_parent[..., :3, 3] = 0.0
    canonical, _ = joint_placement(at_parent, parallel_sine)
    return canonical, inverse(canonical.placement()) @ T


def _nearly_parallel(T: F64, parallel_sine: float) -> Bool:
    """(...) True where the z axes of parent and child are parallel or anti-parallel, nearly."""
    return np.asarray(np.hypot(T[..., 0, 2], T[..., 1, 2]) < parallel_sine)


def _choose(hayati: Bool, yes: ExtendedDh, no: ExtendedDh) -> ExtendedDh:
    """Take ``yes`` where ``hayati`` holds, ``no`` elsewhere."""
    names = ("theta0", "d", "a", "alpha", "turn", "shift")
    picked = {n: np.where(hayati, getattr(yes, n), getattr(no, n)) for n in names}
    return ExtendedDh(**picked, hayati=hayati)


def _paper_of_placement(T: F64, undefined: Bool) -> ExtendedDh:
    """Numbers of eq. 5 and 7 by the common normal; meaningless (but finite) where ``undefined``."""
    z, p = T[..., :3, 2], T[..., :3, 3]
    sine = np.where(undefined, 1.0, np.hypot(z[..., 0], z[..., 1]))
    normal = np.stack([-z[..., 1], z[..., 0]], axis=-1) / sine[..., None]
    a = np.sum(normal * p[..., :2], axis=-1)
    sign = np.where(a < -_COINCIDENT, -1.0, 1.0)
    theta0 = np.arctan2(sign * normal[..., 1], sign * normal[..., 0])
    alpha = sign * np.arctan2(sine, z[..., 2])
    across = (z[..., 0] * p[..., 0] + z[..., 1] * p[..., 1]) / sine
    d_acc = across / sine
    d = p[..., 2] - z[..., 2] * d_acc
    R = np.swapaxes((screw("z", theta0, 0.0) @ screw("x", alpha, 0.0))[..., :3, :3], -1, -2)
    R = R @ T[..., :3, :3]
    theta_acc = np.arctan2(R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1])
    return ExtendedDh(theta0, d, sign * a, alpha, theta_acc, d_acc, np.zeros_like(a, dtype=bool))


def _hayati_of_placement(T: F64) -> ExtendedDh:
    """Numbers of Hayati's form for a full placement (Cardan angles Rz Rx Ry)."""
    R, p = T[..., :3, :3], T[..., :3, 3]
    sign = np.where(R[..., 2, 2] < 0.0, -1.0, 1.0)
    # Both (theta0, alpha, beta) and (theta0 + pi, pi - alpha, beta + pi) are solutions: take the
    # one with |beta| <= pi/2, i.e. cos(alpha) with the sign of z_parent . z_child.
    beta = np.arctan2(-sign * R[..., 2, 0], sign * R[..., 2, 2])
    alpha = np.arctan2(R[..., 2, 1], sign * np.hypot(R[..., 0, 1], R[..., 1, 1]))
    theta0 = np.arctan2(-sign * R[..., 0, 1], sign * R[..., 1, 1])
    cos, sin = np.cos(theta0), np.sin(theta0)
    a = cos * p[..., 0] + sin * p[..., 1]
    # Away from parallel cos(alpha) may vanish; the caller does not use those entries.
    cos_alpha = np.cos(alpha)
    cos_alpha = np.where(cos_alpha == 0.0, 1.0, cos_alpha)
    b = (cos * p[..., 1] - sin * p[..., 0]) / cos_alpha
    d = p[..., 2] - b * np.sin(alpha)
    return ExtendedDh(theta0, d, a, alpha, beta, b, np.ones_like(a, dtype=bool))


def _hayati_of_axis(T: F64) -> ExtendedDh:
    """Hayati's four numbers of an axis: where it pierces the parent's xy plane, and its tilt."""
    z, p = T[..., :3, 2], T[..., :3, 3]
    z_z = np.where(z[..., 2] == 0.0, 1.0, z[..., 2])  # perpendicular axes never use this form
    pierce = p[..., :2] - z[..., :2] * (p[..., 2] / z_z)[..., None]
    a = np.hypot(pierce[..., 0], pierce[..., 1])
    theta0 = np.where(a > _COINCIDENT, np.arctan2(pierce[..., 1], pierce[..., 0]), 0.0)
    cos, sin = np.cos(theta0), np.sin(theta0)
    # Where theta0 was set to 0 the offset along that x axis keeps the axis where it is.
    a = np.where(a > _COINCIDENT, a, pierce[..., 0])
    beta = np.arcsin(np.clip(cos * z[..., 0] + sin * z[..., 1], -1.0, 1.0))
    alpha = np.arctan2(sin * z[..., 0] - cos * z[..., 1], z[..., 2])
    zero = np.zeros_like(a)
    return ExtendedDh(theta0, zero, a, alpha, beta, zero, np.ones_like(a, dtype=bool))
