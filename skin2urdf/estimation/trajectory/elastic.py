"""Joints that yield under torques that are known: what links do beyond what their encoders say.

A joint of stiffness K leaves its link at ``q = theta - tau / K`` where theta is the motor's
position: one number per joint. A gear's damping makes its deflection late, ``K e + d e' = -tau``,
which to first order is one more, ``e = -tau / K - (d / K) e'``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.torques import regressors
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import filtered, first_derivative
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree


@dataclass(frozen=True, eq=False)
class Elasticity(Unseen):
    """Deflections of the joints, as motions that encoders do not see, per unit of S numbers.

    Attributes:
        damping: (S,) True for the time by which a deflection lags behind its torque [s]: damping
            over stiffness.
        basis: (S, 10 D) the inertial parameters over stiffness that it stands for, in the order of
            Pinocchio's regressors.
    """

    damping: Bool
    basis: F64


def followed(
    found: Elasticity,
    tree: KinematicTree,
    logs: Sequence[Trajectory],
    state: State,
    gravity: float,
    x: F64,
) -> Elasticity:
    """The same deflections along the motion of the links, which is what torques go with.

    Args:
        found: deflections along some motion, by which the links' is known.
        tree: the structure.
        logs: trajectories as the encoders have them.
        state: placements, and gravity's direction per log.
        gravity: its magnitude [m/s^2].
        x: (S,) what the joints yield.
    """
    joint, damping, basis = found.joint, found.damping, found.basis
    out = []
    for g, log in enumerate(logs):
        motion = found.moved(log, g, x)
        deflections = np.empty((len(log.q), len(joint)))
        for Y, at in regressors(tree, state, g, gravity, motion):
            for k in range(tree.n_joints):
                deflections[at, joint == k] = -(Y[:, k] @ basis[joint == k].T)
        # Above the low-pass, accelerations are noise, and more so with every differentiation.
        deflections = filtered(deflections, log.taps)
        rates = first_derivative(motion.q - log.q, log.rate)
        deflections[:, damping] = -rates[:, joint[damping]]
        out.append(deflections)
    return Elasticity(joint, tuple(out), damping, basis)
