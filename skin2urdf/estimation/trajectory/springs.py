"""How parts on springs move when something bends them: damped, and by their own inertia.

Deflections e that loads f make in parts of compliance C, where links of inertia M move along, are
not ``e = f`` but

    e + L e' + A e'' = f,    A = C M,

L the times by which dampers make them late. Well below the resonance, ``A (2 pi f)^2 << 1``, both
are alike; near it they are not, and no repeated insertion of e into e'' leads there.
"""

from __future__ import annotations

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
        inertia: (N, R, R) that goes with it: their product is in s^2. What resonates too fast for
            steps of fourth order has such of second order, which are stable for any; inertia below
            none, as of masses that are not found yet, counts as none.
        late: (R, R) compliance times damping [s].
        rate: samples per second [Hz].
    """

    def __init__(self, compliance: F64, inertia: F64, late: F64, rate: float) -> None:
        self._h = h = 1 / rate
        self._late = late
        root, inverse = roots(compliance)
        lam, V = np.linalg.eigh(0.5 * root @ (inertia + inertia.swapaxes(1, 2)) @ root)
        share = np.where(lam < (h / _STABLE) ** 2, 1 / 4, 1 / 12)
        A, later = (
            root @ (V * each[:, None]) @ V.swapaxes(1, 2) @ inverse
            for each in (lam.clip(min=0.0), h**2 * share)
        )
        self._inverse = np.linalg.inv(A + 0.5 * h * self._late + later)
        self._later = later

    def bent(self, loads: F64) -> F64:
        """(N, R, S) deflections by loads (N, R, S), from rest in balance with the first."""
        h, inverse, later, late = self._h, self._inverse, self._later, self._late
        out = np.empty_like(loads)
        e = out[0] = loads[0]
        v, a = np.zeros_like(e), np.zeros_like(e)
        for n in range(1, len(loads)):
            v = v + 0.5 * h * a
            e = e + h * v - later[n] @ a
            a = inverse[n] @ (loads[n] - e - late @ v)
            e = e + later[n] @ a
            v = v + 0.5 * h * a
            out[n] = e
        return out


def roots(compliance: F64) -> tuple[F64, F64]:
    """(R, R) root of a symmetric matrix, and its inverse; negative ones count as tiny."""
    lam, V = np.linalg.eigh(compliance)
    root = np.sqrt(lam.clip(min=_TINY * lam.max(initial=0.0)))
    return np.asarray(V * root @ V.T), np.asarray(V / root @ V.T)
