"""What every SU truly feels, by Pinocchio's rigid-body dynamics on the original URDF."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.simulation.mechanism import Mechanism
from skin2urdf.simulation.skins import PlacedSu
from skin2urdf.simulation.trajectory import JointMotion

_CHUNK = 20_000
"""Samples handled at once, which bounds the memory."""


def specific_forces(
    mechanism: Mechanism, motion: JointMotion, sus: Sequence[PlacedSu], time: F64
) -> F64:
    """Specific force f = R^T (p_dd - g) of every SU, in its own frame.

    Pinocchio's recursive Newton-Euler pass gives every joint frame's spatial velocity and its
    spatial acceleration minus gravity, in the joint's own frame. A point r fixed to that frame has
    the classical acceleration a + w x v + alpha x r + w x (w x r).

    Args:
        mechanism: the robot.
        motion: the motion of its joints.
        sus: U SUs.
        time: (N,) times [s].

    Returns:
        (U, N, 3) specific forces [m/s^2].
    """
    forces = np.empty((len(sus), time.size, 3))
    joints = sorted({su.joint for su in sus if su.joint >= 0})
    for start in range(0, time.size, _CHUNK):
        chunk = slice(start, start + _CHUNK)
        states = _joint_states(mechanism, motion, joints, time[chunk])
        for u, su in enumerate(sus):
            R = su.T_joint_su[:3, :3]
            if su.joint < 0:
                forces[u, chunk] = -mechanism.gravity_base @ R
            else:
                felt = _felt_at(states[:, joints.index(su.joint)], su.T_joint_su[:3, 3])
                forces[u, chunk] = felt @ R
    return forces


def _joint_states(
    mechanism: Mechanism, motion: JointMotion, joints: Sequence[int], time: F64
) -> F64:
    """(N, J, 4, 3) v, w, a - g, alpha of J joint frames, each in its own frame."""
    import pinocchio as pin

    model, data = mechanism.model, mechanism.model.createData()
    states = np.empty((time.size, len(joints) * 12))
    # Views into Pinocchio's data: they follow every pass without a new Python object.
    views = [
        part
        for j in joints
        for twist in (data.v[j + 1], data.a_gf[j + 1])
        for part in (twist.linear, twist.angular)
    ]
    if views:
        position, velocity, acceleration = motion.at(time)
        rows = zip(mechanism.configuration(position), velocity, acceleration, states, strict=True)
        for q, v, a, row in rows:
            pin.rnea(model, data, q, v, a)
            np.concatenate(views, out=row)
    return states.reshape(time.size, len(joints), 4, 3)


def _felt_at(state: F64, point: F64) -> F64:
    """(N, 3) specific force at a point of a joint frame, in that frame, from (N, 4, 3) states."""
    v, w, a, alpha = np.moveaxis(state, 1, 0)
    return np.asarray(a + np.cross(w, v + np.cross(w, point)) + np.cross(alpha, point))
