"""Parts of the data that fit worse than their like, told by a test of known false-alarm rate.

Chi-squared is not held against 1 alone: what encoders round away can raise it everywhere without
anything being wrong. Each part is compared with the others, on a logarithmic scale, where misfits
of all sizes spread alike and a single wild block can not stand for a whole SU or pose. Where the
others fit better than their noise lets expect, a part is held against its noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import polygamma, psi, stdtrit

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.estimation.uncertainty.goodness import Share

FALSE_ALARM = 1e-4
"""Probability of naming any part of a recording in which nothing is wrong."""
_ALIKE = np.log(1.5)
"""Spread of honest parts (one standard deviation): they fit alike to within a factor of 1.5.

Noise levels are estimated from the samples around one pose, and rounding touches parts unequally.
"""
_CONFIDENCE = 8.0
"""Degrees of freedom that this is worth beside the spread which a recording itself shows."""


@dataclass(frozen=True, eq=False)
class Unlike(Record):
    """How n parts of the data fit, compared with each other.

    Attributes:
        times: (n,) misfit over that of the median part, or over noise where that fits better, as a
            factor; NaN where there is no data.
        odd: (n,) True where it is larger than chance explains.
    """

    times: F64
    odd: Bool


def sus_unlike_the_rest(blocks: Share) -> Unlike:
    """Compare SUs by the misfit of all their poses.

    Args:
        blocks: (P, U) every pose and SU.
    """
    return _compared(*_typical(blocks, axis=0))


def poses_unlike_the_rest(blocks: Share, patterned: Bool) -> Unlike:
    """Compare poses by the misfit of all SUs: those with a pattern, and those of mere rest.

    Args:
        blocks: (P, U) every pose and SU.
        patterned: (P,) True where a DoF was excited around the pose.
    """
    y, variance = _typical(blocks, axis=1)
    times, odd = np.full(len(y), np.nan), np.zeros(len(y), dtype=bool)
    for group in (patterned, ~patterned):
        found = _compared(y[group], variance[group], len(y))
        times[group], odd[group] = found.times, found.odd
    return Unlike(times, odd)


def _typical(blocks: Share, axis: int) -> tuple[F64, F64]:
    """Mean log misfit over an axis, weighted by what each block can tell, and its variance.

    The logarithm of chi-squared over its degrees of freedom k has the mean
    ``psi(k / 2) - log(k / 2)`` and the variance ``psi'(k / 2)``.
    """
    known = blocks.dof >= 1.0
    half = np.where(known, blocks.dof, 2.0) / 2
    ratio = np.where(known, blocks.chi2, 1.0) / (2 * half)
    y = np.log(np.maximum(ratio, 1e-12)) - (psi(half) - np.log(half))
    weight = known / (polygamma(1, half) + _ALIKE**2)
    total = weight.sum(axis=axis)
    none = np.full(total.shape, np.nan)
    mean = np.divide((weight * y).sum(axis=axis), total, out=none, where=total > 0)
    return mean, np.divide(1.0, total, out=np.full(total.shape, np.inf), where=total > 0)


def _compared(y: F64, variance: F64, n_tests: int | None = None) -> Unlike:
    """Test every log misfit (n,) against the median one, or against noise where that is less.

    The spread between honest parts is what the recording shows (median absolute deviation) and
    what is known beforehand, weighed by degrees of freedom; so the test is Student's.
    """
    known = np.isfinite(y)
    n = int(known.sum())
    if n < 3:
        return Unlike(np.where(known, 1.0, np.nan), np.zeros(len(y), dtype=bool))
    middle = np.median(y[known])
    shown = (1.4826 * np.median(np.abs(y[known] - middle))) ** 2 - np.median(variance[known])
    spread = _CONFIDENCE * _ALIKE**2 + (n - 1) * max(0.0, float(shown))
    spread /= _CONFIDENCE + n - 1
    limit = stdtrit(_CONFIDENCE + n - 1, 1 - FALSE_ALARM / (n_tests or n))
    beyond = y - max(middle, 0.0)
    t = beyond / np.sqrt(spread + variance)
    return Unlike(np.exp(beyond), known & (np.nan_to_num(t) > limit))
