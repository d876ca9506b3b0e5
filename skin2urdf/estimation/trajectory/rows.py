"""Derivatives of the readings of one SU in one log, and their products.

What encoders do not see is made by many numbers, of which few count at any moment: slack of a place
is felt there, and on the way to it and from it. A reading's derivatives are therefore kept in the
motion of each joint, which are three, and multiplied by what each number makes of that motion for
the stretch of time in which it makes any.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F32, F64, Bool, Int
from skin2urdf.estimation.trajectory.unseen import Unseen

_BLOCK = 512
"""Samples of which products are formed at once: what they are formed from fits into caches."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Whitened derivatives of K samples of what an SU reads.

    Attributes:
        log: number of the log.
        su: number of the SU.
        columns: C columns of the joint part that the readings depend on, but for those below.
        by_coordinates: (C + n, 3, K) in these and in the SU's own coordinates.
        residual: (3, K) whitened residuals.
        joints: (m,) numbers of the joints and hinges that move beyond their encoders.
        by_motion: (m, 3, 3, K) in the position, velocity and acceleration of each of them.
    """

    log: int
    su: int
    columns: list[int]
    by_coordinates: F64
    residual: F64
    joints: Int
    by_motion: F64

    def whole(self, beyond: Beyond | None) -> tuple[list[int], F64]:
        """All columns, and derivatives in these and in the SU's own coordinates.

        Args:
            beyond: what encoders do not see in the log.
        """
        if beyond is None or not len(self.joints):
            return self.columns, self.by_coordinates
        numbers, derivatives = beyond.derivatives(self.joints, self.by_motion)
        return [*numbers.tolist(), *self.columns], np.concatenate(
            [derivatives, self.by_coordinates]
        )


@dataclass(frozen=True, eq=False)
class Beyond:
    """What encoders do not see at the K samples of a log that are compared.

    Attributes:
        unseen: which numbers move which joints.
        motions: (3, M, K) by how much, its velocity and its acceleration per unit of each column.
        first: column of the joint part of the first number.
    """

    unseen: Unseen
    motions: F32
    first: int

    def blocks(self, joints: Int, by_motion: F64) -> Iterator[tuple[slice, Int, F64]]:
        """Stretches of time, columns of the numbers that count in each, and derivatives in those.

        Args:
            joints: (m,) numbers of joints and hinges that move beyond their encoders.
            by_motion: (m, 3, c, K) derivatives of c series in the motion of each of them.

        Yields:
            The samples, (s,) columns of the joint part and (s, c, k) derivatives; none where no
            number moves any of these joints, as in the limb of another publisher.
        """
        if not len(joints):
            return
        for begin, counts in self._counting:
            at = slice(begin, min(begin + _BLOCK, by_motion.shape[3]))
            numbers, derivatives = self._derivatives(joints, by_motion[..., at], at, counts)
            if len(numbers):
                yield at, numbers, derivatives

    def derivatives(self, joints: Int, by_motion: F64) -> tuple[Int, F64]:
        """Columns (s,) of all numbers that count, and derivatives (s, c, K) in these."""
        every = np.ones(len(self.unseen.joint), dtype=bool)
        return self._derivatives(joints, by_motion, slice(0, by_motion.shape[3]), every)

    @cached_property
    def _counting(self) -> list[tuple[int, Bool]]:
        """First sample of each block, and (E,) which motions are any in it."""
        size, columns = self.motions.shape[2], self.unseen.columns
        return [
            (begin, np.any(self.motions[:, :, begin : begin + _BLOCK], axis=(0, 2))[columns])
            for begin in range(0, size, _BLOCK)
        ]

    def _derivatives(self, joints: Int, by_motion: F64, at: slice, counts: Bool) -> tuple[Int, F64]:
        """The same at some samples, of the motions (E,) that count."""
        motions, columns, units = self.motions[:, :, at], self.unseen.columns, self.unseen.units
        counts = counts & np.isin(self.unseen.joint, joints)
        numbers = np.unique(self.unseen.number[counts])
        out = np.zeros((len(numbers), by_motion.shape[2], motions.shape[2]))
        for joint, of_joint in zip(joints, by_motion, strict=True):
            entries = np.flatnonzero(counts & (self.unseen.joint == joint))
            place = np.searchsorted(numbers, self.unseen.number[entries])
            each = motions[:, columns[entries]] * units[entries, None]
            added = np.einsum("dck,dsk->sck", of_joint, each)
            if np.array_equal(place, np.arange(len(numbers))):
                out += added
                continue
            # A number may move a joint in more than one way.
            for s, each in zip(place, added, strict=True):
                out[s] += each
        return self.first + numbers, out
