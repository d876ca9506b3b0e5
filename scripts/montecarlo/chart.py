"""The truth in the coordinates of an estimate.

The estimation's coordinates (:class:`skin2urdf.estimation.problem.state.Step`) are displacements of
each estimated frame. The truth is the displacement that leads from the estimate to the true robot;
what no log can know (yaw and origin of the base, where along and how turned about its axis a
joint's frame lies) is taken over from the estimate on the way from the base outwards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import polar

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import N_JOINT, State, Step, joint_motion
from skin2urdf.geometry.se3 import inverse, placement
from skin2urdf.geometry.so3 import axis_rotation, frame_with_z
from skin2urdf.simulation import Truth
from skin2urdf.structure.records import KinematicTree

_SHAPE = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class TrueRobot:
    """The true robot with all joints at zero, in the frame of its URDF's root link.

    Attributes:
        axis: (D, 3) unit vectors along the joints' axes.
        point: (D, 3) a point on each axis; 0 for prismatic joints [m].
        T_base_su: (U, 4, 4) SU frames.
        up: (3,) unit vector opposite to gravity.
        bias: (U, 3) [m/s^2].
        sensor_matrix: (U, 3, 3) sensitivities.
    """

    axis: F64
    point: F64
    T_base_su: F64
    up: F64
    bias: F64
    sensor_matrix: F64


def true_robot(truth: Truth, tree: KinematicTree) -> TrueRobot:
    """The truth of a simulation, in the order of an estimate's tree.

    Raises:
        ValueError: the tree is not the true one.
    """
    import pinocchio as pin

    model = pin.buildModelFromXML(truth.urdf)
    data = model.createData()
    q = pin.neutral(model)
    columns = pin.computeJointJacobians(model, data, q)
    pin.framesForwardKinematics(model, data, q)
    rows = [[su.name for su in truth.sus].index(name) for name in tree.su_names]
    _check(
        tree,
        truth,
        {str(n): str(model.names[p]) for n, p in zip(model.names, model.parents, strict=True)},
    )
    dof = [model.joints[model.getJointId(name)].idx_v for name in tree.joint_names]
    linear, angular = columns[:3, dof].T, columns[3:, dof].T
    slides = tree.prismatic[:, None]
    return TrueRobot(
        axis=np.where(slides, linear, angular),
        point=np.where(slides, 0.0, np.cross(angular, linear)),
        T_base_su=np.array([data.oMf[model.getFrameId(n)].homogeneous for n in tree.su_names]),
        up=-truth.gravity_base / np.linalg.norm(truth.gravity_base),
        bias=truth.bias[rows],
        sensor_matrix=truth.sensor_matrix[rows],
    )


def as_felt(true: TrueRobot) -> TrueRobot:
    """The robot with SU frames turned as their sensors are by cross-axis errors.

    A sensitivity is a symmetric matrix times a rotation, of which a log shows the first and takes
    the second for a part of the placement.
    """
    turned = true.T_base_su.copy()
    for T, M in zip(turned, true.sensor_matrix, strict=True):
        T[:3, :3] = T[:3, :3] @ polar(M, side="left")[0].T
    return replace(true, T_base_su=turned)


def _check(tree: KinematicTree, truth: Truth, parent_of: dict[str, str]) -> None:
    """Raise ValueError where a joint or an SU has another joint before it than in truth."""
    for name, parent in zip(tree.joint_names, tree.parent, strict=True):
        found = tree.joint_names[parent] if parent >= 0 else "universe"
        if parent_of[name] != found:
            raise ValueError(f"{name} follows {parent_of[name]}, not {found}")
    for su in truth.sus:
        true = truth.joint_names[su.joint] if su.joint >= 0 else "the base"
        joint = int(tree.su_joint[tree.su_names.index(su.name)])
        found = tree.joint_names[joint] if joint >= 0 else "the base"
        if true != found:
            raise ValueError(f"{su.name} sits on {true}, not on {found}")


def displacement(state: State, tree: KinematicTree, true: TrueRobot) -> Step:
    """The step from an estimate to the truth.

    Args:
        state: the estimate, of one log.
        tree: its tree.
        true: the truth, with first axes that are not vertical.

    Returns:
        Coordinates after which ``moved(state, step)`` feels what the true robot feels. Orientations
        are those of the SUs' housings: what a cross-axis error turns counts as an error.
    """
    D, U = tree.n_joints, tree.n_sus
    joints = np.zeros((D, N_JOINT))
    frames = np.zeros((D, 4, 4))
    for j in range(D):
        parent = int(tree.parent[j])
        T = state.T_parent_joint[j]
        before = frames[parent] if parent >= 0 else _base_of_limb(T, true, j)
        E = before @ T
        joints[j] = _to_axis(inverse(E), true.axis[j], true.point[j], bool(tree.prismatic[j]))
        if parent < 0:
            joints[j, :2] = 0.0
        frames[j] = E @ joint_motion(joints[j : j + 1])[0][0]
    sus = np.zeros((U, 6))
    for u, joint in enumerate(tree.su_joint):
        T_est, T_true = state.T_joint_su[u], true.T_base_su[u]
        before = frames[joint] if joint >= 0 else _base_of_su(T_est, true, u)
        sus[u] = _to_frame(inverse(before @ T_est) @ T_true)
    shape = _shape(true.sensor_matrix)
    intrinsic = np.concatenate([true.bias - state.bias, shape - state.shape], axis=1)
    return Step(joints, np.zeros((0, 2)), np.concatenate([sus, intrinsic], axis=1))


def _base_of_limb(T_base_joint: F64, true: TrueRobot, joint: int) -> F64:
    """(4, 4) the estimate's base frame in the true one, for the limb of one first joint.

    Gravity agrees, the axis points into the same quarter of the sky, and the origin is on it.
    """
    tilt = frame_with_z(true.up)
    estimated, axis = T_base_joint[:3, 2], tilt.T @ true.axis[joint]
    yaw = np.arctan2(axis[1], axis[0]) - np.arctan2(estimated[1], estimated[0])
    R = tilt @ axis_rotation(_Z, yaw)
    return placement(R, true.point[joint] - R @ T_base_joint[:3, 3])


def _base_of_su(T_base_su: F64, true: TrueRobot, u: int) -> F64:
    """(4, 4) the same for an SU on the base: gravity agrees, the rest fits best."""
    tilt = frame_with_z(true.up)
    between = tilt.T @ true.T_base_su[u, :3, :3] @ T_base_su[:3, :3].T
    yaw = np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1])
    R = tilt @ axis_rotation(_Z, yaw)
    return placement(R, true.T_base_su[u, :3, 3] - R @ T_base_su[:3, 3])


def _to_axis(T_joint_base: F64, axis: F64, point: F64, prismatic: bool) -> F64:
    """(4,) tx, ty, rx, ry that bring a joint's frame onto a line given in the base frame."""
    d = T_joint_base[:3, :3] @ axis
    turns = np.array([np.arctan2(-d[1], d[2]), np.arcsin(np.clip(d[0], -1.0, 1.0))])
    if prismatic:
        return np.concatenate([np.zeros(2), turns])
    p = T_joint_base[:3, :3] @ point + T_joint_base[:3, 3]
    return np.concatenate([(p - d * (p[2] / d[2]))[:2], turns])


def _to_frame(T: F64) -> F64:
    """(6,) coordinates of a displacement: the inverse of the estimation's ``local_motion``."""
    R = T[:3, :3]
    turns = (
        np.arctan2(-R[1, 2], R[2, 2]),
        np.arcsin(np.clip(R[0, 2], -1.0, 1.0)),
        np.arctan2(-R[0, 1], R[0, 0]),
    )
    return np.concatenate([T[:3, 3], turns])


def _shape(sensor_matrix: F64) -> F64:
    """(U, 6) scale and symmetric cross-axis errors of sensitivities (U, 3, 3).

    A sensitivity is a symmetric matrix times a rotation, of which a log shows the first.
    """
    symmetric = np.array([polar(M, side="left")[1] for M in sensor_matrix])
    return np.stack([symmetric[:, a, b] - (a == b) for a, b in _SHAPE], axis=1)
