"""What yields under the loads of one robot: joints, and the base below them.

A joint of stiffness K leaves its link at ``q = theta - tau / K`` where theta is the motor's
position. All torques are linear in the masses, centres of mass and inertias pi of the links:
``tau_k = Y_k(q, q', q'') pi`` (Atkeson, An and Hollerbach 1986; Pinocchio's joint torque
regressor). A base that gives way turns about its three axes by the moments that the same links put
on it, ``e = C tau`` with a symmetric C, and on feet or tyres it shifts along them by the forces. So
few numbers make all deflections: the pi that show in some motion, and how much each part yields. As
nobody knows the masses, only products of both tell.

The products are linear in either, and Newton's steps are taken in both: what a step has found
becomes the next one's known half (:mod:`balance`). More goes with the deflections that were
found: a damped spring is late, ``K e + d e' = -tau``; a base has a mass and inertia of its own,
which make this ``K e + d e' + J e'' = -tau``; and there is a point of which moments turn the base
and forces shift it: where its frame is off from that by h, this shifts by ``e x h`` more, and what
the robot's forces f on the frame add to the moment is ``h x f``. Nothing of the base is divided by
its compliance, which may be 0 about some axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.skeleton import N_HINGES
from skin2urdf.estimation.trajectory.springs import roots
from skin2urdf.estimation.trajectory.torques import N_INERTIAL
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.geometry.so3 import skew

YIELD = 2e-2
"""Standard deviation of deflections [rad]; robots whose gears twist by more than a degree are not
built to be calibrated."""
SPINDLE = 0.1
"""Lever at which what slides is as stiff as what turns [m/rad]."""
SWAY = 0.2
"""Lever at which a base that shifts is as stiff as it is where it turns [m/rad]: that of feet which
yield sideways and stand 0.2 to 0.5 m from the middle."""
_ALIKE = 1.5
"""Standard deviation of the logarithm of the time by which dampers make deflections late: up to a
quarter of the critical damping at 3 Hz."""
UNLIKE = 1.0
"""Standard deviation of the logarithm of how much a part yields more than the others."""
_CROSS = 0.3
"""Standard deviation of a base's turn about one axis by a moment about another, over that by one
about its own; of its shifts alike."""
_SWING = (2 * np.pi * 25.0) ** -2
"""Standard deviation of the base's own inertia over its stiffness [s^2]: that of a resonance at
25 Hz without the robot."""
_HEAVIER = 2.0
"""Standard deviation of the logarithm of the mass of a base that shifts, over that which resonates
at 25 Hz where it yields as feet do: at 9 to 70 Hz."""
_OFF_CENTRE = 0.3
"""Standard deviation of the distance between its centre of mass and where it is held [m]."""
_DEPTH = 0.5
"""Standard deviation of the distance between the base's frame and the point about which the base
turns [m]: that of a stand."""
_LATE = 2e-3
"""Time by which dampers make deflections late [s]: a twentieth of the critical damping at 8 Hz."""
_FAR = 3.0
"""Logarithm that it does not reach: nothing is late by more than a sixth of a swing at 4 Hz."""
_PAIRS = ((0, 1), (0, 2), (1, 2))
_TENSOR = ((0, 0), (1, 1), (2, 2), *_PAIRS)


@dataclass(frozen=True, eq=False)
class Bending(Unseen):
    """Deflections of R parts by P loads, as motions that encoders do not see.

    Its numbers are, in this order, the loads; the logarithms of what each part yields above
    ``compliance``; three shares of the base's turns by moments about other axes, and three of its
    shifts, as far as it turns and shifts; R times how late deflections are where compliances are
    those to begin with, as logarithms; if the base yields, its own moments and products of inertia
    about its centre, of the same scale [s^2], if it shifts, the logarithm of its mass and where
    that has its centre [m], and how far its frame is from the point about which it turns, along
    its axes [m].

    Attributes:
        parts: (R,) joints, shifts of the base, and its turns, that yield.
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
        known += [np.full(len(self.crosses), _CROSS), np.full(R, _ALIKE)]
        if self.base:
            known += [np.full(len(_TENSOR), _SWING)]
            if self.shifts:
                known += [np.array([_HEAVIER]), np.full(3, _OFF_CENTRE)]
            known += [np.full(3, _DEPTH)]
        return np.concatenate(known)

    @property
    def crosses(self) -> tuple[tuple[int, int], ...]:
        """Numbers of the base's parts, those alike in pairs."""
        of_turns = self.of_base.stop - 3
        firsts = [of_turns, of_turns - 3] if self.shifts else [of_turns] * self.base
        return tuple((first + i, first + j) for first in firsts for i, j in _PAIRS)

    @property
    def of_crosses(self) -> slice:
        """Numbers that are shares of the base's motion by loads along and about other axes."""
        first = len(self.basis) + len(self.parts)
        return slice(first, first + len(self.crosses))

    @property
    def of_dampers(self) -> slice:
        """Numbers by which parts are late."""
        first = self.of_crosses.stop
        return slice(first, first + len(self.parts))

    @property
    def of_inertia(self) -> slice:
        """Numbers of the base's own inertia."""
        first = self.of_dampers.stop
        return slice(first, first + 6 * self.base + 4 * self.shifts)

    @property
    def of_base(self) -> slice:
        """The parts that are the base's shifts and turns."""
        R = len(self.parts)
        return slice(R - int((self.parts >= self._n_joints).sum()), R)

    @property
    def shifts(self) -> bool:
        """Whether the base shifts under its load as well as it turns."""
        return self.base and self.of_base.stop - self.of_base.start == N_HINGES

    @property
    def own_inertia(self) -> F64:
        """(B, B) the base's own inertia about its shifts and turns, over its stiffness."""
        mass, centre, moments = self._own_body
        arm = skew(centre)
        return self._inertia_of(mass, mass * centre, moments + mass * arm @ arm.T)

    @property
    def inertia_by_numbers(self) -> F64:
        """(6 or 10, B, B) what becomes of that with each of its numbers."""
        mass, centre, _ = self._own_body
        out = []
        for i, j in _TENSOR:
            moments = np.zeros((3, 3))
            moments[i, j] = moments[j, i] = 1.0
            out.append(self._inertia_of(0.0, np.zeros(3), moments))
        if self.shifts:
            arm = skew(centre)
            out.append(self._inertia_of(mass, mass * centre, mass * arm @ arm.T))
            for axis in np.eye(3):
                both = skew(axis) @ arm.T
                out.append(self._inertia_of(0.0, mass * axis, mass * (both + both.T)))
        return np.array(out)

    @property
    def _own_body(self) -> tuple[float, F64, F64]:
        """The base's mass, its centre (3,) and its moments (3, 3) of inertia about that."""
        x = self.origin[self.of_inertia]
        moments = np.zeros((3, 3))
        for (i, j), of_both in zip(_TENSOR, x, strict=False):
            moments[i, j] = moments[j, i] = of_both
        if not self.shifts:
            return 0.0, np.zeros(3), moments
        return float(_SWING * np.exp(x[6])) / SWAY**2, np.array(x[7:]), moments

    def _inertia_of(self, mass: float, first: F64, second: F64) -> F64:
        """(B, B) inertia about shifts and turns of first (3,) and second (3, 3) moments of mass."""
        if not self.shifts:
            return second
        return np.block([[mass * np.eye(3), skew(first).T], [skew(first), second]])

    @property
    def inertia_of_parts(self) -> F64:
        """(R, R) inertia of parts that no load is, which is the base's own."""
        out = np.zeros((len(self.parts), len(self.parts)))
        if self.base:
            out[self.of_base, self.of_base] = self.own_inertia
        return out

    @property
    def late(self) -> F64:
        """(R,) times by which dampers make parts late [s]; of the base's, with unit compliances."""
        return np.asarray(_LATE * np.exp(_FAR * np.tanh(self._dampers / _FAR)) / self.arms**2)

    @property
    def later(self) -> F64:
        """(R,) by how much these grow with their numbers [s]."""
        return np.asarray(self.late * (1 - np.tanh(self._dampers / _FAR) ** 2))

    @property
    def _dampers(self) -> F64:
        """(R,) the numbers that make them."""
        return np.array(self.origin[self.of_dampers])

    @property
    def damped(self) -> F64:
        """(R, R) by how much each damper, of a spring of unit stiffness, makes all parts late."""
        C, base = np.eye(len(self.parts)), self.of_base
        C[base, base] = self.compliance[base, base]
        return C

    def about(self, x: F64) -> Bending:
        """The same about numbers x (S,); none yields against its load.

        What parts were found to yield is in ``compliance`` then.
        """
        P, R = len(self.basis), len(self.parts)
        C = np.array(self.compliance)
        root = np.sqrt(np.diag(C))
        for share, (a, b) in zip(x[self.of_crosses], self.crosses, strict=True):
            C[a, b] += root[a] * root[b] * share
            C[b, a] = C[a, b]
        grown = np.exp(0.5 * np.clip(x[P : P + R], -UNLIKE, UNLIKE))
        root, _ = roots(C * grown[:, None] * grown)
        origin = np.array(x)
        origin[P : self.of_crosses.stop] = 0.0
        return replace(self, compliance=root @ root, origin=origin)

    @property
    def lever(self) -> F64:
        """(3,) how far the base's frame is from the point about which it turns [m]."""
        return np.array(self.origin[-3:]) if self.base else np.zeros(3)

    @property
    def arms(self) -> F64:
        """(R,) levers at which parts of the base are as stiff as those that turn; 1 of others."""
        out = np.ones(len(self.parts))
        if self.shifts:
            out[-N_HINGES:-3] = SWAY
        return out

    @property
    def moved_parts(self) -> Int:
        """The joints, and all hinges of the base, that move where parts do."""
        joints = self.parts[: self.of_base.start]
        hinges = self._n_joints + np.arange(N_HINGES * self.base)
        return np.concatenate([joints, hinges])

    @property
    def moves(self) -> F64:
        """(D + 6, R) what joints and hinges do per unit of each part: a turned base shifts, too."""
        out = np.zeros((self._n_joints + N_HINGES, len(self.parts)))
        out[self.parts, np.arange(len(self.parts))] = 1.0
        if self.base:
            n = self._n_joints
            out[n : n + 3, -3:] = skew(self.lever).T
        return out

    def in_parts(self, beyond: F64) -> F64:
        """(N, R) what parts do where joints and hinges are moved by (N, D + 6)."""
        out = np.array(beyond[:, self.parts])
        if self.shifts:
            out[:, -6:-3] -= beyond[:, -3:] @ skew(self.lever)
        return out

    @property
    def _n_joints(self) -> int:
        """D."""
        return int(self.basis.shape[1] // N_INERTIAL)

    @property
    def base(self) -> bool:
        """Whether the base yields: its three turns are then the last parts."""
        return bool((self.parts >= self._n_joints).any())


def bends_of(unseen: Unseen | None) -> Bending | None:
    """The deflections under loads that nobody knows, which are the first of what is unseen."""
    first = unseen.several[0] if unseen is not None and unseen.several else unseen
    return first if isinstance(first, Bending) else None


def bends_among(unseen: Unseen | None) -> tuple[tuple[Bending, slice], ...]:
    """All deflections under loads that nobody knows, and which of all numbers make them."""
    out, first = [], 0
    for each in (unseen.several or (unseen,)) if unseen is not None else ():
        if isinstance(each, Bending):
            out.append((each, slice(first, first + each.n_numbers)))
        first += each.n_numbers
    return tuple(out)
