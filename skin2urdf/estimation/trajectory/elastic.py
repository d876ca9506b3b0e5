"""Joints that yield under torques that are known: what links do beyond what their encoders say.

A joint of stiffness K leaves its link at ``q = theta - tau / K`` where theta is the motor's
position: one number per joint. A damper d beside the spring makes it late by a pole,
``e + (d / K) e' = -tau / K``: one more number per joint tells to first order by how much it is
later than what is known of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.trajectory.unseen import Unseen


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
