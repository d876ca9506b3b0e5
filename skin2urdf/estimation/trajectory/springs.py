"""How parts on springs move when something bends them: damped, and by their own inertia.

Deflections e that loads f make in parts of compliance C, where links of inertia M move along, are
not ``e = f`` but

    e + L e' + A e'' = f,    A = C M,

L the times by which dampers make them late. Well below the resonance, ``A (2 pi f)^2 << 1``, both
are alike; near it they are not, and no repeated insertion of e into e'' leads there.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64

_STABLE = 2.2
"""Steps of Fox and Goodwin (Newmark's with beta = 1/12) are stable for angular frequencies up to
the root of 6, 2.45, per step; with beta = 1/4 they are for all."""

_TINY = 1e-6
"""Least compliance over the largest that makes a difference: of milliradians, nanoradians."""


class Springs:
    """Newmark's steps along a motion, fourth order where they can follow (Fox and Goodwin).

    Args:
        compliance: (R, R) symmetric.
        inertia: (N, R, R) that goes with it, or (1, R, R) where it stays as it is: their product is
            in s^2. What resonates too fast for steps of fourth order has such of second order,
            which are stable for any; inertia below none, as of masses that are not found yet,
            counts as none.
        late: (R, R) compliance times damping [s].
        rate: samples per second [Hz].
        size: N, where it is not said by the inertia.
    """

    def __init__(
        self, compliance: F64, inertia: F64, late: F64, rate: float, size: int | None = None
    ) -> None:
        self._h = h = 1 / rate
        self._late = late
        root, inverse = roots(compliance)
        lam, V = np.linalg.eigh(0.5 * root @ (inertia + inertia.swapaxes(1, 2)) @ root)
        share = h**2 * np.where(lam < (h / _STABLE) ** 2, 1 / 4, 1 / 12)
        there, back = root @ V, V.swapaxes(1, 2) @ inverse
        later = (there * share[:, None]) @ back
        # A + 0.5 h L + later, turned round in units in which A and later are one: numbers on their
        # way to a robot's have inertias of any size, beside which the rest would be rounded off.
        unit = 1 / np.sqrt(lam.clip(min=0.0) + share)
        there, back = there * unit[:, None], unit[..., None] * back
        damped = back @ (0.5 * h * self._late) @ there
        turned_round = there @ np.linalg.inv(np.eye(len(compliance)) + damped) @ back
        self._n = len(inertia) if size is None else size
        self._length = max(1, round(np.sqrt(self._n)))
        self._inverse, self._later = self._along(turned_round), self._along(later)

    def _along(self, steps: F64) -> F64:
        """(B or 1, L, R, R) what takes each step, in blocks of the time; one block that stays."""
        if len(steps) == 1:
            return np.broadcast_to(steps, (1, self._length, *steps.shape[1:]))
        return _in_blocks(steps, self._length)

    def bent(self, loads: F64) -> F64:
        """(N, R, S) deflections by loads (N, R, S), from rest in balance with the first.

        Steps are linear in what they begin from: all blocks of the time are gone through at once,
        each from rest, and each then moves on from where the one before it ended. Parts of numbers
        that are no robot's may swing beyond all bounds: their deflections are no numbers.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return self._bent(loads)

    def _bent(self, loads: F64) -> F64:
        """The same, with what is beyond all bounds."""
        R = loads.shape[1]
        begin = np.zeros((3, *loads.shape[1:]))
        begin[0] = loads[0]
        blocks = _in_blocks(loads, self._length)
        out, ends = self._stepped(blocks, np.zeros((3, len(blocks), *loads.shape[1:])))
        moved_on, at_end = self._from_units
        moved_on = np.broadcast_to(moved_on, (len(blocks), *moved_on.shape[1:]))
        at_end = np.broadcast_to(at_end, (len(blocks), *at_end.shape[1:]))
        state = begin
        for b in range(len(blocks)):
            flat = state.reshape(3 * R, -1)
            out[b] += moved_on[b] @ flat
            state = ends[:, b] + (at_end[b] @ flat).reshape(begin.shape)
        return out.reshape(-1, *loads.shape[1:])[: self._n]

    @cached_property
    def _from_units(self) -> tuple[F64, F64]:
        """What becomes of deflection, speed and acceleration of one unit each without loads.

        Returns:
            Per block (B, L, R, 3 R) deflections, and (B, 3 R, 3 R) all three at its end; B is 1
            where all blocks are alike.
        """
        B, L, R = self._later.shape[:3]
        units = np.eye(3 * R).reshape(3, 1, R, 3 * R)
        start = np.broadcast_to(units, (3, B, R, 3 * R))
        out, ends = self._stepped(np.zeros((B, L, R, 1)), start)
        return out, ends.swapaxes(0, 1).reshape(B, 3 * R, 3 * R)

    def _stepped(self, loads: F64, start: F64) -> tuple[F64, F64]:
        """Steps through all blocks at once.

        Args:
            loads: (B, L, R, S or 1) of L samples of each block.
            start: (3, B, R, S) deflections, speeds and accelerations before the first.

        Returns:
            (B, L, R, S) deflections, and (3, B, R, S) what is left at the ends.
        """
        h, inverse, later, late = self._h, self._inverse, self._later, self._late
        out = np.empty((*loads.shape[:3], start.shape[3]))
        e, v, a = start
        for n in range(loads.shape[1]):
            v = v + 0.5 * h * a
            e = e + h * v - later[:, n] @ a
            a = inverse[:, n] @ (loads[:, n] - e - late @ v)
            e = e + later[:, n] @ a
            v = v + 0.5 * h * a
            out[:, n] = e
        return out, np.array([e, v, a])


def _in_blocks(x: F64, length: int) -> F64:
    """(B, length, ...) blocks of (N, ...) samples; the last sample stands for those behind it."""
    at = np.minimum(np.arange(-(-len(x) // length) * length), len(x) - 1)
    return np.asarray(x[at].reshape(-1, length, *x.shape[1:]))


def roots(compliance: F64) -> tuple[F64, F64]:
    """(R, R) root of a symmetric matrix, and its inverse; negative ones count as tiny."""
    lam, V = np.linalg.eigh(compliance)
    root = np.sqrt(lam.clip(min=_TINY * lam.max(initial=0.0)))
    return np.asarray(V * root @ V.T), np.asarray(V / root @ V.T)
