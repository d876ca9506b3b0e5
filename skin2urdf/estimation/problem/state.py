"""What is estimated: placements, gravity per log, sensor intrinsics; and local steps on them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.geometry.se3 import exp, placement
from skin2urdf.geometry.so3 import left_jacobian, rotation_exp
from skin2urdf.model.records import KinematicModel
from skin2urdf.structure.records import KinematicTree

JOINT_COORDINATES = (0, 1, 3, 4)
"""Coordinates of a joint placement that move its axis: tx, ty, rx, ry.

Turning a joint's frame about its axis or sliding it along is a gauge freedom; four numbers are
what extended DH has (paper eq. 5), without its singularity at parallel axes.
"""
N_JOINT, N_PLACEMENT, N_INTRINSIC = 4, 6, 9
N_SU = N_PLACEMENT + N_INTRINSIC

_SHAPE_INDEX = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@dataclass(frozen=True, eq=False)
class State(Record):
    """A full set of estimated quantities.

    An SU reads ``M f + bias`` where f is the specific force and M = I + symmetric ``shape``: the
    antisymmetric part of a sensor's cross-axis error is a rotation of its frame.

    Attributes:
        T_parent_joint: (D, 4, 4) joint placements.
        T_joint_su: (U, 4, 4) SU placements.
        up: (G, 3) unit vector opposite to gravity in the base frame, per log; the first is z.
        bias: (U, 3) [m/s^2].
        shape: (U, 6) scale errors xx, yy, zz and cross-axis yz, xz, xy [1].
    """

    T_parent_joint: F64
    T_joint_su: F64
    up: F64
    bias: F64
    shape: F64

    def model(self, tree: KinematicTree) -> KinematicModel:
        """The placements as a kinematic model."""
        return KinematicModel(tree, self.T_parent_joint, self.T_joint_su)

    def sensor_matrix(self) -> F64:
        """(U, 3, 3) symmetric matrices M."""
        return sensor_matrices(self.shape)


def sensor_matrices(shape: F64) -> F64:
    """(..., 3, 3) symmetric matrices M of scale and cross-axis errors (..., 6)."""
    M = np.zeros((*shape.shape[:-1], 3, 3))
    for i, (a, b) in enumerate(_SHAPE_INDEX):
        M[..., a, b] = M[..., b, a] = shape[..., i]
    return M + np.eye(3)


@dataclass(frozen=True, eq=False)
class Step:
    """Local coordinates around a state, also used for gradients and masks.

    Attributes:
        joints: (D, 4) tx, ty [m], rx, ry [rad] of each joint placement.
        logs: (G - 1, 2) turn of ``up`` about the base x and y axes [rad], from the second log on.
        sus: (U, 15) tx, ty, tz [m], rx, ry, rz [rad], bias [m/s^2], shape [1].
    """

    joints: F64
    logs: F64
    sus: F64

    def flat(self) -> F64:
        """All coordinates in one vector, joints first."""
        return np.concatenate([self.joints.ravel(), self.logs.ravel(), self.sus.ravel()])

    def like(self, flat: F64) -> Step:
        """Coordinates from one vector, shaped as these."""
        a = self.joints.size
        b = a + self.logs.size
        return Step(
            flat[:a].reshape(self.joints.shape),
            flat[a:b].reshape(self.logs.shape),
            flat[b:].reshape(self.sus.shape),
        )


def local_motion(x: F64) -> tuple[F64, F64]:
    """Transform and body twists of local placement coordinates.

    Args:
        x: (..., 6) tx, ty, tz, rx, ry, rz.

    Returns:
        ``Trans(t) Rx Ry Rz`` (..., 4, 4) and the twists (..., 6, 6) of the six coordinates
        (columns; rows linear, angular) seen in the frame it leads to.
    """
    c, s = np.cos(x[..., 3:]), np.sin(x[..., 3:])
    zero, one = np.zeros(x.shape[:-1]), np.ones(x.shape[:-1])

    def matrix(*rows: F64) -> F64:
        return np.stack(rows, axis=-1).reshape(*x.shape[:-1], 3, 3)

    Rx = matrix(one, zero, zero, zero, c[..., 0], -s[..., 0], zero, s[..., 0], c[..., 0])
    Ry = matrix(c[..., 1], zero, s[..., 1], zero, one, zero, -s[..., 1], zero, c[..., 1])
    Rz = matrix(c[..., 2], -s[..., 2], zero, s[..., 2], c[..., 2], zero, zero, zero, one)
    Ryz = Ry @ Rz
    R = Rx @ Ryz
    twists = np.zeros((*x.shape[:-1], 6, 6))
    twists[..., :3, :3] = np.swapaxes(R, -1, -2)
    twists[..., 3:, 3] = Ryz[..., 0, :]
    twists[..., 3:, 4] = Rz[..., 1, :]
    twists[..., 3:, 5] = (0.0, 0.0, 1.0)
    return placement(R, x[..., :3]), twists


def joint_motion(x: F64) -> tuple[F64, F64]:
    """Transforms (D, 4, 4) and twists (D, 6, 4) of joint coordinates x (D, 4)."""
    full = np.zeros((x.shape[0], 6))
    full[:, JOINT_COORDINATES] = x
    T, twists = local_motion(full)
    return T, twists[..., JOINT_COORDINATES]


def turned_up(up: F64, x: F64) -> F64:
    """``up`` (G, 3) with the second and later logs turned by x (G - 1, 2) about base x and y."""
    if not x.size:
        return up
    out = np.array(up)
    w = np.concatenate([x, np.zeros((len(x), 1))], axis=1)
    out[1:] = (rotation_exp(w) @ up[1:, :, None])[..., 0]
    return out


def turn_basis(x: F64) -> F64:
    """(G - 1, 3, 2) turns in the base frame per unit of the coordinates x of :func:`turned_up`."""
    w = np.concatenate([x, np.zeros((len(x), 1))], axis=1)
    return left_jacobian(w)[..., :2]


def moved(state: State, step: Step) -> State:
    """The state reached from ``state`` by a step."""
    T_joint, _ = joint_motion(step.joints)
    T_su, _ = local_motion(step.sus[:, :N_PLACEMENT])
    return replace(
        state,
        T_parent_joint=state.T_parent_joint @ T_joint,
        T_joint_su=state.T_joint_su @ T_su,
        up=turned_up(state.up, step.logs),
        bias=state.bias + step.sus[:, 6:9],
        shape=state.shape + step.sus[:, 9:15],
    )


def screwed(state: State, step: Step) -> State:
    """The state reached by a step, placements moving along screws ``T exp(step)``.

    To first order the same as :func:`moved`. Turning about a distant axis is one straight path this
    way: an SU can go round a vertical axis, which hardly changes its readings.
    """
    joints = np.zeros((len(step.joints), N_PLACEMENT))
    joints[:, JOINT_COORDINATES] = step.joints
    return replace(
        state,
        T_parent_joint=state.T_parent_joint @ exp(joints),
        T_joint_su=state.T_joint_su @ exp(step.sus[:, :N_PLACEMENT]),
        up=turned_up(state.up, step.logs),
        bias=state.bias + step.sus[:, N_PLACEMENT : N_PLACEMENT + 3],
        shape=state.shape + step.sus[:, N_PLACEMENT + 3 :],
    )


@dataclass(frozen=True, eq=False)
class Free:
    """Which coordinates may move; arrays of the shapes of :class:`Step`.

    Attributes:
        joints: (D, 4).
        logs: (G - 1, 2).
        sus: (U, 15).
    """

    joints: Bool
    logs: Bool
    sus: Bool


def identifiable(tree: KinematicTree, n_logs: int, intrinsics: bool = True) -> Free:
    """Coordinates that accelerometers can see in principle (paper II-C.5).

    Left out are positions of axes and SUs relative to the RS or to what only slides on it, the
    position of a prismatic joint's axis, and, where ``intrinsics`` is False, bias and shape of
    the SUs.
    """
    slides = tree.prismatic
    turns = np.array([not slides[list(tree.chain(j))].all() for j in range(-1, tree.n_joints)])
    joints = np.ones((tree.n_joints, N_JOINT), dtype=bool)
    joints[~turns[tree.parent + 1] | slides, :2] = False
    sus = np.ones((tree.n_sus, N_SU), dtype=bool)
    sus[~turns[tree.su_joint + 1], :3] = False
    sus[:, N_PLACEMENT:] = intrinsics
    return Free(joints, np.ones((max(0, n_logs - 1), 2), dtype=bool), sus)
