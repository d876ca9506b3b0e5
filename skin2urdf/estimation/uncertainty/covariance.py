"""Covariance of all coordinates at a cost linear in the number of SUs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.estimation.problem.state import N_SU

UNKNOWN = 0.035
"""Standard deviation [m or rad] beyond which a direction is not observable: 35 mm, 2 deg."""


@dataclass(frozen=True, eq=False)
class ArrowCovariance(Record):
    """Covariance of the joint and log coordinates x and of those of every SU, y_u.

    Given the joints the SUs are independent of each other, so that all there is to know is::

        y_u = lean_u x[columns_u] + e_u,     cov(x) = joint,     cov(e_u) = own_u

    Attributes:
        joint: (J, J) covariance of the joint and log coordinates.
        columns: (U, C) the coordinates that SU u depends on; where one comes twice, ``lean`` is 0
            for all but one of them.
        lean: (U, 15, C) how each SU follows them.
        own: (U, 15, 15) covariance of each SU's coordinates for known joints.
    """

    joint: F64
    columns: Int
    lean: F64
    own: F64

    def scaled(self, factor: float) -> ArrowCovariance:
        """All covariances times a factor."""
        return replace(self, joint=self.joint * factor, own=self.own * factor)

    def chain(self, u: int) -> F64:
        """(C, C) covariance of the coordinates that SU u depends on."""
        return np.asarray(self.joint[np.ix_(self.columns[u], self.columns[u])])

    def su(self) -> F64:
        """(U, 15, 15) covariance of each SU's coordinates."""
        out = np.array(self.own)
        for u, lean in enumerate(self.lean):
            out[u] += lean @ self.chain(u) @ lean.T
        return out

    def dense(self) -> F64:
        """(n, n) covariance of all coordinates, joints and logs first: for small robots only."""
        U, J = len(self.own), len(self.joint)
        follow = np.concatenate([np.eye(J), np.zeros((N_SU * U, J))])
        out = np.zeros((J + N_SU * U, J + N_SU * U))
        for u in range(U):
            at = slice(J + N_SU * u, J + N_SU * (u + 1))
            np.add.at(follow[at].T, self.columns[u], self.lean[u].T)
            out[at, at] = self.own[u]
        return np.asarray(out + follow @ self.joint @ follow.T)
