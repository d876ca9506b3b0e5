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
``h x f``. Nothing of the base is divided by its compliance, which may be 0 about some axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.coarser import coarser, on_grid
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, shift, turn
from skin2urdf.estimation.trajectory.springs import Springs, roots
from skin2urdf.estimation.trajectory.torques import (
    N_INERTIAL,
    bodies,
    inertial_sizes,
    joint_inertias,
    loads_of,
    regressors,
)
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.geometry.so3 import skew
from skin2urdf.signals.filters import (
    filtered,
    first_derivative,
    low_pass,
    noise_bandwidth,
    second_derivative,
)
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

if TYPE_CHECKING:
    import pinocchio as pin

_SHOWS = 1e-3
"""Least share of the largest deflection that a direction of the parameters is kept for: of
milliradians, microradians, less than encoders and sensors tell."""
_MOST = 100
"""Loads at most, the largest: time goes with their square, and memory with their number."""
_NEWTON = 8
"""Steps at most to the deflections; each leaves a tenth or less of the error."""
_EXACT = 3e-4
"""Length of a step, over the largest deflection, from which the next would change nothing that
shows."""
_BALANCE = 1e-2
"""Length of a step, over the largest deflection, up to which loads and deflections are in balance
where no further step becomes shorter."""
_PER_CUTOFF = 7.0
"""Samples per second over the cutoff that deflections are worked out at: there differences of
eighth order are exact to 1e-4."""
_WIDER = 1.5
"""Cutoff of the low-pass in which deflections are solved for, over that of the log: of what passes
this, it leaves all."""
_SLOWLY = 2
"""Samples from one at which inertias are worked out to the next: some 30 ms."""
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
_LATE, _ALIKE = 2e-3, 1.5
"""Time by which dampers make deflections late [s], and the standard deviation of its logarithm: a
twentieth of the critical damping at 8 Hz, up to a quarter of it at 3 Hz."""
_FAR = 3.0
"""Logarithm that it does not reach: nothing is late by more than a sixth of a swing at 4 Hz."""
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
        known = [np.full(P, YIELD), np.full(R, _UNLIKE)]
        if self.base:
            known += [np.full(3, _CROSS)]
        known += [np.full(R, _ALIKE)]
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
        Deflections of parts that all yield alike, by loads of none.
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


def unsettled(found: Bending, logs: Sequence[Trajectory]) -> Bending:
    """The same deflections by the same loads of other logs, of which nothing is known yet."""
    none = np.zeros(0, dtype=np.int64)
    motions = tuple(np.zeros((len(log.q), 0)) for log in logs)
    return replace(found, joint=none, number=none, motions=motions, settled=(), every=())


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
        found: deflections along some motion, by which the links' is nearly known.
        tree: the structure.
        logs: trajectories as the encoders have them.
        state: placements, and gravity's direction per log.
        gravity: its magnitude [m/s^2].
        x: (S,) its numbers.

    Returns:
        The deflections about these numbers, and the numbers: what the parts were found to yield is
        in ``compliance``.
    """
    there = balanced(found, tree, logs, state, gravity, x)
    return there.moved_by_numbers(), there.x


def balanced(
    found: Bending,
    tree: KinematicTree,
    logs: Sequence[Trajectory],
    state: State,
    gravity: float,
    x: F64,
) -> Balance:
    """Loads and deflections in balance; arguments as those of :func:`followed`.

    Loads go with the motion of the links, of which deflections are a part. They are solved for by
    Newton's method, with :class:`~skin2urdf.estimation.trajectory.springs.Springs` as its
    derivative.
    """
    P, R = len(found.basis), len(found.parts)
    before = [_beyond(tree, log, found.moved(log, g, x)) for g, log in enumerate(logs)]
    about = replace(found, compliance=_compliance(found, x))
    x = np.array(x)
    x[P : P + R + 3 * found.base] = 0.0
    about = replace(about, origin=x)
    sizes, of_logs, bent, all_springs, every, holds = [], [], [], [], [], True
    for g, (log, beyond) in enumerate(zip(logs, before, strict=True)):
        step = max(1, int(log.rate / (_PER_CUTOFF * noise_bandwidth(log.taps, log.rate))))
        within = slice(int(log.kept[0]) // step, int(log.kept[-1]) // step + 1)
        of_log = _OfLog(tree, state, g, gravity, coarser(log, step), about, within)
        beyond = beyond[::step]
        springs = of_log.springs(beyond)
        last = np.inf
        for _ in range(_NEWTON):
            nearer, change = of_log.nearer(beyond, springs)
            if not change < last:
                holds = holds and last < _BALANCE
                break
            beyond, last = nearer, change
            if change < _EXACT:
                break
        sizes.append(len(log.q))
        of_logs.append(of_log)
        bent.append(beyond)
        all_springs.append(springs)
        every.append(step)
    moved = [*found.parts.tolist(), *((shift(tree, i) for i in range(3)) if found.base else ())]
    deflections = replace(
        about,
        joint=np.array(moved),
        motions=tuple(np.zeros((len(beyond), len(moved))) for beyond in bent),
        number=np.zeros(len(moved), dtype=np.int64),
        settled=tuple(map(on_grid, bent, every, sizes)),
        every=tuple(every),
        holds=holds,
    )
    return Balance(deflections, x, tuple(of_logs), tuple(bent), tuple(all_springs))


@dataclass(frozen=True, eq=False)
class Balance:
    """Deflections in balance with their loads, before it is asked what numbers do to them.

    They tell whether a step leads nearer. Half of the steps that are tried do not, and what each
    number does is twice the work.

    Attributes:
        deflections: about the numbers, of which none moves anything.
        x: (S,) the numbers.
        of_logs: per log, what loads do along it.
        bent: per log (M, D + 6) deflections at each so many-th sample [rad or m].
        springs: per log, how these follow their loads.
    """

    deflections: Bending
    x: F64
    of_logs: tuple[_OfLog, ...]
    bent: tuple[F64, ...]
    springs: tuple[Springs, ...]

    def moved_by_numbers(self) -> Bending:
        """The deflections with what each number does to them."""
        still = self.deflections
        motions = [
            of_log.motions(beyond, springs).reshape(len(beyond), -1)
            for of_log, beyond, springs in zip(self.of_logs, self.bent, self.springs, strict=True)
        ]
        numbers = np.arange(still.n_numbers)
        most = int(
            np.argmax(np.max([np.ptp(e[:, still.parts], axis=0) for e in still.settled], axis=0))
        )
        held = np.ones((len(still.joint), len(numbers)), dtype=bool)
        held[:, len(still.basis) + most] = False  # what one part yields is the scale of all
        shows = held & (np.max([np.abs(m).max(axis=0) for m in motions], axis=0) > 0).reshape(
            held.shape
        )
        joint, number = np.broadcast_arrays(still.joint[:, None], numbers)
        return replace(
            still,
            joint=joint[shows],
            motions=tuple(m[:, shows.ravel()] for m in motions),
            number=number[shows],
        )


def _beyond(tree: KinematicTree, log: Trajectory, moved: Trajectory) -> F64:
    """(N, D + 6) by how much joints, and the base, are beyond what encoders say."""
    beyond = np.zeros((len(log.q), tree.n_joints + N_HINGES))
    beyond[:, : moved.q.shape[1]] = moved.q
    beyond[:, : tree.n_joints] -= log.q
    return beyond


@dataclass(frozen=True, eq=False)
class _OfLog:
    """What loads do along a log, and what these deflections do to the loads.

    Attributes:
        tree: the structure.
        state: placements, and gravity's direction per log.
        g: number of the log.
        gravity: its magnitude [m/s^2].
        log: as the encoders have it.
        found: what yields, about its numbers.
        within: samples that are compared; what a log begins and ends with swings as nobody knows.
    """

    tree: KinematicTree
    state: State
    g: int
    gravity: float
    log: Trajectory
    found: Bending
    within: slice

    def nearer(self, beyond: F64, springs: Springs) -> tuple[F64, float]:
        """(N, D + 6) deflections after a step of Newton's method, and the length of the step.

        Args:
            beyond: (N, D + 6) where it begins [rad or m].
            springs: how deflections follow their loads there.
        """
        parts = self.found.parts
        bent = self._bent(beyond, self._torques(beyond)) - self._absent
        lacking = self._smooth(bent - beyond[:, parts])
        # What springs ring with beyond the low-pass, none would take away again.
        step = self._smooth(springs.bent(lacking[..., None])[..., 0])
        nearer = (beyond[:, parts] + step) @ self._moves.T
        largest = float(np.abs(nearer[self.within, parts]).max(initial=1e-300))
        return nearer, float(np.abs(step[self.within]).max(initial=0.0)) / largest

    def motions(self, beyond: F64, springs: Springs) -> F64:
        """(N, R or R + 3, S) what parts do, and the base's shifts, per unit of each number.

        Args:
            beyond: (N, D + 6) deflections about which that is [rad or m].
            springs: how deflections follow their loads there.
        """
        found, C = self.found, self.found.compliance
        P, R, S = len(found.basis), len(found.parts), found.n_numbers
        tau, force = self._under(beyond, found.basis)
        out = np.zeros((len(beyond), R, S))
        out[..., :P] = -np.einsum("rs,nsp->nrp", C, tau, optimize=True)
        robot, force = (each @ found.origin[:P] for each in (tau, force))
        rates = first_derivative(beyond[:, found.parts], self.log.rate)
        # The base's dampers and its own inertia load its springs as the robot does.
        late, a = self._late, second_derivative(beyond[:, found.parts], self.log.rate)
        tau = robot + a @ self._own_inertia()
        tau[:, self._of_base] += rates[:, self._of_base] * late[self._of_base]
        bent = -tau @ C
        r = np.arange(R)
        out[:, r, P + r] = 0.5 * bent
        out[:, :, P : P + R] -= 0.5 * np.einsum("ri,ni->nri", C, tau)
        first = self._of_damping.start
        sooner = 1 - np.tanh(found.origin[self._of_damping] / _FAR) ** 2
        out[:, :, first : first + R] = -np.einsum(
            "ri,ni->nri", self._damped, rates * (late * sooner)
        )
        if found.base:
            self._write_base(out, tau, a)
            for i in range(3):
                out[:, :, S - 3 + i] = -self._deeper(i, robot, force, beyond) @ C
        out *= self._there[:, None, None]
        bent = self._smooth(springs.bent(out))
        if not found.base:
            return bent
        shifts = np.einsum("ji,njs->nis", skew(found.lever), bent[:, -3:])
        for i in range(3):
            shifts[:, :, S - 3 + i] += beyond[:, self._turns] @ skew(np.eye(3)[i])
        return np.concatenate([bent, shifts], axis=1)

    def springs(self, beyond: F64) -> Springs:
        """How deflections follow their loads along a motion.

        Args:
            beyond: (N, D + 6) of the links beyond the encoders [rad or m].
        """
        found = self.found
        thin = slice(None, None, _SLOWLY)
        moved = self._moved(beyond)
        moved = replace(moved, q=moved.q[thin], qd=moved.qd[thin], qdd=moved.qdd[thin])
        q = moved.q
        of_all = joint_inertias(self.tree, self.state, moved, self._parameters, base=found.base)
        moves = self._moves[: of_all.shape[1]]
        inertia = moves.T @ of_all @ moves + self._own_inertia()
        at = np.minimum(np.arange(len(beyond)) / _SLOWLY, len(q) - 1)
        low = at.astype(np.int64)
        high, part = np.minimum(low + 1, len(q) - 1), (at - low)[:, None, None]
        inertia = (1 - part) * inertia[low] + part * inertia[high]
        return Springs(found.compliance, inertia, self._damped * self._late, self.log.rate)

    def _smooth(self, x: F64) -> F64:
        """Low-pass (N, ...) by what loses nothing that passes the log's own low-pass.

        Springs answer anything at once, so that a wide one will do, which leaves no part of what
        passes behind: what is left behind comes after in every further step. A gain of H becomes
        one of ``1 - (1 - H)^2`` (twicing: Tukey 1977).
        """
        taps, rate = self.log.taps, self.log.rate
        taps = low_pass(_WIDER * noise_bandwidth(taps, rate), rate)
        twice = 2 * np.pad(taps, len(taps) // 2) - np.convolve(taps, taps)
        return filtered(x, twice)

    @cached_property
    def _there(self) -> F64:
        """(N,) share of the loads that is there: before and behind what is compared they fade.

        Differences and filters lack samples at the ends; what resonates would swing by that.
        """
        n, within = len(self.log.q), self.within
        at = [0, within.start, within.stop - 1, n - 1]
        return np.asarray(np.sin(np.pi / 2 * np.interp(np.arange(n), at, [0, 1, 1, 0])) ** 2)

    @cached_property
    def _absent(self) -> F64:
        """(N, R) deflections by the share that is not."""
        none = np.zeros((len(self.log.q), self.tree.n_joints + N_HINGES))
        return np.asarray((1 - self._there)[:, None] * self._bent(none, self._torques(none)))

    @property
    def _of_damping(self) -> slice:
        """Numbers by which parts are late."""
        P, R = len(self.found.basis), len(self.found.parts)
        first = P + R + 3 * self.found.base
        return slice(first, first + R)

    @property
    def _late(self) -> F64:
        """(R,) times by which dampers make parts late [s]."""
        found = self.found.origin[self._of_damping] / _FAR
        return np.asarray(_LATE * np.exp(_FAR * np.tanh(found)))

    @property
    def _damped(self) -> F64:
        """(R, R) by how much each damper, of a spring of unit stiffness, makes all parts late."""
        C, of_base = np.eye(len(self.found.parts)), self._of_base
        C[of_base, of_base] = self.found.compliance[of_base, of_base]
        return C

    @property
    def _of_base(self) -> slice:
        """The parts that are the base's turns."""
        R = len(self.found.parts)
        return slice(R - 3 * self.found.base, R)

    @property
    def _moves(self) -> F64:
        """(D + 6, R) what joints and hinges do per unit of each part: a turned base shifts, too."""
        tree, parts = self.tree, self.found.parts
        out = np.zeros((tree.n_joints + N_HINGES, len(parts)))
        out[parts, np.arange(len(parts))] = 1.0
        if self.found.base:
            out[self._shifts, self._of_base] = skew(self.found.lever).T
        return out

    @property
    def _shifts(self) -> slice:
        """Columns of the base's shifts."""
        return slice(shift(self.tree, 0), turn(self.tree, 0))

    @property
    def _turns(self) -> slice:
        """Columns of the base's turns."""
        return slice(turn(self.tree, 0), turn(self.tree, 0) + 3)

    def _moved(self, beyond: F64) -> Trajectory:
        """The log with the motion of the links."""
        log, n = self.log, self.tree.n_joints + N_HINGES * self.found.base
        e = beyond[:, :n]
        still = np.zeros((len(e), n - log.q.shape[1]))
        return replace(
            log,
            q=np.hstack([log.q, still]) + e,
            qd=np.hstack([log.qd, still]) + first_derivative(e, log.rate),
            qdd=np.hstack([log.qdd, still]) + second_derivative(e, log.rate),
        )

    @property
    def _parameters(self) -> F64:
        """(10 D,) inertial parameters of what joints carry, as far as deflections tell."""
        found = self.found
        return np.asarray(found.origin[: len(found.basis)] @ found.basis)

    @cached_property
    def _bodies(self) -> list[pin.Inertia]:
        """(D,) what joints carry."""
        return bodies(self._parameters)

    def _torques(self, beyond: F64) -> F64:
        """(N, R) torques of parts by these."""
        moved, base = self._moved(beyond), self.found.base
        tau = loads_of(self.tree, self.state, self.g, self.gravity, moved, self._bodies, base=base)
        return np.asarray(tau @ self._moves[: tau.shape[1]])

    def _under(self, beyond: F64, basis: F64) -> tuple[F64, F64]:
        """Torques of parts (N, R, P) and forces on the base (N, 3, P) per unit of each load."""
        tree, found, moved = self.tree, self.found, self._moved(beyond)
        torques = np.empty((len(moved.q), len(found.parts), len(basis)))
        forces = np.zeros((len(moved.q), 3, len(basis)))
        for Y, at in regressors(tree, self.state, self.g, self.gravity, moved, base=found.base):
            torques[at] = self._moves[: Y.shape[1]].T @ Y @ basis.T
            if found.base:
                forces[at] = Y[:, self._shifts] @ basis.T
        return torques, forces

    def _bent(self, beyond: F64, tau: F64) -> F64:
        """(N, R) deflections by loads, where they are late by others.

        Args:
            beyond: (N, D + 6) deflections that the loads go with [rad or m].
            tau: (N, R) torques.
        """
        parts, rate = self.found.parts, self.log.rate
        rates, a = (of(beyond[:, parts], rate) for of in (first_derivative, second_derivative))
        by_springs = (tau + a @ self._own_inertia()) @ self.found.compliance
        return np.asarray(-by_springs - rates * self._late @ self._damped)

    def _own_inertia(self) -> F64:
        """(R, R) inertia of the base itself, of which the numbers are over its stiffness."""
        found, R = self.found, len(self.found.parts)
        out = np.zeros((R, R))
        if found.base:
            tensor = self._of_damping.stop + np.arange(len(_TENSOR))
            for n, (i, j) in zip(tensor, _TENSOR, strict=True):
                i, j = R - 3 + i, R - 3 + j
                out[i, j] = out[j, i] = found.origin[n]
        return out

    def _write_base(self, out: F64, tau: F64, a: F64) -> None:
        """Write what the base's cross compliances and its own inertia do into loads.

        Args:
            out: (N, R, S) the loads.
            tau: (N, R) what loads the springs.
            a: (N, R) the parts' accelerations.
        """
        found, C = self.found, self.found.compliance
        P, R = len(found.basis), len(found.parts)
        root = np.sqrt(np.diag(C)[-3:])
        for n, (i, j) in enumerate(_PAIRS):
            for one, other in ((i, j), (j, i)):
                out[:, R - 3 + one, P + R + n] = -root[one] * root[other] * tau[:, R - 3 + other]
        first = self._of_damping.stop
        for n, (i, j) in enumerate(_TENSOR):
            for one, other in {(i, j), (j, i)}:
                out[:, :, first + n] -= a[:, R - 3 + other, None] * C[:, R - 3 + one]

    def _deeper(self, axis: int, robot: F64, force: F64, beyond: F64) -> F64:
        """(N, R) loads per metre that the base turns about a point further off along an axis.

        The lever of the forces is longer, and the frame shifts more, which moves all links.

        Args:
            axis: x, y or z.
            robot: (N, R) what the robot loads the springs with.
            force: (N, 3) what it pushes the frame with.
            beyond: (N, D + 6) of the links beyond the encoders.
        """
        unit = skew(np.eye(3)[axis])
        shifted = np.array(beyond)
        shifted[:, self._shifts] += beyond[:, self._turns] @ unit
        loads = self._torques(shifted) - robot
        loads[:, self._of_base] += force @ unit.T
        return np.asarray(loads)


def _compliance(found: Bending, x: F64) -> F64:
    """(R, R) what parts yield by the numbers that were found; none yields against its load."""
    P, R = len(found.basis), len(found.parts)
    C = np.array(found.compliance)
    root = np.sqrt(np.diag(C))
    if found.base:
        for n, (i, j) in enumerate(_PAIRS):
            a, b = R - 3 + i, R - 3 + j
            C[a, b] += root[a] * root[b] * x[P + R + n]
            C[b, a] = C[a, b]
    grown = np.exp(0.5 * np.clip(x[P : P + R], -_UNLIKE, _UNLIKE))
    root, _ = roots(C * grown[:, None] * grown)
    return np.asarray(root @ root)
