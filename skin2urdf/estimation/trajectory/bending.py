"""What yields under the loads of one robot: joints, and the base below them.

A joint of stiffness K leaves its link at ``q = theta - tau / K`` where theta is the motor's
position. All torques are linear in the masses, centres of mass and inertias pi of the links:
``tau_k = Y_k(q, q', q'') pi`` (Atkeson, An and Hollerbach 1986; Pinocchio's joint torque
regressor). A base that gives way turns about its three axes by the moments that the same links put
on it, ``e = C tau`` with a symmetric C. So few numbers make all deflections: the pi that show in
some motion, and how much each part yields. As nobody knows the masses, only products of both tell.

The products are linear in either, and Newton's steps are taken in both: what a step has found
becomes the next one's known half (:mod:`balance`). More goes with the deflections that were
found: a damped spring is late, ``K e + d e' = -tau``; a base has inertia of its own, which makes
this ``K e + d e' + J e'' = -tau``; and where the base turns about a point from which its frame is
off by h, this shifts by ``e x h``, and what the robot's forces f on the frame add to the moment is
``h x f``. Nothing of the base is divided by its compliance, which may be 0 about some axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.torques import N_INERTIAL
from skin2urdf.estimation.trajectory.unseen import Unseen

YIELD = 2e-2
"""Standard deviation of deflections [rad]; robots whose gears twist by more than a degree are not
built to be calibrated."""
SPINDLE = 0.1
"""Lever at which what slides is as stiff as what turns [m/rad]."""
_ALIKE = 1.5
"""Standard deviation of the logarithm of the time by which dampers make deflections late: up to a
quarter of the critical damping at 3 Hz."""
UNLIKE = 1.0
"""Standard deviation of the logarithm of how much a part yields more than the others."""
_CROSS = 0.3
"""Standard deviation of a base's turn about one axis by a moment about another, over that by one
about its own."""
_SWING = (2 * np.pi * 25.0) ** -2
"""Standard deviation of the base's own inertia over its stiffness [s^2]: that of a resonance at
25 Hz without the robot."""
_DEPTH = 0.5
"""Standard deviation of the distance between the base's frame and the point about which the base
turns [m]: that of a stand."""
PAIRS = ((0, 1), (0, 2), (1, 2))
TENSOR = ((0, 0), (1, 1), (2, 2), *PAIRS)


@dataclass(frozen=True, eq=False)
class Bending(Unseen):
    """Deflections of R parts by P loads, as motions that encoders do not see.

    Its numbers are, in this order, the loads; the logarithms of what each part yields above
    ``compliance``; three shares of the base's turns by moments about other axes, if the base
    yields; R times how late deflections are where compliances are 1, as logarithms; if the base
    yields, its own moments and products of inertia, of the same scale [s^2], and how far its frame
    is from the point about which it turns, along its axes [m].

    Attributes:
        parts: (R,) joints and turns of the base that yield.
        compliance: (R, R) deflections per torque, of a scale of its own.
        basis: (P, 10 D) the inertial parameters of each load, in the order of Pinocchio's
            regressors.
        holds: whether loads and what they bend were found in balance: numbers far from any robot's
            bend it to where there is none.
    """

    parts: Int = field(kw_only=True)
    compliance: F64 = field(kw_only=True)
    basis: F64 = field(kw_only=True)
    holds: bool = field(default=True, kw_only=True)

    @property
    def n_numbers(self) -> int:
        """S."""
        return len(self.spread)

    @cached_property
    def spread(self) -> F64:
        """(S,) what is known of the numbers before: standard deviations about zero."""
        P, R = len(self.basis), len(self.parts)
        known = [np.full(P, YIELD), np.full(R, UNLIKE)]
        if self.base:
            known += [np.full(3, _CROSS)]
        known += [np.full(R, _ALIKE)]
        if self.base:
            known += [np.full(len(TENSOR), _SWING), np.full(3, _DEPTH)]
        return np.concatenate(known)

    @property
    def lever(self) -> F64:
        """(3,) how far the base's frame is from the point about which it turns [m]."""
        return np.array(self.origin[-3:]) if self.base else np.zeros(3)

    @property
    def base(self) -> bool:
        """Whether the base yields: its three turns are then the last parts."""
        n_joints = self.basis.shape[1] // N_INERTIAL
        return bool((self.parts >= n_joints).any())


def bends_of(unseen: Unseen | None) -> Bending | None:
    """The deflections under loads that nobody knows, which are the first of what is unseen."""
    first = unseen.several[0] if unseen is not None and unseen.several else unseen
    return first if isinstance(first, Bending) else None
