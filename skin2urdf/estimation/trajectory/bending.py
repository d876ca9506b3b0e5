"""What yields under the loads of one robot: joints, and the base below them.

A joint of stiffness K leaves its link at ``q = theta - tau / K`` where theta is the motor's
position. All torques are linear in the masses, centres of mass and inertias pi of the links:
``tau_k = Y_k(q, q', q'') pi`` (Atkeson, An and Hollerbach 1986; Pinocchio's joint torque
regressor). A base that gives way turns about its three axes by the moments that the same links put
on it, ``e = C tau`` with a symmetric C. So few numbers make all deflections: the pi that show in
some motion, and how much each part yields. As nobody knows the masses, only products of both tell.

The products are linear in either, and Newton's steps are taken in both: what a step has found
becomes the next one's known half (:func:`followed`). Two more effects go with the deflections that
were found: a damped spring is late, ``K e + d e' = -tau``, to first order ``e - (d / K) e'``; and
where the base turns about a point that is off its frame by h, this shifts by ``e x h``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Int, frozen
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, shift, turn
from skin2urdf.estimation.trajectory.torques import N_INERTIAL, inertial_sizes, regressors
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import filtered, first_derivative
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_SHOWS = 1e-3
"""Least share of the largest deflection that a direction of the parameters is kept for: of
milliradians, microradians, less than encoders and sensors tell."""
_MOST = 100
"""Loads at most, the largest: time goes with their square, and memory with their number."""
_NOTHING = 1e-9
"""Share of a load's largest parameter below which others are zero but for rounding."""
YIELD = 2e-2
"""Standard deviation of deflections [rad]; robots whose gears twist by more than a degree are not
built to be calibrated."""
SPINDLE = 0.1
"""Lever at which what slides is as stiff as what turns [m/rad]."""
_UNLIKE = 1.0
"""Standard deviation of the logarithm of how much a part yields more than the others."""
_CROSS = 0.3
"""Standard deviation of a base's turn about one axis by a moment about another, over that by one
about its own."""
LATE = 1e-2
"""Standard deviation of the time by which deflections lag behind torques [s]: that of a resonance
at 8 Hz, damped to a quarter of the critical."""
_DEPTH = 0.5
"""Standard deviation of the distance between the base's frame and the point about which the base
turns [m]: that of a stand."""
_PAIRS = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, eq=False)
class Bending(Unseen):
    """Deflections of R parts by P loads, as motions that encoders do not see.

    Its numbers are, in this order, the loads; the logarithms of what each part yields above
    ``compliance``; three shares of the base's turns by moments about other axes, if the base
    yields; R times by which deflections are late [s]; three levers of the base [m].

    Attributes:
        parts: (R,) joints and turns of the base that yield.
        compliance: (R, R) deflections per torque, of a scale of its own.
        basis: (P, 10 D) the inertial parameters of each load, in the order of Pinocchio's
            regressors.
    """

    parts: Int = field(kw_only=True)
    compliance: F64 = field(kw_only=True)
    basis: F64 = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "parts", frozen(self.parts, np.int64))
        object.__setattr__(self, "compliance", frozen(self.compliance))
        object.__setattr__(self, "basis", frozen(self.basis))

    @property
    def n_numbers(self) -> int:
        """S."""
        return len(self.spread)

    @cached_property
    def spread(self) -> F64:
        """(S,) what is known of the numbers before: standard deviations about zero."""
        P, R = len(self.basis), len(self.parts)
        known = [np.full(P, YIELD), np.full(R, _UNLIKE)]
        if self.base:
            known += [np.full(3, _CROSS)]
        known += [np.full(R, LATE)]
        if self.base:
            known += [np.full(3, _DEPTH)]
        return np.concatenate(known)

    @property
    def base(self) -> bool:
        """Whether the base yields: its three turns are then the last parts."""
        n_joints = self.basis.shape[1] // N_INERTIAL
        return bool((self.parts >= n_joints).any())


def bending(
    tree: KinematicTree,
    logs: Sequence[Trajectory],
    state: State,
    gravity: float,
    *,
    joints: bool,
    base: bool,
) -> Bending:
    """The deflections that the motion of the logs can make, as encoders have that motion.

    Args:
        tree: the structure.
        logs: trajectories.
        state: placements, and gravity's direction per log.
        gravity: its magnitude [m/s^2].
        joints: whether joints yield.
        base: whether the base does.

    Returns:
        Deflections of parts that all yield alike.
    """
    D = tree.n_joints
    turns = [turn(tree, axis) for axis in range(3)]
    parts = np.array([*(range(D) if joints else ()), *(turns if base else ())], dtype=np.int64)
    # What slides is as stiff as what turns, at the lever of a spindle.
    lever = np.where(np.append(tree.prismatic, np.zeros(N_HINGES, dtype=bool)), SPINDLE, 1.0)[parts]
    unit = lever**2
    size = inertial_sizes(state)
    square = np.zeros((len(parts), len(size), len(size)))
    count = 0
    for g, log in enumerate(logs):
        for Y, _ in regressors(tree, state, g, gravity, log, base=base):
            deflection = Y[:, parts] * size * unit[:, None]
            square += np.einsum("nri,nrj->rij", deflection, deflection, optimize=True)
            count += len(Y)
    lam, V = np.linalg.eigh(np.einsum("r,rij->ij", lever**-2, square) / count)
    largest = max(float(lam[-1]), 1e-300)
    shows = np.flatnonzero(lam > _SHOWS**2 * largest)[::-1][:_MOST]
    basis = (size[:, None] * V[:, shows] / np.sqrt(largest)).T
    still = Bending(
        np.zeros(0, dtype=np.int64),
        tuple(np.zeros((len(log.q), 0)) for log in logs),
        number=np.zeros(0, dtype=np.int64),
        parts=parts,
        compliance=np.diag(unit),
        basis=basis,
    )
    return followed(still, tree, logs, state, gravity, np.zeros(still.n_numbers))[0]


def followed(
    found: Bending,
    tree: KinematicTree,
    logs: Sequence[Trajectory],
    state: State,
    gravity: float,
    x: F64,
) -> tuple[Bending, F64]:
    """The same deflections along the motion of the links, which is what torques go with.

    Args:
        found: deflections along some motion, by which the links' is known.
        tree: the structure.
        logs: trajectories as the encoders have them.
        state: placements, and gravity's direction per log.
        gravity: its magnitude [m/s^2].
        x: (S,) its numbers.

    Returns:
        The deflections, and their numbers: what the parts were found to yield is in
        ``compliance``.
    """
    P, R = len(found.basis), len(found.parts)
    C = _compliance(found, x)
    x = np.array(x)
    x[P : P + R + 3 * found.base] = 0.0
    links = [found.moved(log, g, x) if len(found.joint) else log for g, log in enumerate(logs)]
    deflections = [
        _beyond(tree, log, moved)[:, found.parts] for log, moved in zip(logs, links, strict=True)
    ]
    most = int(np.argmax(np.max([np.ptp(e, axis=0) for e in deflections], axis=0)))
    entries = _entries(tree, found, C, most)
    motions = []
    for g, (log, moved, deflection) in enumerate(zip(logs, links, deflections, strict=True)):
        loads, torques = _under_loads(tree, state, g, gravity, log, moved, found, entries, C, x[:P])
        effects = {
            "torque": torques,
            "rate": first_derivative(deflection, log.rate),
            "deflection": deflection,
        }
        others = [e.factor * effects[e.of][:, e.part] for e in entries[loads.shape[1] :]]
        motions.append(np.column_stack([loads, *others]))
    along = replace(
        found,
        joint=np.array([e.joint for e in entries]),
        motions=tuple(motions),
        number=np.array([e.number for e in entries]),
        compliance=C,
    )
    return along, x


def _beyond(tree: KinematicTree, log: Trajectory, moved: Trajectory) -> F64:
    """(N, D + 6) by how much joints, and the base, are beyond what encoders say."""
    beyond = np.zeros((len(log.q), tree.n_joints + N_HINGES))
    beyond[:, : moved.q.shape[1]] = moved.q
    beyond[:, : tree.n_joints] -= log.q
    return beyond


class _Entry(NamedTuple):
    """What makes one motion: a load (its number) on a part, or what was found of a part."""

    joint: int
    number: int
    of: str
    part: int
    factor: float


def _entries(tree: KinematicTree, found: Bending, C: F64, most: int) -> list[_Entry]:
    """All motions of a bending robot, those by loads first.

    What one part yields is the scale of all: that of the part which yields ``most``.
    """
    D, P, R = tree.n_joints, len(found.basis), len(found.parts)
    parts, root = found.parts.tolist(), np.sqrt(np.diag(C))
    moments = np.abs(found.basis).reshape(P, D, N_INERTIAL).max(axis=2, initial=0.0)
    out = []
    for r, k in enumerate(parts):
        carried = [j for j in range(D) if k >= D or k in tree.chain(j)]
        does = moments[:, carried].max(axis=1, initial=0.0) > _NOTHING * moments.max(axis=1)
        out += [_Entry(k, int(p), "load", r, 1.0) for p in np.flatnonzero(does)]
    out += [_Entry(k, P + r, "torque", r, -C[r, r] * (r != most)) for r, k in enumerate(parts)]
    number, turns = P + R, range(R - 3, R)
    for i, j in _PAIRS if found.base else ():
        for one, other in ((turns[i], turns[j]), (turns[j], turns[i])):
            factor = -float(root[one] * root[other])
            out.append(_Entry(parts[one], number, "torque", other, factor))
        number += 1
    out += [_Entry(k, number + r, "rate", r, -1.0) for r, k in enumerate(parts)]
    number += R
    for h in range(3 if found.base else 0):
        # e x h shifts along the two other axes.
        i, j = (h + 1) % 3, (h + 2) % 3
        out.append(_Entry(shift(tree, i), number + h, "deflection", turns[j], 1.0))
        out.append(_Entry(shift(tree, j), number + h, "deflection", turns[i], -1.0))
    return out


def _under_loads(
    tree: KinematicTree,
    state: State,
    g: int,
    gravity: float,
    log: Trajectory,
    moved: Trajectory,
    found: Bending,
    entries: Sequence[_Entry],
    C: F64,
    loads: F64,
) -> tuple[F64, F64]:
    """Deflections (N, entries) per unit of each load, and torques (N, R) of all together."""
    of_loads = [e for e in entries if e.of == "load"]
    part, number = [e.part for e in of_loads], [e.number for e in of_loads]
    per_unit = np.empty((len(log.q), len(of_loads)))
    torques = np.empty((len(log.q), len(found.parts)))
    for Y, at in regressors(tree, state, g, gravity, moved, base=found.base):
        tau = Y[:, found.parts] @ found.basis.T
        torques[at] = tau @ loads
        per_unit[at] = -np.einsum("rs,nsp->nrp", C, tau, optimize=True)[:, part, number]
    # Above the low-pass, accelerations are noise, and more so with every differentiation.
    return filtered(per_unit, log.taps), filtered(torques, log.taps)


def _compliance(found: Bending, x: F64) -> F64:
    """(R, R) what parts yield by the numbers that were found."""
    P, R = len(found.basis), len(found.parts)
    C = np.array(found.compliance)
    root = np.sqrt(np.diag(C))
    if found.base:
        for n, (i, j) in enumerate(_PAIRS):
            a, b = R - 3 + i, R - 3 + j
            C[a, b] += root[a] * root[b] * x[P + R + n]
            C[b, a] = C[a, b]
    grown = np.exp(0.5 * np.clip(x[P : P + R], -_UNLIKE, _UNLIKE))
    return np.asarray(C * grown[:, None] * grown)
