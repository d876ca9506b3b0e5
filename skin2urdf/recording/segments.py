"""Stretches of one clock: where stamps jump by more than their stream explains, or step back.

A clock that is set in mid-log, and a recorder that pauses, leave stretches that are whole by
themselves. Nothing is known of how far apart they are, so nothing may be interpolated between them.
What jumps in all streams alike is a jump of their common clock: the stretches follow each other
after a short pause. Where the clock of a single stream jumps, its relation to the others is lost:
the longest stretch counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.numbering import median_of
from skin2urdf.recording.streams import Samples
from skin2urdf.recording.timing import NS_PER_S, stamped_clock

# Messages are late, early or bundled by less than this, and a clock that is disciplined in small
# steps stays within it [s].
JUMP = 0.5
# A pause of all streams this long is left out of the common clock [s].
LONG_PAUSE = 10.0
# What is left of a pause: long enough that no stream takes it for lost messages [s, periods].
SHORT_PAUSE = 1.0
PERIODS = 60
# Samples whose median is the level of the clock before and after a jump.
LEVEL = 8
NONE = np.zeros(0, np.int64)
# A stream whose stamps jump more often than this has no clock to follow.
MOST_JUMPS = 64


class Jump(NamedTuple):
    """A lasting jump of the stamps of one stream.

    Attributes:
        first: first sample after it.
        before: time of the last sample before it [s].
        after: time of the first sample after it [s].
        follows: whether the log's times, and so what was sent, jump with it.
    """

    first: int
    before: float
    after: float
    follows: bool

    @property
    def size(self) -> float:
        """By how much the clock jumps [s]."""
        return self.after - self.before

    def alike(self, other: Jump) -> bool:
        """Whether another stream's jump is one of the same clock at the same time."""
        return abs(self.before - other.before) < JUMP + 1 and abs(self.size - other.size) < JUMP + 1


def on_one_clock(
    streams: Sequence[Samples], names: Sequence[str], topics: Sequence[str]
) -> tuple[list[Samples], list[ReadingNote]]:
    """Join the stretches of a clock that jumped.

    Args:
        streams: samples of all joints and SUs in the order of their arrival.
        names: what each is called in the words of notes.
        topics: on which each is.

    Returns:
        The samples on a clock that runs on, and notes for the user.
    """
    origin = min((int(s.log_time[0]) for s in streams if s.log_time.size), default=0)
    clocks = [stamped_clock(s.stamp, s.log_time)[0] for s in streams]
    jumps = [_jumps(clock, s.log_time, origin) for clock, s in zip(clocks, streams, strict=True)]
    if not any(jumps):
        return _without_pauses(streams, clocks)
    common = _common(jumps, clocks, origin)
    events = [[_of_stream(event, found) for event in common] for found in jumps]
    pause = _pause(clocks)
    shifts = [0.0]
    for e, _ in enumerate(common):
        met = [event for row in events if (event := row[e]) is not None]
        gap = min(m.after for m in met) - max(m.before for m in met)
        shifts.append(shifts[-1] + pause - gap)
    notes = [ReadingNote("clock jump", _words(event, pause)) for event in common]
    out = []
    for samples, clock, found, own, name, topic in zip(
        streams, clocks, jumps, events, names, topics, strict=True
    ):
        bounds = _bounds(clock, own, common, origin)
        moved = _moved(samples, clock, bounds, shifts)
        alone = [j for j in found if j not in own and not j.follows]
        if alone:
            edges = [0, *(jump.first for jump in alone), len(clock)]
            begin, end = max(pairwise(edges), key=lambda piece: piece[1] - piece[0])
            sizes = ", ".join(f"{jump.size:+.3g} s" for jump in alone[:3])
            words = (
                f"the clock of {name} jumps by itself ({sizes}): the longest stretch, "
                f"{100 * (end - begin) / len(clock):.0f} % of the samples, was used (set clocks "
                "before a recording, not during it)"
            )
            notes.append(ReadingNote("own clock jump", words, (topic,), len(alone)))
            moved = moved.at(np.arange(begin, end))
        out.append(moved)
    clocks = [stamped_clock(s.stamp, s.log_time)[0] for s in out]
    out, closed = _without_pauses(out, clocks)
    return out, [*notes, *closed]


def _without_pauses(
    streams: Sequence[Samples], clocks: Sequence[Int]
) -> tuple[list[Samples], list[ReadingNote]]:
    """Shorten what is left of pauses in which no stream has a sample.

    A stream whose clock jumps by itself may hide that all others jump at once. Whatever made such a
    pause, nothing is known of it, and all that follows would carry its length along.

    Args:
        streams: samples of all joints and SUs.
        clocks: (N,) times of each [ns].
    """
    edges = [np.zeros((0, 2), np.int64)]
    # A device may have a clock of its own; what all streams have in common is the log's.
    places = [_on_log_clock(s.log_time, c) for s, c in zip(streams, clocks, strict=True)]
    for place in places:
        # A stretch of a stream goes on as long as no step is as long as a pause.
        if place.size:
            step = np.diff(place, append=place[-1])
            whole = int(step.min()) >= 0 and int(step.max()) <= LONG_PAUSE * NS_PER_S
            time = place if whole else np.sort(place)
            cut = NONE if whole else np.flatnonzero(np.diff(time) > LONG_PAUSE * NS_PER_S)
            begin, end = np.append(0, cut + 1), np.append(cut, time.size - 1)
            edges.append(np.stack([time[begin], time[end]], axis=1))
    there = np.concatenate(edges)
    there = there[np.argsort(there[:, 0], kind="stable")]
    reached = np.maximum.accumulate(there[:, 1])
    pauses = np.flatnonzero(there[1:, 0] - reached[:-1] > LONG_PAUSE * NS_PER_S)
    # Stamps that are far apart again and again scatter: they are for the timing to judge.
    if not 0 < pauses.size <= MOST_JUMPS:
        return list(streams), []
    left = _pause(clocks)
    before, after = reached[pauses], there[pauses + 1, 0]
    ahead = np.concatenate([[0], np.cumsum(after - before - round(left * NS_PER_S))])
    out = []
    for samples, place in zip(streams, places, strict=True):
        shift = ahead[np.searchsorted(before, place)]
        stamp = np.where(samples.stamp > 0, samples.stamp - shift, samples.stamp)
        out.append(samples._replace(stamp=stamp, log_time=samples.log_time - shift))
    return out, [_of_pauses((after - before) / NS_PER_S, left)]


def _on_log_clock(log_time: Int, clock: Int) -> Int:
    """Times (N,) of a stream, less its clock's usual lead on the log where that runs [ns]."""
    if not log_time.size or int(log_time.max()) == int(log_time.min()):
        return clock
    return clock - int(median_of(clock - log_time))


def _jumps(clock_ns: Int, log_ns: Int, origin: int) -> list[Jump]:
    """Find the lasting jumps in times (N,) of the stamps and of the log, told in s from the origin.

    Args:
        clock_ns: (N,) times by the stamps [ns].
        log_ns: (N,) times of the log [ns].
        origin: when the log begins [ns].
    """
    if clock_ns.size < 2 * LEVEL:
        return []
    steps_ns = np.diff(clock_ns)
    # Mostly all steps are alike, and so none departs from the usual one.
    if int(steps_ns.max()) - int(steps_ns.min()) <= JUMP * NS_PER_S:
        return []
    clock, log = (clock_ns - origin) / NS_PER_S, (log_ns - origin) / NS_PER_S
    step = np.diff(clock)
    period = max(median_of(step), 0.0)
    least = max(JUMP, 20 * period)
    suspects = np.flatnonzero(np.abs(step - period) > least)
    suspects = suspects[(suspects >= LEVEL - 1) & (suspects < clock.size - LEVEL)]
    if not suspects.size or suspects.size > len(clock) // LEVEL:
        return []
    ahead = np.arange(LEVEL)

    def levels(values: F64) -> tuple[F64, F64]:
        before = np.median(values[suspects[:, None] - ahead] + period * ahead, axis=1)
        after = np.median(values[suspects[:, None] + 1 + ahead] - period * ahead, axis=1)
        return before, after

    before, after = levels(clock)
    log_before, log_after = levels(log)
    runs = log[-1] > log[0]
    found: list[Jump] = []
    for k in np.flatnonzero(np.abs(after - before - period) > least):
        size = after[k] - before[k]
        follows = bool(size > 0 and runs and abs(log_after[k] - log_before[k] - size) < least)
        jump = Jump(int(suspects[k]) + 1, float(before[k]), float(after[k]), follows)
        # Messages that overtook each other at a jump show it several times.
        if found and jump.first - found[-1].first < LEVEL and abs(jump.size) <= abs(found[-1].size):
            continue
        if found and jump.first - found[-1].first < LEVEL:
            found.pop()
        found.append(jump)
    return found if len(found) <= MOST_JUMPS else []


def _common(jumps: Sequence[Sequence[Jump]], clocks: Sequence[Int], origin: int) -> list[Jump]:
    """The jumps that all streams have which are there before and after, in their order."""
    most = max(range(len(jumps)), key=lambda k: len(clocks[k]))
    chosen = []
    for jump in jumps[most]:
        if jump.follows and jump.size < LONG_PAUSE:
            continue
        if all(
            _of_stream(jump, found) is not None or not _spans(clock, jump, origin)
            for found, clock in zip(jumps, clocks, strict=True)
        ):
            chosen.append(jump)
    return chosen


def _of_stream(event: Jump, found: Sequence[Jump]) -> Jump | None:
    """A stream's own view of a jump, None where it has none."""
    return next((jump for jump in found if jump.alike(event)), None)


def _spans(clock: Int, jump: Jump, origin: int) -> bool:
    """Whether a stream has samples on both sides of a jump that it does not show."""
    if not clock.size:
        return False
    first, last = (np.array([clock[0], clock[-1]]) - origin) / NS_PER_S
    return bool(first < jump.before and last > max(jump.before, jump.after))


def _bounds(
    clock: Int, own: Sequence[Jump | None], common: Sequence[Jump], origin: int
) -> list[int]:
    """For each jump of the common clock, the first sample of a stream after it."""
    out = []
    for jump, event in zip(own, common, strict=True):
        if jump is not None:
            out.append(jump.first)
            continue
        # A stream that is there on one side only.
        first = (int(clock[0]) - origin) / NS_PER_S if clock.size else 0.0
        later = first >= event.after and not (event.size < 0 and first < event.before)
        out.append(0 if later else len(clock))
    return out


def _moved(samples: Samples, clock: Int, bounds: Sequence[int], shifts: Sequence[float]) -> Samples:
    """Samples with the stretches moved; log times keep their distance from the stamps."""
    if not bounds or bounds[0] >= len(clock):
        return samples
    part = np.searchsorted(np.asarray(bounds), np.arange(len(clock)), side="right")
    moved = clock + np.rint(np.asarray(shifts)[part] * NS_PER_S).astype(np.int64)
    if not (samples.stamp > 0).any():
        return samples._replace(log_time=moved)
    ahead = clock - samples.log_time
    level = np.zeros(len(shifts), np.int64)
    for k in np.unique(part):
        level[k] = int(median_of(ahead[part == k]))
    return samples._replace(stamp=moved, log_time=moved - ahead + (level - level[part[0]])[part])


def _pause(clocks: Sequence[Int]) -> float:
    """The pause [s] between stretches, from the slowest stream of a common kind."""
    periods = [median_of(np.diff(clock)) / NS_PER_S for clock in clocks if clock.size > 2]
    slow = float(np.median(periods)) if periods else 0.0
    return max(SHORT_PAUSE, min(PERIODS * slow, LONG_PAUSE))


def _of_pauses(lengths: F64, pause: float) -> ReadingNote:
    """A note on pauses of the whole log, of so many seconds each."""
    shortest, longest = float(lengths.min()), float(lengths.max())
    what = f"there are no messages for {longest:.4g} s"
    if len(lengths) > 1:
        what = f"{len(lengths)} times there are no messages, for {shortest:.4g} to {longest:.4g} s"
    return ReadingNote("clock jump", f"{what}: {_used(pause)}", number=len(lengths))


def _words(event: Jump, pause: float) -> str:
    """A note on a jump of the common clock."""
    if event.follows:
        what = f"there are no messages for {event.size:.4g} s"
    else:
        way = "forward" if event.size > 0 else "back"
        what = f"all stamps jump {way} by {abs(event.size):.4g} s"
    return f"{what}: {_used(pause)}"


def _used(pause: float) -> str:
    """What is made of stretches of a log that are apart by a time nobody knows."""
    return (
        f"the stretches before and after are used with a pause of {pause:.3g} s between them, as "
        "nothing tells how far apart they are"
    )
