"""Joints that yield under torques that are known: one number for each joint, its compliance.

Where the masses, centres of mass and inertias pi of the links are known, as a vendor's URDF has
them, the torques ``tau = Y(q, q', q'') pi`` are (Pinocchio's inverse dynamics), and a joint of
stiffness K leaves its link at ``q = theta - tau / K``, where theta is the motor's position.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.elastic import Elasticity, followed
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_BORNE = 1e-3
"""Least torque of a joint, over the largest, whose twist counts: of milliradians, microradians."""


def known_elasticity(
    tree: KinematicTree, logs: Sequence[Trajectory], state: State, gravity: float, inertials: F64
) -> Elasticity:
    """The deflections that known links make of the motion of the logs, as encoders have it.

    Args:
        tree: D joints.
        logs: trajectories.
        state: placements, and gravity's direction per log.
        gravity: its magnitude [m/s^2].
        inertials: (10 D,) of what each joint carries, in the order of Pinocchio's regressors and in
            the frames of the joints [kg, kg m, kg m^2].

    Returns:
        For every joint that bears something the deflection per radian (metre) of its rms, and the
        time by which it is late.
    """
    D = tree.n_joints
    alone = _of_joints(np.arange(D, dtype=np.int64), np.tile(inertials, (D, 1)), logs)
    torque = followed(alone, tree, logs, state, gravity, np.zeros(2 * D))
    count = sum(len(log.q) for log in logs)
    square = np.sum([(d[:, :D] ** 2).sum(axis=0) for d in torque.motions], axis=0)
    size = np.sqrt(square / count)
    borne = np.flatnonzero(size > _BORNE * size.max(initial=0.0)).astype(np.int64)
    scaled = inertials / size[borne, None]
    nothing = np.zeros(2 * len(borne))
    return followed(_of_joints(borne, scaled, logs), tree, logs, state, gravity, nothing)


def compliances(
    elastic: Elasticity, x: F64, covariance: F64, inertials: F64, n_joints: int
) -> tuple[F64, F64]:
    """What the joints yield per torque, and how well that is known.

    Args:
        elastic: deflections under known torques.
        x: (S,) what was found.
        covariance: (S, S) of it.
        inertials: (10 D,) as for :func:`known_elasticity`.
        n_joints: D.

    Returns:
        (D,) compliances and their standard deviations [rad/(N m), m/N]; NaN of joints that bear
        nothing.
    """
    found, deviation = np.full(n_joints, np.nan), np.full(n_joints, np.nan)
    at = np.flatnonzero(~elastic.damping)
    k = elastic.joint[at]
    per_unit = elastic.basis[at] @ inertials / (inertials @ inertials)
    found[k] = x[at] * per_unit
    deviation[k] = np.sqrt(np.diag(covariance)[at].clip(min=0.0)) * per_unit
    return found, deviation


def _of_joints(joints: Int, basis: F64, logs: Sequence[Trajectory]) -> Elasticity:
    """Deflections of some joints by given parameters, and their damping, along no motion yet."""
    n = len(basis)
    both = np.tile(joints, 2)
    damping = np.arange(2 * n) >= n
    directions = np.concatenate([basis, np.zeros_like(basis)])
    motions = tuple(np.zeros((len(log.q), 2 * n)) for log in logs)
    return Elasticity(both, motions, damping, directions)
