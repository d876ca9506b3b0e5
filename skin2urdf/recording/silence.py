"""Joints that are sent on change only: where nothing is sent they stay.

Some publishers, and bridges from field buses, send a position when it changes, and else never or
seldom. Where joints rest their stream then has a gap, and rests are what gravity is measured in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.naming import shortened
from skin2urdf.recording.records import JointStream, Recording

SILENT = 4.5
"""Time between two samples in which others are missing, over the usual one: a message is late by as
much as one or two follow each other, and two in a row are seldom lost."""
SHORTEST_GAP = 0.03
"""Time between two samples in which no motion that features show goes unseen [s]."""
# What is sent as it changes is hardly ever sent unchanged: now and then by a timer.
_UNCHANGED = 0.05
# Gaps at whose ends joints are alike: fewer may be one motion that came back to where it began.
_FEWEST = 5
# Time between two samples over the usual one, from which a publisher that is silent at rest was so
# in slow motion as well: stamps that scatter make less of it.
_SHORT = 1.8
# Samples that silence may last in all: a day at 100 Hz. Stamps that scatter by years show none.
_MOST = 1 << 23
# Change behind a gap over the usual one from sample to sample: no more, but for rounding.
_ROUNDED = 1.5


def silences(time: F64, positions: F64) -> Int:
    """Numbers (K,) of the samples behind which nothing was sent as nothing changed.

    A publisher that sends on change sends hardly anything twice, and is silent where joints are
    afterwards as they were before: no further than they usually go from one sample to the next. Of
    one that loses messages, joints that move are elsewhere after some gap, and those that rest are
    sent unchanged in between.

    Args:
        time: (N,) when messages were sent [s].
        positions: (N, D) of all joints that they hold [rad or m], NaN where one is missing.

    Returns:
        No numbers where joints are not sent on change.
    """
    none = np.zeros(0, dtype=np.int64)
    if len(time) < 2 * _FEWEST:
        return none
    steps = np.diff(time)
    silent = steps > max(SILENT * float(np.median(steps)), SHORTEST_GAP)
    if np.count_nonzero(silent) < _FEWEST or silent.all():
        return none
    if steps[silent].sum() > _MOST * np.median(steps):
        return none
    changes = np.stack([np.abs(np.diff(_whole(column))) for column in positions.T])
    if np.mean((changes[:, ~silent] == 0).all(axis=0)) > _UNCHANGED:
        return none
    stays = np.ones(len(steps), dtype=bool)
    for change in changes:
        moves = change[~silent & (change > 0)]
        stays &= change <= _ROUNDED * (np.median(moves) if moves.size else 0.0)
    if not stays[silent].all():
        return none
    return np.flatnonzero(stays & (steps > _SHORT * np.median(steps)))


def _whole(positions: F64) -> F64:
    """Positions (N,) of a joint with straight lines where they are not finite, turns aside."""
    there = np.flatnonzero(np.isfinite(positions))
    if not there.size:
        return np.zeros(len(positions))
    return np.interp(np.arange(len(positions)), there, np.unwrap(positions[there]))


def through(time: F64, gaps: Int) -> tuple[F64, Int]:
    """Times (M,) that go on through silences, and the numbers (M,) of the samples that hold then.

    Args:
        time: (N,) when messages were sent [s].
        gaps: (K,) numbers of the samples behind which there is silence.
    """
    steps = np.diff(time)
    # The mean of those that lack none, as stamps that scatter shift their median.
    usual = float(steps[steps < 1.5 * np.median(steps)].mean())
    more = [
        np.linspace(time[k], time[k + 1], max(1, round(steps[k] / usual)), endpoint=False)[1:]
        for k in gaps
    ]
    number = [
        np.arange(len(time)),
        *(np.full(len(each), k) for k, each in zip(gaps, more, strict=True)),
    ]
    times, numbers = np.concatenate([time, *more]), np.concatenate(number)
    order = np.lexsort((times, numbers))
    return times[order], numbers[order]


def joints_through_silence(recording: Recording) -> Recording:
    """A recording with joints that are sent on change going on where nothing is sent.

    Args:
        recording: streams as they were sent.

    Returns:
        The recording, with a note on these joints.
    """
    joints: dict[str, JointStream] = {}
    silent: list[str] = []
    for members in recording.joints_together:
        time = members[0].time
        gaps = silences(time, np.stack([joint.position for joint in members], axis=1))
        silent += [joint.name for joint in members] if len(gaps) else []
        times, number = through(time, gaps) if len(gaps) else (time, np.arange(len(time)))
        for joint in members:
            held = replace(joint.at(number), time=times) if len(gaps) else joint
            joints[joint.name] = held
    if not silent:
        return recording
    return replace(
        recording,
        joints=tuple(joints[joint.name] for joint in recording.joints),
        notes=(*recording.notes, *silence_notes(silent)),
    )


def silence_notes(names: Sequence[str]) -> list[ReadingNote]:
    """A note on joints that are sent on change only; none where there are none.

    Args:
        names: of the joints.
    """
    words = (
        f"{shortened(names)} {'is' if len(names) == 1 else 'are'} sent on change only: where "
        "nothing was sent, they were taken to stay; publish at a steady rate"
    )
    return [ReadingNote("sent on change", words, tuple(names))] if names else []
