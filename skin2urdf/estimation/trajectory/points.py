"""A few points of each link, which tell what all SUs on it feel.

What a rigid body feels is affine in the place: with A = a x + w x w x of its link, an SU at r feels
``F(r) = F(0) + A r``, and the derivatives in all that moves the link are affine in r alike. Four
points of a link therefore stand for any number of SUs on it; up to four SUs are their own points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int

N_POINTS = 4
_TOGETHER = 4
"""SUs that are worked out at once: as many as caches hold."""


@dataclass(frozen=True, eq=False)
class SharedPoints:
    """SUs on one link and its points.

    Attributes:
        joint: the joint that carries the link; -1 for what stands on the ground.
        sus: (S,) the SUs.
        at: where its points stand among those of all links.
        arms: (p, 3) the points in the link's frame [m].
        shares: (S, p) what each point counts for an SU; they sum to 1.
        R_link_su: (S, 3, 3) orientations.
    """

    joint: int
    sus: Int
    at: slice
    arms: F64
    shares: F64
    R_link_su: F64

    def parts(self) -> Iterator[SharedPoints]:
        """The same with a few of the SUs at a time."""
        for first in range(0, len(self.sus), _TOGETHER):
            some = slice(first, first + _TOGETHER)
            yield SharedPoints(
                self.joint, self.sus[some], self.at, self.arms, self.shares[some],
                self.R_link_su[some],
            )  # fmt: skip

    def sensed(self, matrices: F64) -> F64:
        """(S, 3, 3 p) what makes the readings of SUs of what the points feel.

        Args:
            matrices: (S, 3, 3) by which each SU reads what it feels in its own frame.
        """
        turn = matrices @ np.swapaxes(self.R_link_su, 1, 2)
        weight = np.einsum("sp,sij->sipj", self.shares, turn)
        return np.asarray(weight.reshape(len(self.sus), 3, -1))

    def series(self, felt: F64) -> F64:
        """(3 p, M) what the link's own points feel, of (P, 3, M) that those of all links do."""
        return felt[self.at].reshape(3 * len(self.arms), -1)

    def read(self, matrices: F64, felt: F64) -> F64:
        """(S, 3, M) readings of the SUs.

        Args:
            matrices: as above.
            felt: (P, 3, M) what the points of all links feel.
        """
        here = self.series(felt)
        weight = self.sensed(matrices).reshape(-1, len(here))
        return np.asarray((weight @ here).reshape(len(self.sus), 3, -1))


def shared_points(su_joint: Int, T_joint_su: F64) -> tuple[SharedPoints, ...]:
    """The links that carry SUs, each with its points.

    Args:
        su_joint: (U,) joint that carries each SU, -1 for none.
        T_joint_su: (U, 4, 4) placements.
    """
    out, first = [], 0
    for joint in np.unique(su_joint):
        sus = np.flatnonzero(su_joint == joint)
        arms, shares = T_joint_su[sus, :3, 3], np.eye(len(sus))
        if len(sus) > N_POINTS:
            shares = np.concatenate([1 - arms.sum(axis=1, keepdims=True), arms], axis=1)
            arms = np.concatenate([np.zeros((1, 3)), np.eye(3)])
        at = slice(first, first + len(arms))
        out.append(SharedPoints(int(joint), sus, at, arms, shares, T_joint_su[sus, :3, :3]))
        first = at.stop
    return tuple(out)
