"""What every SU truly feels, by Pinocchio's rigid-body dynamics on the original URDF."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.simulation.mechanism import Mechanism
from skin2urdf.simulation.skins import PlacedSu
from skin2urdf.simulation.trajectory import JointMotion

SAMPLES_AT_ONCE = 20_000
"""Samples handled at once, which bounds the memory."""


def specific_forces(
    mechanism: Mechanism, motion: JointMotion, sus: Sequence[PlacedSu], time: F64
) -> list[F64]:
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
        U arrays (N, 3) of specific forces [m/s^2], on their own so that each can be let go.
    """
    return felt_motions(mechanism, motion, sus, time, rates=False)[0]


def felt_motions(
    mechanism: Mechanism,
    motion: JointMotion,
    sus: Sequence[PlacedSu],
    time: F64,
    *,
    rates: bool = True,
) -> tuple[list[F64], list[F64]]:
    """Specific force and angular velocity of every SU, in its own frame, in one pass.

    Args:
        mechanism: the robot.
        motion: the motion of its joints.
        sus: U SUs.
        time: (N,) times [s].
        rates: whether angular velocities are wanted.

    Returns:
        U arrays (N, 3) of specific forces [m/s^2] as :func:`specific_forces` gives them, and U
        arrays (N, 3) of angular velocities [rad/s] (none where they are not wanted).
    """
    forces = [np.empty((time.size, 3)) for _ in sus]
    turns = [np.zeros((time.size, 3)) for _ in sus] if rates else []
    joints = sorted({su.joint for su in sus if su.joint >= 0})
    for start in range(0, time.size, SAMPLES_AT_ONCE):
        chunk = slice(start, start + SAMPLES_AT_ONCE)
        states = _joint_states(mechanism, motion, joints, time[chunk])
        for u, su in enumerate(sus):
            R = su.T_joint_su[:3, :3]
            if su.joint < 0:
                forces[u][chunk] = -mechanism.gravity_base @ R
            else:
                felt = _felt_at(states[:, joints.index(su.joint)], su.T_joint_su[:3, 3])
                forces[u][chunk] = felt @ R
                if rates:
                    turns[u][chunk] = states[:, joints.index(su.joint), 1] @ R
    return forces, turns


def _joint_states(
    mechanism: Mechanism, motion: JointMotion, joints: Sequence[int], time: F64
) -> F64:
    """(N, J, 4, 3) v, w, a - g, alpha of J joint frames, each in its own frame."""
    import pinocchio as pin

    model, data = mechanism.model, mechanism.model.createData()
    velocities, felt = _rows(data.v), _rows(data.a_gf)
    states = np.empty((2, time.size, *velocities.shape))
    if joints:
        position, velocity, acceleration = motion.at(time)
        rows = zip(mechanism.configuration(position), velocity, acceleration, *states, strict=True)
        for q, v, a, state_v, state_a in rows:
            pin.rnea(model, data, q, v, a)
            state_v[:], state_a[:] = velocities, felt
    chosen = states[:, :, np.array(joints, dtype=np.int64) + 1]
    return np.moveaxis(chosen, 0, 2).reshape(time.size, len(joints), 4, 3)


def _rows(twists: Any) -> F64:
    """(n, 6) view of n twists in Pinocchio's data, linear part first, which follows every pass.

    They lie one after the other in memory, and one view spares a Python object for each.
    """
    parts = [part for twist in twists for part in (twist.linear, twist.angular)]
    at = np.array([part.ctypes.data for part in parts])
    if (np.diff(at) != parts[0].nbytes).any():
        raise RuntimeError("Pinocchio's twists do not lie one after the other in memory")
    shape = (len(parts) // 2, 6)
    return np.lib.stride_tricks.as_strided(parts[0], shape, (6 * 8, 8), writeable=False)


def _felt_at(state: F64, point: F64) -> F64:
    """(N, 3) specific force at a point of a joint frame, in that frame, from (N, 4, 3) states."""
    v, w, a, alpha = np.moveaxis(state, 1, 0)
    return np.asarray(a + np.cross(w, v + np.cross(w, point)) + np.cross(alpha, point))
