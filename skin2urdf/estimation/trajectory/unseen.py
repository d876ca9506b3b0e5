"""Motion of joints that their encoders do not see, as few numbers that make it.

Gears that twist, teeth that are not even, play: all leave a link by some e(t) beyond what its
encoder says, ``q = theta + e_o(t) + sum_s (x_s - o_s) d_s(t)``, with motions d_s that are known and
numbers x_s that are found along with the placements. One number may move several joints, as a mass
does. The o_s are 0, and so is e_o, but where motions are known about some numbers only.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skin2urdf.arrays import F32, F64, Int, Record, frozen
from skin2urdf.estimation.trajectory.coarser import on_grid, passed_at_kept
from skin2urdf.estimation.trajectory.skeleton import N_HINGES
from skin2urdf.signals.filters import first_derivative, second_derivative
from skin2urdf.signals.trajectory import Trajectory

MOST_NUMBERS = 300
"""Numbers of one kind of unseen motion at most, since time goes with their square and memory with
their number."""


@dataclass(frozen=True, eq=False)
class Unseen(Record):
    """Motions of joints per unit of S numbers, one entry for each joint that a number moves.

    Attributes:
        joint: (E,) the joint that each entry moves; D and more are hinges of the base, numbered as
            in :mod:`skeleton`.
        motions: per log (N, M) by how much its link is beyond its encoder [rad or m per unit],
            low-passed as the positions; a column for each entry, but where columns are given.
        column: (E,) the column that makes each entry's motion, as many entries may move alike; ()
            where each has its own.
        unit: (E,) how many of it; () for one of each.
        number: (E,) the number that makes the motion; by default each entry has its own.
        derivative: (E,) order of the derivative of its joint's positions, as they were read, that
            an entry's motion is, so that the noise of the encoder is in it; 0 of all other motion,
            () for nothing but that.
        origin: (S,) numbers about which the motions are those that more of them makes; by default
            0.
        settled: per log (N, D + 6) motion of joints and hinges that numbers at the origin make;
            none of them where they make none.
        every: per log, grid samples from one of its motions' to the next; () where they have all.
        kept: per log (3, M, K) motions and their derivatives at the samples compared, where nothing
            else of them is known, and none of the numbers is ever more than looked at; else ().
        several: what it is put together from, one after the other, and what has its motions; ()
            where it has them itself.
        slow: whether the base moves too slowly, or at times too little known, for what it
            accelerates by to be felt; it moves in no other way then.
    """

    joint: Int
    motions: tuple[F64, ...]
    column: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64), kw_only=True)
    unit: F64 = field(default_factory=lambda: np.zeros(0), kw_only=True)
    number: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64), kw_only=True)
    derivative: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64), kw_only=True)
    origin: F64 = field(default_factory=lambda: np.zeros(0), kw_only=True)
    settled: tuple[F64, ...] = field(default=(), kw_only=True)
    every: tuple[int, ...] = field(default=(), kw_only=True)
    kept: tuple[F64, ...] = field(default=(), kw_only=True)
    several: tuple[Unseen, ...] = field(default=(), kw_only=True)
    slow: bool = field(default=False, kw_only=True)
    _known: tuple[list[NDArray[Any]], tuple[F32, ...]] | None = field(
        default=None, init=False, repr=False
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        number = self.number if len(self.number) else np.arange(len(self.joint))
        object.__setattr__(self, "number", frozen(number, np.int64))
        origin = self.origin if len(self.origin) else np.zeros(self.n_numbers)
        object.__setattr__(self, "origin", frozen(origin))

    @property
    def n_numbers(self) -> int:
        """S."""
        return int(self.number.max(initial=-1)) + 1

    @property
    def columns(self) -> Int:
        """(E,) the column that makes each entry's motion."""
        return self.column if len(self.column) else np.arange(len(self.joint))

    @property
    def units(self) -> F64:
        """(E,) how many of its column each entry moves by."""
        return self.unit if len(self.unit) else np.ones(len(self.joint))

    @property
    def derivatives(self) -> Int:
        """(E,) order of the derivative of positions that each entry's motion is, or 0."""
        return self.derivative if len(self.derivative) else np.zeros_like(self.joint)

    @property
    def n_columns(self) -> int:
        """M."""
        if self.several:
            return sum(each.n_columns for each in _unlike(self.several))
        return int(self.kept[0].shape[1] if self.kept else self.motions[0].shape[1])

    def at_kept(self, logs: Sequence[Trajectory]) -> tuple[F32, ...]:
        """Per log (3, M, K): motions and their derivatives at the samples compared.

        They are low-passed as predictions are: readings feel what is left then. Nothing but
        derivatives is made of them, for which seven digits do: a humanoid's take gigabytes.
        """
        if self.kept:
            return tuple(each.astype(np.float32) for each in self.kept)
        if self.several:
            parts = zip(*(each.at_kept(logs) for each in _unlike(self.several)), strict=True)
            return tuple(np.concatenate(each, axis=1) for each in parts)
        # Several problems of the same logs ask for it.
        made_of = [each for log in logs for each in (log.kept, log.taps)]
        known = self._known
        if known and len(known[0]) == len(made_of) and all(map(operator.is_, known[0], made_of)):
            return known[1]
        steps = self.every or (1,) * len(logs)
        found = tuple(
            passed_at_kept(d, step, log, np.float32)
            for d, step, log in zip(self.motions, steps, logs, strict=True)
        )
        if self.slow:
            for each in found:
                each[1:] = 0.0
        object.__setattr__(self, "_known", (made_of, found))
        return found

    def moved(self, log: Trajectory, g: int, x: F64) -> Trajectory:
        """A log with the links' motion in place of the encoders'.

        Args:
            log: as the encoders have it.
            g: its number.
            x: (S,) the numbers.

        Returns:
            The log, with six columns more, of the base's hinges, where any of these moves.

        Raises:
            ValueError: a number moves what is known at the samples compared only.
        """
        n_joints = log.q.shape[1]
        log = _with_hinges(log, N_HINGES if self.moves_base(n_joints) else 0)
        away = x - self.origin
        if not (away.any() or self.settled):
            return log
        e: F64 = np.zeros(log.q.shape)
        self._add_motion(e, g, away)
        if self.settled:
            e += self.settled[g][:, : e.shape[1]]
        felt = e
        if self.slow:
            felt = np.array(e)
            felt[:, n_joints:] = 0.0
        return replace(
            log,
            q=log.q + e,
            qd=log.qd + first_derivative(felt, log.rate),
            qdd=log.qdd + second_derivative(felt, log.rate),
        )

    def _add_motion(self, e: F64, g: int, x: F64) -> None:
        """Add to motion (N, D or D + 6) what numbers x (S,) away from the origin make of it."""
        if not x.any():
            return
        if self.several:
            ends = np.cumsum([each.n_numbers for each in self.several])[:-1]
            for part, own in zip(self.several, np.split(x, ends), strict=True):
                part._add_motion(e, g, own)
            return
        if self.kept:
            raise ValueError("what is known at the samples compared only can not be followed")
        of_joint = np.zeros((self.n_columns, e.shape[1]))
        np.add.at(of_joint, (self.columns, self.joint), self.units * x[self.number])
        e += on_grid(self.motions[g] @ of_joint, self.every[g] if self.every else 1, len(e))

    @property
    def on_grid(self) -> tuple[F64, ...]:
        """Per log (N, M) the motions at all samples of its grid."""
        if self.several:
            parts = zip(*(each.on_grid for each in _unlike(self.several)), strict=True)
            return tuple(np.concatenate(each, axis=1) for each in parts)
        if not self.every:
            return self.motions
        sizes = map(len, self.settled)
        return tuple(map(on_grid, self.motions, self.every, sizes))

    def moves_base(self, n_joints: int) -> bool:
        """Whether a base that carries so many joints moves."""
        return bool((self.joint >= n_joints).any())

    def swings_base(self, n_joints: int) -> bool:
        """Whether it does so that SUs feel it accelerate."""
        return self.moves_base(n_joints) and not self.slow


def _with_hinges(log: Trajectory, n: int) -> Trajectory:
    """A log with n columns more, of hinges that stay."""
    if not n:
        return log
    still = np.zeros((len(log.q), n))
    q, qd, qdd = (np.hstack([x, still]) for x in (log.q, log.qd, log.qdd))
    return replace(log, q=q, qd=qd, qdd=qdd)


def eased(x: F64) -> F64:
    """From 0 to 1 as smoothly as an acceleration that begins and ends at 0; of x from 0 to 1."""
    return np.asarray(x * x * x * (x * (6 * x - 15) + 10))


def together(several: Sequence[Unseen]) -> Unseen:
    """The numbers of several, one after the other; their motions stay where they are."""
    first = np.cumsum([0, *(each.n_numbers for each in several)])
    unlike = _unlike(several)
    ends = np.cumsum([each.n_columns for each in unlike])
    begins = {id(each): int(end) - each.n_columns for each, end in zip(unlike, ends, strict=True)}
    columns = [begins[id(each)] for each in several]
    return Unseen(
        np.concatenate([each.joint for each in several]),
        (),
        column=np.concatenate([e.columns + n for e, n in zip(several, columns, strict=True)]),
        unit=np.concatenate([each.units for each in several]),
        number=np.concatenate([e.number + n for e, n in zip(several, first[:-1], strict=True)]),
        derivative=np.concatenate([each.derivatives for each in several]),
        origin=np.concatenate([each.origin for each in several]),
        settled=_sums([each.settled for each in several if each.settled]),
        several=tuple(several),
        slow=any(each.slow for each in several),
    )


def _unlike(several: Sequence[Unseen]) -> list[Unseen]:
    """Those whose motions are their own: the same may stand for two groups of numbers."""
    return list({id(each): each for each in several}.values())


def _sums(several: Sequence[tuple[F64, ...]]) -> tuple[F64, ...]:
    """Per log, the sum of what several have."""
    return tuple(sum(each[1:], each[0]) for each in zip(*several, strict=True))
