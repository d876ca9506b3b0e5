"""Derivatives of what the points of a link feel, and what all SUs on it say of the joints together.

SUs of one link read the same few series: with S_u (3, 3 p) what makes a reading of what p points
feel, and P(k) (3 p, C) the points' derivatives at sample k, the derivatives of SU u are S_u P(k).
The normal equations of the joint part are then sums over the samples of ``P' N P`` with
``N(k) = sum over the SUs of S_u' w_u(k) S_u``, whatever the weights are: they cost as much with a
hundred SUs on a link as with one. So do gradients, of which the SUs' residuals are put back on the
points first. What is left for each SU is its own part, and how that is coupled with the joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.points import N_POINTS


@dataclass(frozen=True, eq=False)
class LinkRows:
    """What the p points of a link feel at K samples of a log, and the S SUs that read it.

    Attributes:
        log: number of the log.
        sus: (S,) numbers of the SUs.
        columns: C columns of the joint part that the readings depend on, but for those of motion
            that encoders do not see.
        of_points: (3 p, C + 3 m, K) derivatives in these, and in position, velocity and
            acceleration of each of m joints that move beyond their encoders.
        joints: (m,) numbers of these joints and hinges.
        sensed: (S, 3, 3 p) what makes readings of what the points feel.
        weights: (S, 3, K) information of each sample.
        residual: (S, 3, K) residuals, 0 where nothing is measured.
    """

    log: int
    sus: Int
    columns: list[int]
    of_points: F64
    joints: Int
    sensed: F64
    weights: F64
    residual: F64

    @property
    def shared(self) -> bool:
        """Whether fewer points than SUs tell what is felt."""
        return len(self.sus) > N_POINTS

    @property
    def by_coordinates(self) -> F64:
        """(3 p, C, K) derivatives in the columns."""
        return self.of_points[:, : len(self.columns)]

    @property
    def by_motion(self) -> F64:
        """(m, 3, 3 p, K) derivatives in the motion of joints beyond their encoders."""
        p, _, K = self.of_points.shape
        apart = self.of_points[:, len(self.columns) :].reshape(p, len(self.joints), 3, K)
        return np.moveaxis(apart, 0, 2)

    @cached_property
    def information(self) -> F64:
        """(K, 3 p, 3 p) information of all SUs on what the points feel."""
        S, _, p = self.sensed.shape
        outer = self.sensed[..., :, None] * self.sensed[..., None, :]
        K = self.weights.shape[2]
        summed = self.weights.reshape(3 * S, K).T @ outer.reshape(3 * S, p * p)
        return np.asarray(summed.reshape(K, p, p))

    @cached_property
    def pulls(self) -> F64:
        """(K, 3 p) what the residuals of all SUs say of what the points feel."""
        S, _, p = self.sensed.shape
        pulled = (self.weights * self.residual).reshape(3 * S, -1)
        return np.asarray(pulled.T @ self.sensed.reshape(3 * S, p))
