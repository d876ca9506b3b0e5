"""What the noise of many short stretches says together (Smyth 2004).

The noise of an SU at rest is estimated from some dozen independent samples a rest. Weights that
follow such estimates prefer the rests whose noise seems small by chance, and promise more than they
keep. Sensors are steady, though: the estimates of all rests are of one figure, or of nearly one.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from skin2urdf.arrays import F64, Bool

_FEWEST = 3
"""Rests from which they say something about each other."""
_MOST = 1e4
"""Degrees of freedom that stand for certainty."""


def moderated(variance: F64, freedom: F64, alike: Bool) -> tuple[F64, F64]:
    """Variances of stretches that are drawn towards what most of them show.

    The true variances of an SU's axis are taken to be scattered like ``s0^2 d0 / chi^2(d0)``; the
    scatter d0, common to all SUs and axes, and each one's s0 follow from the mean and the variance
    of the logarithms. Where the estimates scatter as chance makes them, d0 is without bound and
    they become one; where rests differ, as when a robot is still settling, each keeps its own.

    Args:
        variance: (P, U, 3) estimates [m^2/s^4].
        freedom: (P, U) their degrees of freedom.
        alike: (P, U) True for stretches that may be of one variance.

    Returns:
        (P, U, 3) variances and (P, U) their degrees of freedom.
    """
    known = alike & (freedom > 0) & (variance > 0).all(axis=2)
    known &= known.sum(axis=0) >= _FEWEST
    if not known.any():
        return variance, freedom
    half = np.where(known, freedom, 1.0) / 2
    # Unbiased logarithms of the variances, and how far chance scatters them.
    level = np.log(np.where(known[..., None], variance, 1.0))
    level = level - (digamma(half) - np.log(half))[..., None]
    n = np.maximum(known.sum(axis=0), 1)
    mean = (level * known[..., None]).sum(axis=0) / n[:, None]
    scatter = ((level - mean) ** 2 * known[..., None]).sum(axis=0) / np.maximum(n - 1, 1)[:, None]
    chance = (polygamma(1, half) * known).sum(axis=0) / n
    counts = known.any(axis=0)
    beyond = float(np.average((scatter - chance[:, None])[counts].mean(axis=1), weights=n[counts]))
    prior = 2 * _inverse_trigamma(beyond)
    usual = np.exp(mean + digamma(prior / 2) - np.log(prior / 2))
    drawn = (prior * usual + freedom[..., None] * variance) / (prior + freedom)[..., None]
    return (
        np.where(known[..., None], drawn, variance),
        np.where(known, freedom + prior, freedom),
    )


def allowance(freedom: F64) -> F64:
    """Factor on variances that are estimated, for means that are weighted by them.

    Errors over a deviation that few samples gave are those of Student's t, and weights that are
    wrong by chance cost precision (Kackar & Harville 1984). Both add 2 / freedom, at first order.

    Args:
        freedom: degrees of freedom of the estimates.
    """
    return np.asarray((freedom + 2) / np.maximum(freedom - 2, np.maximum(freedom, 1.0) / 3))


def _inverse_trigamma(value: float) -> float:
    """Argument at which the trigamma function has a value; large where that is not positive."""
    if value <= polygamma(1, _MOST):
        return _MOST
    lowest = 1e-3
    if value >= polygamma(1, lowest):
        return lowest
    return float(brentq(lambda x: polygamma(1, x) - value, lowest, _MOST))
