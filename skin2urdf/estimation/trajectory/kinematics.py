"""Specific force along a trajectory, and what it owes to every placement and every joint.

A placement k divides the robot in two: what lies before it moves as it does, and the SU moves
relative to the frame k in which the placement is written. In that frame, with the angular velocity
w and acceleration a of the frame, the specific force f at its origin, and the SU's path r(t),

    F = f + a x r + w x (w x r) + 2 w x r' + r''

is the specific force at the SU. A constant turn phi and shift t of all that lies beyond the
placement moves the path to ``r + phi x r + t``, so that, seen by an SU that turns along,

    dF = A (phi x r + t) + 2 w x (phi x r') + phi x r'' - phi x F,    A = a x + w x w x

which is exact to first order. A joint that turns by a small angle e(t) beyond what its encoder says
changes the path by ``e z x r``, and with its derivatives e', e'' the specific force by

    dF = s e + (2 w x (z x r) + 2 z x r') e' + (z x r) e''

where s is that of a constant turn about its axis z (the pattern's s_d and tau_d at any moment).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.points import shared_points
from skin2urdf.geometry.so3 import force_per_position
from skin2urdf.structure.records import KinematicTree

# Vectors along a trajectory are (3, K): samples last, where NumPy is fastest.


@dataclass(frozen=True, eq=False)
class FrameMotion:
    """Motion of a frame along K samples, in that frame.

    Attributes:
        w: (3, K) angular velocity [rad/s].
        a: (3, K) angular acceleration [rad/s^2].
        f: (3, K) specific force at its origin [m/s^2].
        R_frame_base: (3, 3, K) its orientation.
    """

    w: F64
    a: F64
    f: F64
    R_frame_base: F64

    @cached_property
    def A(self) -> F64:
        """(3, 3, K) specific force per position of a point that moves along [1/s^2]."""
        return force_per_position(self.w, self.a)


@dataclass(frozen=True, eq=False)
class Path:
    """Path of an SU relative to a frame, in that frame.

    Attributes:
        r: (3, K) position [m], velocity [m/s] and acceleration [m/s^2].
        rd: (3, K).
        rdd: (3, K).
        R_frame_su: (3, 3, K) orientation of the SU.
    """

    r: F64
    rd: F64
    rdd: F64
    R_frame_su: F64


def cross(a: F64, b: F64) -> F64:
    """(3, K) cross product of (3, K) or (3, 1) vectors."""
    x = a[1] * b[2] - a[2] * b[1]
    out = np.empty((3, *x.shape))
    out[0], out[1], out[2] = x, a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return out


def base_motion(up: F64, n: int) -> FrameMotion:
    """Motion of the base along n samples.

    Args:
        up: (3,) specific force of a resting body in the base frame [m/s^2].
        n: number of samples K.
    """
    zero = np.zeros((3, n))
    R = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, n))
    return FrameMotion(zero, zero, np.repeat(up[:, None], n, axis=1), R)


def placed(motion: FrameMotion, T: F64) -> FrameMotion:
    """Motion of a frame that is fixed to another one by a placement T (4, 4)."""
    Rt, arm = T[:3, :3].T, T[:3, 3, None]
    w, a = motion.w, motion.a
    f = motion.f + cross(a, arm) + w * (arm * w).sum(axis=0) - arm * (w * w).sum(axis=0)
    R = np.tensordot(Rt, motion.R_frame_base, 1)
    return FrameMotion(Rt @ w, Rt @ a, Rt @ f, R)


def beyond_joint(motion: FrameMotion, slides: bool, q: F64, qd: F64, qdd: F64) -> FrameMotion:
    """Motion of the frame that a joint carries, from that of the frame it is placed in.

    Args:
        motion: of the frame at position 0.
        slides: True for a prismatic joint.
        q: (K,) position, and
        qd: (K,) velocity, and
        qdd: (K,) acceleration along or about the joint's z axis.
    """
    w, a, f, R = motion.w, motion.a, motion.f, motion.R_frame_base
    if slides:
        along = np.zeros_like(f)
        along[2] = q
        speed = np.zeros_like(f)
        speed[2] = qd
        moved = f + cross(a, along) + cross(w, cross(w, along)) + 2 * cross(w, speed)
        moved[2] += qdd
        return FrameMotion(w, a, moved, R)
    c, s = np.cos(q), np.sin(q)

    def turned(x: F64) -> F64:
        out = np.empty_like(x)
        out[0], out[1], out[2] = c * x[0] + s * x[1], c * x[1] - s * x[0], x[2]
        return out

    w_new, a_new = turned(w), turned(a)
    a_new[0] += w_new[1] * qd
    a_new[1] -= w_new[0] * qd
    a_new[2] += qdd
    w_new[2] += qd
    return FrameMotion(w_new, a_new, turned(f), turned(R))


def seen_before_joint(path: Path, slides: bool, q: F64, qd: F64, qdd: F64) -> Path:
    """A path relative to the frame that a joint carries, seen from the frame it is placed in.

    Args:
        path: relative to the carried frame.
        slides: True for a prismatic joint.
        q: (K,) position, velocity and acceleration of the joint.
        qd: (K,).
        qdd: (K,).
    """
    r, rd, rdd = path.r, path.rd, path.rdd
    if slides:
        along = np.array([[0.0], [0.0], [1.0]])
        return Path(r + along * q, rd + along * qd, rdd + along * qdd, path.R_frame_su)
    c, s = np.cos(q), np.sin(q)

    def turned(x: F64) -> F64:
        out = np.empty_like(x)
        out[0], out[1], out[2] = c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]
        return out

    # z x r = (-y, x, 0) and z x (z x r) = -(x, y, 0).
    speed, acceleration = np.array(rd), np.array(rdd)
    speed[0] -= qd * r[1]
    speed[1] += qd * r[0]
    acceleration[0] -= 2 * qd * rd[1] + qdd * r[1] + qd * qd * r[0]
    acceleration[1] += 2 * qd * rd[0] + qdd * r[0] - qd * qd * r[1]
    return Path(turned(r), turned(speed), turned(acceleration), turned(path.R_frame_su))


def seen_from_parent(path: Path, T: F64) -> Path:
    """A path relative to a placed frame, seen from the frame it is placed in by T (4, 4)."""
    R = T[:3, :3]
    return Path(
        R @ path.r + T[:3, 3, None],
        R @ path.rd,
        R @ path.rdd,
        np.tensordot(R, path.R_frame_su, 1),
    )


def placement_columns(motion: FrameMotion, path: Path, axes: tuple[int, ...]) -> F64:
    """What an SU reads per shift and turn of all that lies beyond a frame.

    Args:
        motion: of the frame.
        path: of the SU relative to it.
        axes: which of the frame's tx, ty, tz, rx, ry, rz.

    Returns:
        (len(axes), 3, K) in the SU's frame [m/s^2 per m or rad].
    """
    A, w, r, rd = motion.A, motion.w, path.r, path.rd
    out = np.empty((len(axes), 3, r.shape[1]))
    if max(axes) >= 3:
        along = 2 * (w * rd).sum(axis=0)
        # r'' - F, where r'' is a part of F.
        rest = -motion.f - (A[:, 0] * r[0] + A[:, 1] * r[1] + A[:, 2] * r[2]) - 2 * cross(w, rd)
    for column, axis in zip(out, axes, strict=True):
        if axis < 3:
            column[:] = A[:, axis]
            continue
        # Of a turn about unit axis i, i x x is a permutation of x, and w x (i x x) is
        # i (w . x) - x w_i.
        i = axis - 3
        j, k = (i + 1) % 3, (i + 2) % 3
        column[:] = A[:, k] * r[j] - A[:, j] * r[k] - 2 * w[i] * rd
        column[i] += along
        column[j] -= rest[k]
        column[k] += rest[j]
    return in_su(path.R_frame_su, out)


def joint_columns(motion: FrameMotion, path: Path, slides: bool) -> F64:
    """What an SU reads per motion of a joint that its encoder does not see.

    Args:
        motion: of the frame in which the joint is placed.
        path: of the SU relative to it.
        slides: True for a prismatic joint.

    Returns:
        (3, 3, K): per position, velocity and acceleration, in the SU's frame.
    """
    z = np.array([[0.0], [0.0], [1.0]])
    s = placement_columns(motion, path, (2,) if slides else (5,))
    if slides:
        speed, push = 2 * cross(motion.w, z), np.broadcast_to(z, path.r.shape)
    else:
        push = cross(z, path.r)
        speed = 2 * cross(motion.w, push) + 2 * cross(z, path.rd)
    return np.concatenate([s, in_su(path.R_frame_su, np.stack([speed, push]))], dtype=np.float64)


def in_su(R_frame_su: F64, x: F64) -> F64:
    """(n, 3, K) vectors of a frame in the SU's frame, by R_frame_su (3, 3, K)."""
    out = np.empty(x.shape)
    for i in range(3):
        np.multiply(R_frame_su[0, i], x[:, 0], out=out[:, i])
        out[:, i] += R_frame_su[1, i] * x[:, 1]
        out[:, i] += R_frame_su[2, i] * x[:, 2]
    return out


def frame_motions(
    tree: KinematicTree, T_parent_joint: F64, up: F64, q: F64, qd: F64, qdd: F64
) -> tuple[list[FrameMotion], list[FrameMotion]]:
    """Motion of all joints' frames along a trajectory.

    Args:
        tree: the structure.
        T_parent_joint: (D, 4, 4) joint placements.
        up: (3,) specific force of a resting body in the base frame [m/s^2].
        q: (D, K) positions, velocities and accelerations.
        qd: (D, K).
        qdd: (D, K).

    Returns:
        Motion of the frames in which the D joints are placed, and of those that they carry
        (D + 1, the last one that of the base, which index -1 names).
    """
    fixed: list[FrameMotion] = []
    carried: list[FrameMotion] = []
    base = base_motion(up, q.shape[1])
    for j in range(tree.n_joints):
        p = int(tree.parent[j])
        fixed.append(placed(carried[p] if p >= 0 else base, T_parent_joint[j]))
        carried.append(beyond_joint(fixed[j], bool(tree.prismatic[j]), q[j], qd[j], qdd[j]))
    return fixed, [*carried, base]


def levers(tree: KinematicTree, places: State) -> F64:
    """(U, D) upper bounds of what SUs feel of the acceleration of joints [m]; 1 where one slides.

    It is the distance from the axis of an SU's own joint, and the length of the links from others.

    Args:
        tree: D joints and U SUs.
        places: where they are.
    """
    length = np.linalg.norm(places.T_parent_joint[:, :3, 3], axis=1)
    out = np.zeros((tree.n_sus, tree.n_joints))
    for joint in np.unique(tree.su_joint).tolist():
        sus = np.flatnonzero(tree.su_joint == joint)
        own = np.linalg.norm(places.T_joint_su[sus, :2, 3], axis=1)
        arm = np.linalg.norm(places.T_joint_su[sus, :3, 3], axis=1)
        for d in reversed(tree.chain(joint)):
            out[sus, d] = 1.0 if tree.prismatic[d] else own if d == joint else arm
            arm = arm + length[d]
    return out


def felt_of_joints(tree: KinematicTree, places: State, q: F64) -> F64:
    """(U, D, K) square of what SUs feel of accelerations of joints at positions (K, D).

    Of a joint that turns that is the distance from its axis [m^2], of one that slides 1; 0 of one
    that does not carry the SU. Where a link's points are tells where all SUs on it are.

    Args:
        tree: D joints and U SUs.
        places: where they are.
        q: positions [rad or m].
    """
    out = np.zeros((tree.n_sus, tree.n_joints, len(q)))
    for link in shared_points(tree.su_joint, places.T_joint_su):
        at = np.tile(link.arms[:, None], (1, len(q), 1))
        for d in reversed(tree.chain(link.joint)):
            if tree.prismatic[d]:
                out[link.sus, d] = 1.0
                at[:, :, 2] += q[:, d]
            else:
                x, y = at[:, :, 0].copy(), at[:, :, 1].copy()
                out[link.sus, d] = (link.shares @ x) ** 2 + (link.shares @ y) ** 2
                c, s = np.cos(q[:, d]), np.sin(q[:, d])
                at[:, :, 0], at[:, :, 1] = c * x - s * y, s * x + c * y
            T = places.T_parent_joint[d]
            at = at @ T[:3, :3].T + T[:3, 3]
    return out
