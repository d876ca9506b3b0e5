"""What is worked out on a coarser grid than a log's, brought to the samples of the log.

Motions that were low-passed hold nothing beyond it: each so many-th sample tells all others.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skin2urdf.arrays import F64, Int
from skin2urdf.signals.filters import (
    FIRST_DIFFERENCES,
    SECOND_DIFFERENCES,
    filtered,
    first_derivative,
    passed,
    second_derivative,
)
from skin2urdf.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_REACH, _WINDOW = 9, 10.0
"""Samples on either side that tell what is between two, and the shape of their window."""
_NOTHING = 1e-12
"""Part of the largest value below which there is none, but what transforms leave of zeros."""
_TOGETHER = 32
"""Columns that are low-passed at once, so that what is copied for it stays small."""


def coarser(log: Trajectory, step: int) -> Trajectory:
    """The motion of a log at the times of each so many-th sample of its grid.

    Args:
        log: of which nothing but its motion is taken.
        step: grid samples from one to the next.
    """
    if step == 1:
        return log
    half = len(log.taps) // 2
    taps = log.taps[half % step :: step]
    thin = slice(None, None, step)
    q, qd, qdd = log.q[thin], log.qd[thin], log.qdd[thin]
    return replace(log, rate=log.rate / step, taps=taps / taps.sum(), q=q, qd=qd, qdd=qdd)


def on_grid(x: F64, step: int, size: int) -> F64:
    """(size, C) values at all samples of a grid of which each so many-th is known.

    Args:
        x: (M, C) what is known.
        step: grid samples from one to the next.
        size: of the grid.
    """
    return x if step == 1 else np.asarray(_between(np.arange(size), step, len(x)) @ x)


def passed_at_kept(x: F64, step: int, log: Trajectory, dtype: type[np.floating]) -> NDArray[Any]:
    """(3, C, K) values and their first two derivatives, low-passed, where a log is compared.

    Args:
        x: (M, C) at each so many-th sample of the log's grid.
        step: grid samples from one to the next.
        log: the log.
        dtype: of the result.
    """
    coarse = coarser(log, step)
    largest = np.abs(x).max(initial=0.0)
    at, rate = log.kept, coarse.rate
    if step == 1 and _in_a_row(at):
        return _passed(x, log, dtype)
    if step > 1:
        between = _between(at, step, len(x))
        of_first = between @ _differences(FIRST_DIFFERENCES * rate, len(x))
        of_second = between @ _differences(SECOND_DIFFERENCES * rate**2, len(x))
    out = np.empty((3, x.shape[1], len(at)), dtype=dtype)
    for first in range(0, x.shape[1], _TOGETHER):
        some = slice(first, first + _TOGETHER)
        here = filtered(x[:, some], coarse.taps)
        here[np.abs(here) < _NOTHING * largest] = 0.0
        if step > 1:
            out[:, some] = [(matrix @ here).T for matrix in (between, of_first, of_second)]
            continue
        derived = first_derivative(here, rate, at), second_derivative(here, rate, at)
        out[:, some] = [each.T for each in (here[at], *derived)]
    return out


def _in_a_row(at: Int) -> bool:
    """Whether samples are as far from each other all along."""
    return len(at) > 1 and bool((np.diff(at) == at[1] - at[0]).all())


def _passed(x: F64, log: Trajectory, dtype: type[np.floating]) -> NDArray[Any]:
    """The same of values (N, C) on the log's grid, where samples are compared in a row."""
    at, every = log.kept, int(log.kept[1] - log.kept[0])
    slopes = FIRST_DIFFERENCES * log.rate, SECOND_DIFFERENCES * log.rate**2
    still = np.zeros(len(FIRST_DIFFERENCES))
    still[len(still) // 2] = 1.0
    filters = np.stack([np.convolve(log.taps, each) for each in (still, *slopes)])
    reach = filters.shape[1] // 2
    # Ends repeat the outermost samples.
    around = np.arange(at[0] - reach, at[-1] + reach + 1).clip(0, len(x) - 1)
    out = np.empty((3, x.shape[1], len(at)), dtype=dtype)
    for first in range(0, x.shape[1], _TOGETHER):
        some = slice(first, first + _TOGETHER)
        here = np.ascontiguousarray(x[around, some].T)
        out[:, some] = passed(here, filters, every).swapaxes(0, 1)
    return out


def _between(at: Int, step: int, size: int) -> csr_array:
    """(K, size) weights that make values at samples of a grid of each so many-th, by a sinc."""
    from scipy.sparse import csr_array

    reach = np.arange(-_REACH, _REACH + 2)
    far = np.arange(step)[:, None] / step - reach
    weights = np.sinc(far) * np.i0(_WINDOW * np.sqrt((1 - (far / (_REACH + 1)) ** 2).clip(0)))
    weights /= weights.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(at)), len(reach))
    columns = np.clip((at // step)[:, None] + reach, 0, size - 1).ravel()
    return csr_array((weights[at % step].ravel(), (rows, columns)), shape=(len(at), size))


def _differences(weights: F64, size: int) -> csr_array:
    """(size, size) differences of neighbours; ends repeat the outermost samples."""
    from scipy.sparse import csr_array

    reach = np.arange(len(weights)) - len(weights) // 2
    rows = np.repeat(np.arange(size), len(reach))
    columns = np.clip(np.arange(size)[:, None] + reach, 0, size - 1).ravel()
    return csr_array((np.tile(weights, size), (rows, columns)), shape=(size, size))
