"""Joints that yield under torques that are known: what links do beyond what their encoders say.

A joint of stiffness K leaves its link at ``q = theta - tau / K`` where theta is the motor's
position: one number per joint. A gear's damping makes its deflection late, ``K e + d e' = -tau``,
which to first order is one more, ``e = -tau / K - (d / K) e'``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.torques import regressors
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import filtered, first_derivative
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree


@dataclass(frozen=True, eq=False)
class UnderKnown(Unseen):
    """Deflections of the joints under torques that are known, per unit of S numbers.

    Attributes:
        damping: (S,) True for what makes a deflection late: damping over stiffness.
        size: (S,) the torque of which a spring's number is the deflection [N m or N].
    """

    damping: Bool
    size: F64

    def compliances(self, x: F64, covariance: F64, n_joints: int) -> tuple[F64, F64]:
        """What the joints yield per torque, and how well that is known.

        Args:
            x: (S,) what was found.
            covariance: (S, S) of it.
            n_joints: D.

        Returns:
            (D,) compliances and their standard deviations [rad/(N m), m/N]; NaN of joints that bear
            nothing.
        """
        found, deviation = np.full(n_joints, np.nan), np.full(n_joints, np.nan)
        at = np.flatnonzero(~self.damping)
        k, size = self.joint[at], self.size[at]
        found[k] = x[at] / size
        deviation[k] = np.sqrt(np.diag(covariance)[at].clip(min=0.0)) / size
        return found, deviation


@dataclass(frozen=True, eq=False)
class Elasticity(UnderKnown):
    """The same where the torques are those of links that are known.

    Attributes:
        basis: (S, 10 D) the inertial parameters over stiffness that each number stands for, in the
            order of Pinocchio's regressors.
    """

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
    return replace(found, motions=tuple(out))
