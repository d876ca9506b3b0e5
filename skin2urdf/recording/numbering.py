"""Number messages as the sensor would have counted them, lost messages included."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Bool, Int

# After a pause this long [periods], sampling need not go on at a multiple of the period.
LONG_PAUSE = 50
# Samples that make a level of their own between two jumps.
SHORTEST_LEVEL = 4
# A level has moved by a message where it moved by more than this [periods].
MOVED = 0.6
# Messages closer than this part of a period have queued: the second one says when the first came.
BEHIND = 0.05


class Numbering(NamedTuple):
    """Numbers of the messages of a stream.

    Attributes:
        number: (N,) strictly increasing.
        pieces: where a new, independent piece starts; begins with 0.
    """

    number: Int
    pieces: Int


def median_of(values: F64 | Int) -> float:
    """Median of some thousand of the values, evenly spread: to 3 per cent of their scatter."""
    # An odd stride does not fall in step with samples that come in bursts of 2, 4, 8 ...
    some = values[:: values.size // 2048 | 1]
    half = some.size // 2
    if not some.size:
        return float("nan")
    # Dividing at a single place takes a sixth of the time that two take, as it needs no branches.
    ordered = some.copy()
    ordered.partition(half)
    if np.isnan(np.maximum.reduce(ordered[half:])):
        return float("nan")  # what is no number lies behind all others
    if some.size % 2:
        return float(ordered[half])
    return 0.5 * (float(np.maximum.reduce(ordered[:half])) + float(ordered[half]))


def medians_of(rows: F64 | Int) -> F64:
    """Median of each row, as `median_of` has it.

    Args:
        rows: (S, N) values, at least one in each row.

    Returns:
        (S,) medians; NaN for rows that hold one.
    """
    count = rows.shape[1]
    some = rows[:, :: count // 2048 | 1]
    half = some.shape[1] // 2
    ordered = np.partition(some, half, axis=1)
    middle = ordered[:, half].astype(np.float64)
    if some.shape[1] % 2 == 0:
        middle = 0.5 * (middle + ordered[:, :half].max(axis=1))
    return np.where(np.isnan(ordered[:, half:].max(axis=1)), np.nan, middle)


def queue_of(stamp: F64, period: F64) -> F64:
    """(S,) in how long a queue messages come, in the mean over them: 1 where all come alone.

    Messages that come right behind each other are late alike, and tell as much as one does: the
    variance of a mean of all is so many times that of as many which are late each by itself.

    Args:
        stamp: (S, N) stamps of S streams in the order of arrival [s].
        period: (S,) sampling periods [s].
    """
    alone = np.diff(stamp, axis=1) >= BEHIND * period[:, None]
    out, size = np.ones(len(stamp)), stamp.shape[1]
    for row in np.flatnonzero(~alone.all(axis=1)):
        first = np.append(0, np.flatnonzero(alone[row]) + 1)
        out[row] = float((np.diff(first, append=size) ** 2).sum()) / size
    return out


def may_have_gaps(stamp: F64, period: F64, noise: F64) -> Bool:
    """Streams in which `number_messages` may find something.

    Args:
        stamp: (S, N) stamps of S streams in the order of arrival [s].
        period: (S,) sampling periods [s].
        noise: (S,) scales of the noise of one stamp [s].

    Returns:
        (S,) False where no stamp jumps, and none stay ahead.
    """
    count = stamp.shape[1]
    reach = _reach(period, noise)
    jump = np.abs(np.diff(stamp, axis=1) - period[:, None]).max(axis=1, initial=0.0)
    found: Bool = jump > MOVED * period
    for r in np.unique(reach[~found]):
        rows = np.flatnonzero(~found & (reach == r))
        level = stamp[rows] - period[rows, None] * np.arange(count)
        least = _least_jump(period[rows], noise[rows], np.array(r))
        found[rows] = _moves(level, int(r), least)
    return np.asarray(found & (count >= 4 * reach))


def number_messages(stamp: F64, period: float, noise: float) -> Numbering | None:
    """Find lost messages and pauses: stamps that jump ahead and stay ahead.

    Args:
        stamp: (N,) stamps in the order of arrival [s].
        period: sampling period [s].
        noise: scale of the noise of one stamp [s].

    Returns:
        The numbering, or None where no message is missing or stamps jump everywhere.
    """
    reach = int(_reach(np.array(period), np.array(noise)))
    if stamp.size < 4 * reach:
        return None
    lost = np.zeros(stamp.size, np.int64)
    apart = np.zeros(stamp.size, np.bool_)
    if not _count_jumps(stamp, period, noise, reach, lost, apart):
        return None
    _recount(stamp, period, noise, reach, lost, apart)
    if not lost.any() and not apart.any():
        return None
    lost[0] = 0
    number = np.cumsum(1 + lost) - 1
    pieces = np.flatnonzero(apart | (lost > LONG_PAUSE))
    return Numbering(number, np.concatenate([[0], pieces[pieces > 0]]))


def _count_jumps(
    stamp: F64, period: float, noise: float, reach: int, lost: Int, apart: Bool
) -> bool:
    """Count the messages lost at jumps that stand out by themselves.

    A late message is ahead too, but those after it are not, so levels before and after a jump
    are compared, each over the samples up to the neighbouring jumps.

    Args:
        stamp: (N,) stamps [s].
        period: sampling period [s].
        noise: scale of the noise of one stamp [s].
        reach: samples that make a level.
        lost: (N,) messages lost before each sample, filled in.
        apart: (N,) where stamps step back for good, filled in.

    Returns:
        False where stamps jump everywhere.
    """
    step = np.diff(stamp) - period
    suspects = np.flatnonzero(np.abs(step) > MOVED * period)
    if suspects.size > stamp.size // 4:
        return False
    if suspects.size == 0:
        return True
    level = stamp - period * np.arange(stamp.size)
    previous = np.concatenate([[-1], suspects[:-1]])
    following = np.concatenate([suspects[1:], [stamp.size - 1]])
    ahead = np.arange(reach)
    before = suspects[:, None] - ahead
    after = suspects[:, None] + 1 + ahead
    # A short run between a jump and one back is a wrong stamp, not a level: look past it.
    back = np.append(step[suspects[1:]] * step[suspects[:-1]] < 0.0, False)
    short_after = (following - suspects < SHORTEST_LEVEL) & back
    short_before = (suspects - previous < SHORTEST_LEVEL) & np.roll(back, 1)
    jump = _masked_median(
        level, after, (after <= following[:, None]) | short_after[:, None]
    ) - _masked_median(level, before, (before > previous[:, None]) | short_before[:, None])
    seen = np.minimum(
        np.where(short_before, reach, suspects - previous),
        np.where(short_after, reach, following - suspects),
    )
    certain = np.abs(jump) > _least_jump(period, noise, np.minimum(seen, reach))
    place = suspects[certain] + 1
    lost[place] = np.maximum(np.rint(jump[certain] / period), 0.0).astype(np.int64)
    apart[place] = jump[certain] < 0.0
    return True


def _recount(stamp: F64, period: float, noise: float, reach: int, lost: Int, apart: Bool) -> None:
    """Correct the count where the level still moves by whole messages.

    Finds what noise hid from `_count_jumps`, and what that counted twice.

    Args:
        stamp: (N,) stamps [s].
        period: sampling period [s].
        noise: scale of the noise of one stamp [s].
        reach: samples that make a level.
        lost: (N,) messages lost before each sample, corrected in place.
        apart: (N,) where stamps step back for good, filled in further.
    """
    least = float(_least_jump(period, noise, np.array(reach)))
    number = np.cumsum(1 + lost) - 1
    level = stamp - period * number
    # Means first, as they are cheap; medians, which wrong stamps do not move, where these differ.
    if not _moves(level[None], reach, np.array([least]))[0]:
        return
    windows = np.lib.stride_tricks.sliding_window_view(level, reach)
    settled = np.median(windows, axis=1)
    moves = np.abs(settled[reach:] - settled[:-reach]) > least
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moves, [False]]).astype(np.int8)))
    step = np.diff(stamp)
    for start, stop in edges.reshape(-1, 2):
        jump = settled[stop - 1 + reach] - settled[start]
        count = round(float(jump / period))
        span = slice(start + 1, stop - 1 + 2 * reach)
        place = span.start + int(np.argmax(step[start : span.stop - 1]))
        if count > 0:
            lost[place] += count
            continue
        for k in span.start + np.flatnonzero(lost[span]):
            taken = min(int(lost[k]), -count)
            lost[k] -= taken
            count += taken
        if count < 0 and not apart[span].any():
            apart[span.start + int(np.argmin(step[start : span.stop - 1]))] = True


def _reach(period: F64, noise: F64) -> Int:
    """How many samples make a level, by the noise of the stamps."""
    reach = np.clip(np.ceil(150.0 * np.square(noise / period)), 8, 64)
    return np.asarray(reach, dtype=np.int64)


def _moves(level: F64, reach: int, least: F64) -> Bool:
    """(S,) whether means of so many samples of the rows (S, N) differ by more than (S,)."""
    total = np.cumsum(level - level[:, :1], axis=1)
    total = np.concatenate([np.zeros((len(level), 1)), total], axis=1)
    mean = (total[:, reach:] - total[:, :-reach]) / reach
    most = np.abs(mean[:, reach:] - mean[:, :-reach]).max(axis=1, initial=0.0)
    return np.asarray(most > least)


def _least_jump(period: float | F64, noise: float | F64, seen: Int) -> F64:
    """Return what the difference of two medians must exceed to be more than noise.

    Four standard deviations: a median of n samples has 1.25 / sqrt(n), a difference of two
    sqrt(2) times that.
    """
    noise_of_jump = 1.25 * np.sqrt(2.0) * noise / np.sqrt(seen)
    return np.asarray(np.maximum(MOVED * period, 4.0 * noise_of_jump), dtype=np.float64)


def _masked_median(values: F64, index: Int, mask: Bool) -> F64:
    """Median of ``values`` at each row of ``index`` where ``mask`` is set; at least once a row."""
    inside = mask & (index >= 0) & (index < values.size)
    taken = np.where(inside, values[np.clip(index, 0, values.size - 1)], np.nan)
    return np.asarray(np.nanmedian(taken, axis=1), dtype=np.float64)
