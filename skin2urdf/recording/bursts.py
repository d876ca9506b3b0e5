"""Samples that arrive in bursts, as over USB and CAN, and are stamped on arrival.

A driver that empties a buffer stamps all that was in it within a fraction of a millisecond, and
then nothing for the time that the buffer takes to fill. What is known is when the last of a burst
was there: the line through these, of message number against time, says when each was taken.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.regular import bent_line

# Steps within a burst, over the mean step: reading a buffer takes little of the time it fills in.
_WITHIN = 0.1
# Share of the steps that lie within bursts: bursts of three and more. Pairs are timed as any other.
_SHARE = 0.6
# Longest time a buffer fills in [s]; what comes after a longer pause was not waiting.
_LONGEST = 0.5
# Bursts that show a rate.
_FEWEST = 16
# Over the usual number of messages, what a burst must lack before messages were lost.
_LOST = 0.6


def burst_ends(stamp: F64) -> Int | None:
    """Find the bursts of a stream.

    Args:
        stamp: (N,) stamps in the order of arrival [s].

    Returns:
        (B,) number of the last sample of each burst; None where samples do not come in bursts.
    """
    step = np.diff(stamp)
    if step.size < 3 * _FEWEST:
        return None
    usual = step[step < _LONGEST]
    if not usual.size:
        return None
    within = step < _WITHIN * float(usual.mean())
    if np.mean(within) < _SHARE:
        return None
    ends = np.append(np.flatnonzero(~within), stamp.size - 1)
    # A step that is late within a buffer's reading parts no bursts; most are as long as it fills.
    gaps = np.diff(stamp[ends])
    if ends.size < _FEWEST or float(np.median(gaps)) > _LONGEST:
        return None
    return ends


def times_of_bursts(stamp: F64, ends: Int) -> F64 | None:
    """When the samples of a stream in bursts were taken.

    Args:
        stamp: (N,) stamps in the order of arrival [s].
        ends: (B,) number of the last sample of each burst.

    Returns:
        (N,) rising times [s], along a line whose slope is estimated and that may bend; None where
        the bursts follow no rate.
    """
    number = np.arange(stamp.size, dtype=np.float64)
    # The first burst may have been cut, and the last is when the recording was.
    whole = ends[:-1]
    count, gap = np.diff(whole), np.diff(stamp[whole])
    period = float(gap.sum() / count.sum())
    # Twice, as what is lost makes the first guess long.
    for _ in range(2):
        lack = gap / period - count
        lost = np.where(lack > _LOST * np.median(count), np.rint(lack), 0.0)
        period = float(np.median(gap / (count + lost)))
    before = np.concatenate([[0.0], np.cumsum(lost)])
    number += before[np.clip(np.searchsorted(whole, np.arange(stamp.size)), 0, before.size - 1)]
    line = bent_line(number[whole] - number[whole[0]], stamp[whole], period)
    if line is None:
        return None
    times = np.interp(number, number[whole], line)
    slope = (line[-1] - line[0]) / (number[whole[-1]] - number[whole[0]])
    head, tail = slice(0, int(whole[0])), slice(int(whole[-1]) + 1, None)
    times[head] = line[0] + slope * (number[head] - number[whole[0]])
    times[tail] = line[-1] + slope * (number[tail] - number[whole[-1]])
    return times
