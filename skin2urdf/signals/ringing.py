"""Vibration that comes back whenever the robot stops: noise, whose size the log itself shows.

A structure that is stopped rings on at frequencies of its own, and all SUs on it feel that, as they
would a hit. A hit comes once; ringing comes at the same time after most stops. So what stands out
there at half of the stops is how large noise is at that time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d

from skin2urdf.arrays import F64, Int

_FEWEST = 5
"""Stops that tell what is usual after one: one hit among fewer moves their median."""


def rises_after_stops(sizes: Sequence[tuple[int, F64]], stops: Int, reach: int) -> list[F64]:
    """How much larger residuals are than usual because the robot has just stopped.

    Args:
        sizes: first grid sample of each window, and (N,) what stands out from noise in it.
        stops: (S,) grid samples at which the joints come to rest, increasing.
        reach: samples by which these may be early or late; swings go through zero as well.

    Returns:
        For each window (N,) the median over stops at the same time after one, over the median of
        all; 1 at least, and where few stops are followed by that much time.
    """
    rises = [np.ones(len(size)) for _, size in sizes]
    if len(stops) < _FEWEST or not sizes:
        return rises
    largest = [maximum_filter1d(size, 2 * reach + 1) for _, size in sizes]
    usual = float(np.median(np.concatenate(largest)))
    # The time to the next stop; longer than all but a few, nothing tells what is usual.
    last = max(first + len(size) for first, size in sizes)
    follows = np.sort(np.diff(np.append(stops, max(last + reach, stops[-1]))))[::-1]
    table = np.full((len(stops), int(follows[_FEWEST - 1])), np.nan)
    places = []
    for (first, _), values in zip(sizes, largest, strict=True):
        at = np.arange(first, first + len(values)) + reach
        stop = np.searchsorted(stops, at, side="right") - 1
        since = at - stops[stop]
        told = np.flatnonzero((stop >= 0) & (since < table.shape[1]))
        table[stop[told], since[told]] = values[told]
        places.append((told, since[told]))
    known = np.flatnonzero(np.isfinite(table).sum(axis=0) >= _FEWEST)
    level = np.ones(table.shape[1])
    if usual > 0 and len(known):
        level[known] = np.maximum(1.0, np.nanmedian(table[:, known], axis=0) / usual)
    for rise, (told, since) in zip(rises, places, strict=True):
        rise[told] = level[since]
    return rises
