"""Clocks that are set in mid-log by less than a jump: their stamps are put back on one clock.

Hosts whose clock is set by the network's, by some ten milliseconds and more, stamp all that follows
that much later or earlier. Stamps step then and the times of the log run on, where lost messages
and slower ways leave a gap in the times of the log.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import Int
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.naming import shortened
from skin2urdf.recording.numbering import median_of
from skin2urdf.recording.segments import JUMP
from skin2urdf.recording.streams import Samples
from skin2urdf.recording.timing import NS_PER_S

# Smaller steps do less than the noise of encoders and sensors at the speed of robots [s].
LEAST_STEP = 2e-3
# Samples before and after a step that tell its size, and by how many times their scatter it shows.
AROUND, FAR = 48, 10.0
# A clock that steps more often has no level to be put back to.
MOST_STEPS = 64


class Step(NamedTuple):
    """A step of the stamps of one stream.

    Attributes:
        first: first sample after it.
        size: by how much the clock was set forward [ns].
        time: of the log when it was [ns].
    """

    first: int
    size: int
    time: int


def without_steps(
    streams: Sequence[Samples], names: Sequence[str]
) -> tuple[list[Samples], list[ReadingNote]]:
    """Take off stamps by what their clocks were set forward.

    Args:
        streams: samples of all joints and SUs in the order of their arrival.
        names: what each is called in the words of notes.

    Returns:
        The samples with stamps of clocks that run on, and notes for the user.
    """
    found = [_steps(samples) for samples in streams]
    if not any(found):
        return list(streams), []
    out = []
    for samples, steps in zip(streams, found, strict=True):
        if steps:
            ahead = np.zeros(samples.stamp.size, np.int64)
            for step in steps:
                ahead[step.first :] += step.size
            samples = samples._replace(stamp=samples.stamp - ahead)
        out.append(samples)
    begin = min(int(samples.log_time[0]) for samples in streams if samples.log_time.size)
    return out, _notes(found, names, begin)


def _steps(samples: Samples) -> list[Step]:
    """Where the clock of a stream was set, and by how much."""
    stamp, log = samples.stamp, samples.log_time
    if stamp.size <= 2 * AROUND or not int(stamp.min()) > 0:
        return []
    gaps = np.diff(stamp)
    # Mostly all gaps are alike.
    if int(gaps.max()) - int(gaps.min()) <= LEAST_STEP * NS_PER_S:
        return []
    off = np.abs(gaps - median_of(gaps))
    least = max(LEAST_STEP * NS_PER_S, FAR * median_of(off))
    suspects = np.flatnonzero((off > least) & (off < JUMP * NS_PER_S))
    suspects = suspects[(suspects >= AROUND - 1) & (suspects < gaps.size - AROUND)]
    if not 0 < suspects.size <= MOST_STEPS:
        return []
    found: list[Step] = []
    for first in (suspects + 1).tolist():
        # Messages that overtook each other at a step show it several times.
        if not found or first - found[-1].first >= AROUND:
            around = slice(first - AROUND, first + AROUND)
            size = _step_halfway(stamp[around], log[around])
            if abs(size) > LEAST_STEP * NS_PER_S:
                found.append(Step(first, round(size), int(log[first])))
    return found


def _step_halfway(stamp: Int, log: Int) -> float:
    """By how much a clock was set halfway between some samples [ns]; 0 where it was not."""
    lead = stamp - log
    parts = lead[:AROUND], lead[AROUND:]
    levels = [median_of(part) for part in parts]
    size = levels[1] - levels[0]
    spread = max(median_of(np.abs(part - level)) for part, level in zip(parts, levels, strict=True))
    gaps = np.diff(log)
    period = median_of(gaps)
    scatter = median_of(np.abs(gaps - period))
    arrived = gaps[AROUND - 1] - period
    stepped = stamp[AROUND] - stamp[AROUND - 1] - period
    runs_on = abs(arrived) <= max(0.5 * period, FAR * scatter)
    # Another message may have overtaken the last one.
    is_all = abs(stepped - size) <= max(1.5 * period, FAR * spread)
    if abs(size) <= FAR * spread or not (runs_on and is_all):
        return 0.0
    # Stamps may be steadier than the times of the log, where none is lost.
    regular, scatter = _of_regular_stamps(stamp)
    steadier = scatter < spread and abs(regular - size) <= max(0.5 * period, FAR * spread)
    return regular if steadier else size


def _of_regular_stamps(stamp: Int) -> tuple[float, float]:
    """By how much regular stamps step halfway, and their median distance from that [ns]."""
    number = np.arange(len(stamp)) - 0.5 * (len(stamp) - 1)
    design = np.stack([np.ones(len(stamp)), number, number > 0], axis=1)
    there = (stamp - stamp[0]).astype(np.float64)
    found = np.linalg.lstsq(design, there, rcond=None)[0]
    return float(found[2]), median_of(np.abs(there - design @ found))


def _notes(found: Sequence[Sequence[Step]], names: Sequence[str], begin: int) -> list[ReadingNote]:
    """One note for each time at which clocks were set."""
    every = sorted(
        (step.time, step.size, name)
        for steps, name in zip(found, names, strict=True)
        for step in steps
    )
    groups: list[list[tuple[int, int, str]]] = []
    for each in every:
        if groups and each[0] - groups[-1][0][0] < NS_PER_S:
            groups[-1].append(each)
        else:
            groups.append([each])
    notes = []
    for group in groups:
        sizes = [size / NS_PER_S for _, size, _ in group]
        sources = tuple(name for _, _, name in group)
        by = f"{1e3 * float(np.median(sizes)):+.3g} ms"
        words = (
            f"at {(group[0][0] - begin) / NS_PER_S:.1f} s the clock that stamps "
            f"{shortened(list(sources), 4)} was set by {by}; what followed was set back as much "
            "(set clocks before a recording, not during it)"
        )
        notes.append(ReadingNote("clock step", words, sources, float(np.median(sizes))))
    return notes
