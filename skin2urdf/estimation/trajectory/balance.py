"""Loads in balance with the deflections that they make.

Loads go with the motion of the links, of which deflections are a part, and deflections with the
loads: both are solved for by Newton's method.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.bending import SPINDLE, Bending
from skin2urdf.estimation.trajectory.coarser import coarser, on_grid
from skin2urdf.estimation.trajectory.loaded import Loaded
from skin2urdf.estimation.trajectory.skeleton import N_HINGES
from skin2urdf.estimation.trajectory.springs import Springs
from skin2urdf.estimation.trajectory.torques import inertial_sizes, regressors
from skin2urdf.signals.filters import noise_bandwidth
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

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
        base: whether the base turns under its load.

    Returns:
        Deflections of parts that all yield alike, by loads of none.
    """
    D = tree.n_joints
    turns = range(D + 3, D + N_HINGES)
    parts = np.array([*(range(D) if joints else ()), *(turns if base else ())], dtype=np.int64)
    # What slides is as stiff as what turns, at the lever of a spindle.
    lever = np.append(np.where(tree.prismatic, SPINDLE, 1.0), np.ones(N_HINGES))[parts]
    unit = lever**2
    size = inertial_sizes(state)
    square = np.zeros((len(parts), len(size), len(size)))
    count = 0
    for g, log in enumerate(logs):
        for Y, _ in regressors(tree, state, g, gravity, coarser(log, step_of(log)), base=base):
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
    before = [_beyond(tree, log, found.moved(log, g, x)) for g, log in enumerate(logs)]
    about = found.about(x)
    sizes, of_logs, bent, all_springs, every, holds = [], [], [], [], [], True
    for g, (log, beyond) in enumerate(zip(logs, before, strict=True)):
        step = step_of(log)
        within = slice(int(log.kept[0]) // step, int(log.kept[-1]) // step + 1)
        of_log = Loaded(tree, state, g, gravity, coarser(log, step), about, within)
        parts = about.in_parts(beyond[::step])
        springs = of_log.springs(parts)
        last = np.inf
        for _ in range(_NEWTON):
            nearer, change = of_log.nearer(parts, springs)
            if not change < last:
                holds = holds and last < _BALANCE
                break
            parts, last = nearer, change
            if change < _EXACT:
                break
        sizes.append(len(log.q))
        of_logs.append(of_log)
        bent.append(parts)
        all_springs.append(springs)
        every.append(step)
    deflections = replace(
        about,
        joint=(moved := found.moved_parts),
        motions=tuple(np.zeros((len(parts), len(moved))) for parts in bent),
        number=np.zeros_like(moved),
        settled=tuple(map(on_grid, [parts @ about.moves.T for parts in bent], every, sizes)),
        every=tuple(every),
        holds=holds,
    )
    return Balance(deflections, about.origin, tuple(of_logs), tuple(bent), tuple(all_springs))


@dataclass(frozen=True, eq=False)
class Balance:
    """Deflections in balance with their loads, before it is asked what numbers do to them.

    They tell whether a step leads nearer. Half of the steps that are tried do not, and what each
    number does is twice the work.

    Attributes:
        deflections: about the numbers, of which none moves anything.
        x: (S,) the numbers.
        of_logs: per log, what loads do along it.
        bent: per log (M, R) deflections at each so many-th sample [rad or m].
        springs: per log, how these follow their loads.
    """

    deflections: Bending
    x: F64
    of_logs: tuple[Loaded, ...]
    bent: tuple[F64, ...]
    springs: tuple[Springs, ...]

    @cached_property
    def forces(self) -> tuple[F64, ...]:
        """Per log (M, 3) forces of the loads along the base's axes, at each so many-th sample."""
        logs = zip(self.of_logs, self.bent, strict=True)
        return tuple(of_log.forces(parts) for of_log, parts in logs)

    def moved_by_numbers(self) -> Bending:
        """The deflections with what each number does to them."""
        still = self.deflections
        motions = [
            of_log.motions(parts, springs).reshape(len(parts), -1)
            for of_log, parts, springs in zip(self.of_logs, self.bent, self.springs, strict=True)
        ]
        numbers = np.arange(motions[0].shape[1] // len(still.joint))
        most = int(np.argmax(np.max([np.ptp(e, axis=0) for e in self.bent], axis=0) / still.arms))
        held = np.ones((len(still.joint), len(numbers)), dtype=bool)
        # What one part yields is the scale of all.
        held[:, numbers == len(still.basis) + most] = False
        largest = [np.maximum(m.max(axis=0), -m.min(axis=0)) for m in motions]
        shows = held & (np.max(largest, axis=0) > 0).reshape(held.shape)
        joint, number = np.broadcast_arrays(still.joint[:, None], numbers)
        return replace(
            still,
            joint=joint[shows],
            motions=tuple(_columns(motions, shows.ravel())),
            number=number[shows],
        )


def step_of(log: Trajectory) -> int:
    """Grid samples from one at which deflections are worked out to the next."""
    return max(1, int(log.rate / (_PER_CUTOFF * noise_bandwidth(log.taps, log.rate))))


def _columns(of_all: list[F64], shows: Bool) -> Iterator[F64]:
    """Some columns of each array, which are read-only; what they are taken from goes at once."""
    while of_all:
        some = of_all.pop(0)[:, shows]
        some.flags.writeable = False
        yield some


def _beyond(tree: KinematicTree, log: Trajectory, moved: Trajectory) -> F64:
    """(N, D + 6) by how much joints, and the base, are beyond what encoders say."""
    beyond = np.zeros((len(log.q), tree.n_joints + N_HINGES))
    beyond[:, : moved.q.shape[1]] = moved.q
    beyond[:, : tree.n_joints] -= log.q
    return beyond
