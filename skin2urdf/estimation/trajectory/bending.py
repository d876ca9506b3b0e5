"""What yields under the loads of one robot: joints, and the base below them.

A joint of stiffness K leaves its link at ``q = theta - tau / K`` where theta is the motor's
position. All torques are linear in the masses, centres of mass and inertias pi of the links:
``tau_k = Y_k(q, q', q'') pi`` (Atkeson, An and Hollerbach 1986; Pinocchio's joint torque
regressor). A base that gives way turns about its three axes by the moments that the same links put
on it, ``e = C tau`` with a symmetric C. So few numbers make all deflections: the pi that show in
some motion, and how much each part yields. As nobody knows the masses, only products of both tell.

The products are linear in either, and Newton's steps are taken in both: what a step has found
becomes the next one's known half (:func:`followed`). More goes with the deflections that were
found: a damped spring is late, ``K e + d e' = -tau``; a base has inertia of its own, which makes
this ``K e + d e' + J e'' = -tau``; and where the base turns about a point from which its frame is
off by h, this shifts by ``e x h``, and what the robot's forces f on the frame add to the moment is
``h x f``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, shift, turn
from skin2urdf.estimation.trajectory.torques import N_INERTIAL, inertial_sizes, regressors
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.geometry.so3 import skew
from skin2urdf.signals.filters import filtered, first_derivative, second_derivative
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
_SWING = (2 * np.pi * 25.0) ** -2
"""Standard deviation of the base's own inertia over its stiffness [s^2]: that of a resonance at
25 Hz without the robot."""
_DEPTH = 0.5
"""Standard deviation of the distance between the base's frame and the point about which the base
turns [m]: that of a stand."""
_PAIRS = ((0, 1), (0, 2), (1, 2))
_TENSOR = ((0, 0), (1, 1), (2, 2), *_PAIRS)


@dataclass(frozen=True, eq=False)
class Bending(Unseen):
    """Deflections of R parts by P loads, as motions that encoders do not see.

    Its numbers are, in this order, the loads; the logarithms of what each part yields above
    ``compliance``; three shares of the base's turns by moments about other axes, if the base
    yields; R times by which deflections are late [s]; if the base yields, its own moments and
    products of inertia over its stiffness [s^2], and how far its frame is from the point about
    which it turns, along its axes [m].

    Attributes:
        parts: (R,) joints and turns of the base that yield.
        compliance: (R, R) deflections per torque, of a scale of its own.
        basis: (P, 10 D) the inertial parameters of each load, in the order of Pinocchio's
            regressors.
    """

    parts: Int = field(kw_only=True)
    compliance: F64 = field(kw_only=True)
    basis: F64 = field(kw_only=True)

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
            known += [np.full(len(_TENSOR), _SWING), np.full(3, _DEPTH)]
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
    links = [found.moved(log, g, x) if len(found.joint) else log for g, log in enumerate(logs)]
    deflections = [
        _beyond(tree, log, moved)[:, found.parts] for log, moved in zip(logs, links, strict=True)
    ]
    most = int(np.argmax(np.max([np.ptp(e, axis=0) for e in deflections], axis=0)))
    x, origin = np.array(x), np.zeros(found.n_numbers)
    x[P : P + R + 3 * found.base] = 0.0
    if found.base:
        origin[-3:] = x[-3:]
    along = replace(found, compliance=C, origin=origin)
    entries = _entries(tree, along, most)
    motions = []
    for g, (log, moved, deflection) in enumerate(zip(logs, links, deflections, strict=True)):
        loads, effects = _under_loads(tree, state, g, gravity, log, moved, along, entries, x[:P])
        effects["deflection"] = deflection
        effects["rate"] = first_derivative(deflection, log.rate)
        if found.base:
            acceleration = second_derivative(deflection, log.rate)
            effects["acceleration"] = _smooth(acceleration, log.taps)
        others = [e.factor * effects[e.of][:, e.part] for e in entries[loads.shape[1] :]]
        motions.append(np.column_stack([loads, *others]))
    along = replace(
        along,
        joint=np.array([e.joint for e in entries]),
        motions=tuple(motions),
        number=np.array([e.number for e in entries]),
    )
    return along, x


def _beyond(tree: KinematicTree, log: Trajectory, moved: Trajectory) -> F64:
    """(N, D + 6) by how much joints, and the base, are beyond what encoders say."""
    beyond = np.zeros((len(log.q), tree.n_joints + N_HINGES))
    beyond[:, : moved.q.shape[1]] = moved.q
    beyond[:, : tree.n_joints] -= log.q
    return beyond


class _Entry(NamedTuple):
    """What makes one motion: a load (its number) on a part, or what was found of a part.

    Of loads, the parts R and on are the shifts of the base's frame.
    """

    joint: int
    number: int
    of: str
    part: int
    factor: float


def _entries(tree: KinematicTree, found: Bending, most: int) -> list[_Entry]:
    """All motions of a bending robot, those by loads first.

    What one part yields is the scale of all: that of the part which yields ``most``.
    """
    D, P, R = tree.n_joints, len(found.basis), len(found.parts)
    parts, C = found.parts.tolist(), found.compliance
    moments = np.abs(found.basis).reshape(P, D, N_INERTIAL).max(axis=2, initial=0.0)
    out = []
    for r, k in enumerate(parts):
        carried = [j for j in range(D) if k >= D or k in tree.chain(j)]
        does = moments[:, carried].max(axis=1, initial=0.0) > _NOTHING * moments.max(axis=1)
        out += [_Entry(k, int(p), "load", r, 1.0) for p in np.flatnonzero(does)]
    if found.lever.any():
        out += [_Entry(shift(tree, i), p, "load", R + i, 1.0) for i in range(3) for p in range(P)]
    number = P
    others = [
        _Entry(k, number + r, "torque", r, -C[r, r] * (r != most)) for r, k in enumerate(parts)
    ]
    number += R + 3 * found.base
    others += [_Entry(k, number + r, "rate", r, -1.0) for r, k in enumerate(parts)]
    if found.base:
        others += _of_base(tree, found, P + R, number + R)
        others += _shifts(tree, found, others)
    return out + others


def _shifts(tree: KinematicTree, found: Bending, others: Sequence[_Entry]) -> list[_Entry]:
    """Shifts of the base's frame by all that turns it."""
    by_turn = skew(found.lever).T
    return [
        each._replace(
            joint=shift(tree, i), factor=each.factor * by_turn[i, each.joint - turn(tree, 0)]
        )
        for each in others
        if each.joint >= turn(tree, 0)
        for i in range(3)
    ]


def _of_base(tree: KinematicTree, found: Bending, cross: int, tensor: int) -> list[_Entry]:
    """Motions of the base by what is its own.

    Args:
        tree: the structure.
        found: what yields.
        cross: the first number of turns by moments about other axes.
        tensor: the first one of the base's inertia.
    """
    R = len(found.parts)
    parts, C, turns = found.parts.tolist(), found.compliance, range(R - 3, R)
    root = np.sqrt(np.diag(C))
    out = []
    for n, (i, j) in enumerate(_PAIRS):
        for one, other in ((turns[i], turns[j]), (turns[j], turns[i])):
            factor = -float(root[one] * root[other])
            out.append(_Entry(parts[one], cross + n, "torque", other, factor))
    for n, (i, j) in enumerate(_TENSOR):
        for one, other in {(turns[i], turns[j]), (turns[j], turns[i])}:
            size = float(root[one] * root[other])
            out += [
                _Entry(parts[r], tensor + n, "acceleration", other, -C[r, one] / size)
                for r in turns
            ]
    for h in range(3):
        # h x f turns, and e x h shifts, along the two other axes.
        i, j, number = (h + 1) % 3, (h + 2) % 3, tensor + len(_TENSOR) + h
        for r in turns:
            out.append(_Entry(parts[r], number, "force", j, C[r, turns[i]]))
            out.append(_Entry(parts[r], number, "force", i, -C[r, turns[j]]))
        out.append(_Entry(shift(tree, i), number, "deflection", turns[j], 1.0))
        out.append(_Entry(shift(tree, j), number, "deflection", turns[i], -1.0))
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
    loads: F64,
) -> tuple[F64, dict[str, F64]]:
    """What loads do along the motion of the links.

    Returns:
        Deflections (N, entries) per unit of each load, and torques (N, R) and forces (N, 3) on the
        base's frame of all together.
    """
    of_loads = [e for e in entries if e.of == "load"]
    part, number = [e.part for e in of_loads], [e.number for e in of_loads]
    C, about = found.compliance, skew(found.lever)
    per_unit = np.empty((len(log.q), len(of_loads)))
    torques = np.empty((len(log.q), len(found.parts)))
    forces = np.zeros((len(log.q), 3))
    for Y, at in regressors(tree, state, g, gravity, moved, base=found.base):
        tau = Y[:, found.parts] @ found.basis.T
        if found.base:
            force = Y[:, shift(tree, 0) : shift(tree, 3)] @ found.basis.T
            tau[:, -3:] += np.einsum("ij,njp->nip", about, force)
            forces[at] = force @ loads
        torques[at] = tau @ loads
        bent = -np.einsum("rs,nsp->nrp", C, tau, optimize=True)
        if found.base:
            bent = np.concatenate([bent, np.einsum("ji,njp->nip", about, bent[:, -3:])], axis=1)
        per_unit[at] = bent[:, part, number]
    # Above the low-pass, accelerations are noise, and more so with every differentiation.
    return _smooth(per_unit, log.taps), {
        "torque": _smooth(torques, log.taps),
        "force": _smooth(forces, log.taps),
    }


def _smooth(x: F64, taps: F64) -> F64:
    """Low-pass (N, ...) and add back what the residual holds, so that little is lost that passes.

    A gain of H becomes one of ``1 - (1 - H)^2`` (twicing: Tukey 1977).
    """
    once = filtered(x, taps)
    return 2 * once - filtered(once, taps)


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
