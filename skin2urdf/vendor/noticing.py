"""What the difference of two placements of an SU says: whether it slipped, and what slips show.

Most slips are shifts or turns. A shift alone has three numbers, and shows sooner than one of six
that might be anything: each of the three, a shift, a turn, and both, has its own test, the squared
drop of the misfit that its numbers bring, which is chi-squared where nothing happened.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri, chndtrinc

from skin2urdf.arrays import F64
from skin2urdf.estimation.uncertainty.observability import ARM

_TESTS = (slice(0, 6), slice(0, 3), slice(3, 6))
N_TESTS = len(_TESTS)
"""Tests of each SU."""
_FOUND = 0.99
"""Share of the slips that are found of those that are said to be."""


_FARTHEST = 1.0
"""Shift [m] beyond which none is looked for: an SU that is a metre off has left its link."""


class Difference(NamedTuple):
    """Two placements of an SU, held against each other.

    Attributes:
        chi2: squared difference over its covariance, in the directions that both know.
        dof: number of these.
        probability: of as much by chance, of the three tests together.
        shift: smallest shift that such a test finds in 99 of 100 logs, whatever its direction among
            those that are known [m]; NaN where it finds none of a metre, and
        turn: the smallest turn [rad]; NaN where it finds none of half a turn.
    """

    chi2: float
    dof: int
    probability: float
    shift: float
    turn: float


def differing(twist: F64, covariance: F64, level: float, *unknown: F64) -> Difference:
    """Hold the difference of two placements against its covariance.

    Args:
        twist: (6,) from one to the other (linear [m], angular [rad]).
        covariance: (6, 6) of it.
        level: probability from which it is no chance.
        unknown: (k, 6) directions that one of them does not know (linear [m], angular times the arm
            of :mod:`observability`).
    """
    scale = np.array([1.0, 1.0, 1.0, ARM, ARM, ARM])
    known = np.eye(6)
    rows = np.concatenate([np.reshape(each, (-1, 6)) for each in unknown] or [np.zeros((0, 6))])
    if len(rows):
        _, size, basis = np.linalg.svd(rows)
        known = basis[int((size > 1e-6).sum()) :]
    if not len(known):
        return Difference(0.0, 0, 1.0, np.nan, np.nan)
    x, P = known @ (scale * twist), known @ (scale[:, None] * covariance * scale) @ known.T
    information = np.linalg.pinv(P, rcond=1e-9, hermitian=True)
    drops, sizes = [], []
    for which in _TESTS:
        A = known[:, which]
        lam, V = np.linalg.eigh(A.T @ information @ A)
        some = lam > 1e-9 * lam.max()
        along = V[:, some].T @ (A.T @ information @ x)
        drops.append((float((along**2 / lam[some]).sum()), int(some.sum())))
        sizes.append(float(lam[some].min()) if some.any() else 0.0)
    chi2, dof = drops[0]
    probability = min(1.0, N_TESTS * min(float(chdtrc(n, drop)) for drop, n in drops if n))
    shift, turn = (
        _least(n, least, level / N_TESTS)
        for (_, n), least in zip(drops[1:], sizes[1:], strict=True)
    )
    return Difference(
        chi2,
        dof,
        probability,
        shift if shift <= _FARTHEST else np.nan,
        turn / ARM if turn / ARM <= np.pi else np.nan,
    )


def _least(n: int, information: float, level: float) -> float:
    """Smallest size of which a test on n numbers finds 99 of 100; NaN where nothing is known."""
    if not n:
        return float("nan")
    noncentral = float(chndtrinc(chdtri(n, level), n, 1 - _FOUND))
    return float(np.sqrt(noncentral / information))
