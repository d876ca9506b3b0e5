"""Samples that arrive in bursts, as over USB and CAN, and are stamped on arrival.

A driver that empties a buffer stamps all that was in it within a fraction of a millisecond, and
then nothing for the time that the buffer takes to fill. What is known is when the last of a burst
was there: the line through these, of message number against time, says when each was taken. Where
single messages are lost on the way, they can not be numbered by counting; then the bursts are.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.lattice import BELOW
from skin2urdf.recording.numbering import median_of
from skin2urdf.recording.regular import bent_line, regular_times

# Steps within a burst, over the mean step: reading a buffer takes little of the time it fills in.
_WITHIN = 0.1
# Share of the steps that lie within bursts: half of those of pairs, some of which lack one.
_SHARE = 0.4
# Longest time a buffer fills in [s]; what comes after a longer pause was not waiting.
_LONGEST = 0.5
# Bursts that show a rate.
_FEWEST = 16
# Over the usual number of messages, what a burst must lack before messages were lost.
_LOST = 0.6
# Up to this part of a period the last of a burst waits for its reading, by the scatter of medians.
_WAITS = 1.4826 / 4
# Share of the bursts that hold all their messages at least where single ones are lost.
_COMPLETE = 0.05
# Share of the bursts that may hold more than came since the one before, by errors of their stamps.
# Of buffers of 2 to 32 that lack up to a tenth of their messages 0.6 per cent do at most, of queues
# of messages that are late by 2 to 10 periods 15 to 39.
_MORE = 0.05


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
    return ends if _may_be_of_a_buffer(np.diff(ends), gaps) else None


def _may_be_of_a_buffer(count: Int, gap: F64) -> bool:
    """Whether bursts hold no more messages than came since the ones before.

    A buffer is empty once it was read. Messages that queue behind a late one are more than that
    where the last of them is late by less than the last one before.

    Args:
        count: (B,) messages of each burst.
        gap: (B,) time since the one before [s].
    """
    # Losses make the mean period too long.
    came = gap * count.sum() / (gap.sum() * (1 - BELOW))
    return float(np.mean(count > came + 1)) <= _MORE


def times_of_bursts(stamp: F64, ends: Int) -> F64 | None:
    """When the samples of a stream in bursts were taken.

    Of three ways that with the least error is taken: messages lie on a line by their numbers;
    bursts lie on one by theirs, and messages are spread within; messages are spread between the
    stamps of the ends of bursts. What neighbouring ends are both off a line is the line's error,
    what each is off alone is the stamps'.

    Args:
        stamp: (N,) stamps in the order of arrival [s].
        ends: (B,) number of the last sample of each burst.

    Returns:
        (N,) rising times [s], along a line whose slope is estimated and that may bend; None where
        the bursts follow no rate.
    """
    # The first burst may have been cut, and the last is when the recording was.
    whole = ends[:-1]
    read = stamp[whole]
    number, period = _numbers(stamp, whole)
    line = bent_line(number[whole] - number[whole[0]], read, period)
    if line is None:
        return None
    slow, own = _scatter(read - line)
    # How long the last of a burst waits for its reading bends a line by numbers, and no other.
    waits = (_WAITS * period) ** 2
    off = max(slow - waits, 0.0)
    # Bursts are as regular as what fills them, whatever becomes of their messages.
    bursts = regular_times(read)
    if bursts is not None:
        slow, least = _scatter(read - bursts)
        own = min(own, least)
        if slow + waits < off and slow <= own:
            return _spread(stamp, whole, bursts)
    return _extended(number, whole, read if own + waits < off else line)


def _numbers(stamp: F64, ends: Int) -> tuple[F64, float]:
    """Numbers (N,) of messages of which some bursts may lack most, and the period [s]."""
    number = np.arange(stamp.size, dtype=np.float64)
    count, gap = np.diff(ends), np.diff(stamp[ends])
    period = float(gap.sum() / count.sum())
    # Twice, as what is lost makes the first guess long.
    for _ in range(2):
        lack = gap / period - count
        lost = np.where(lack > _LOST * np.median(count), np.rint(lack), 0.0)
        period = float(np.median(gap / (count + lost)))
    before = np.concatenate([[0.0], np.cumsum(lost)])
    number += before[np.clip(np.searchsorted(ends, np.arange(stamp.size)), 0, before.size - 1)]
    return number, period


def _scatter(off: F64) -> tuple[float, float]:
    """Variances of what neighbours share of (B,) distances [s], and of what is each one's own.

    Half the mean square of successive differences is the latter's (von Neumann 1941), here by
    medians, which late bursts do not move. Both are in s^2.
    """
    own = 0.5 * (1.4826 * median_of(np.abs(np.diff(off)))) ** 2
    return max((1.4826 * median_of(np.abs(off))) ** 2 - own, 0.0), own


def _extended(number: F64, ends: Int, time: F64) -> F64:
    """Times (N,) of messages by their numbers, along those (B,) of the ends of bursts."""
    times = np.interp(number, number[ends], time)
    slope = (time[-1] - time[0]) / (number[ends[-1]] - number[ends[0]])
    head, tail = slice(0, int(ends[0])), slice(int(ends[-1]) + 1, None)
    times[head] = time[0] + slope * (number[head] - number[ends[0]])
    times[tail] = time[-1] + slope * (number[tail] - number[ends[-1]])
    return np.asarray(times)


def _spread(stamp: F64, ends: Int, time: F64) -> F64:
    """Times (N,) of messages of bursts that lack some, by the times (B,) at which they ended.

    Which ones are lost is not known: a message is where it is in the mean over all of them. The
    first burst may have been cut at its begin, and what follows the last one at its end.
    """
    size = np.diff(ends)
    gap = float(np.median(np.diff(time)))
    full = float(np.quantile(size, 1 - _COMPLETE))
    burst = np.repeat(np.arange(size.size), size)
    place = np.arange(burst.size) - (ends[burst] - ends[0]) + 1
    slots = np.maximum(full, size)[burst]
    within = time[1:][burst] - (slots - place * (slots + 1) / (size[burst] + 1)) * gap / full
    head = np.arange(-int(ends[0]), 1)
    tail = np.arange(1, stamp.size - int(ends[-1]))
    return np.concatenate([time[0] + head * gap / full, within, time[-1] + tail * gap / full])
