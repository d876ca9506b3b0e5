"""Values that are sent several times: one measurement each, at the time it first appeared.

A driver that sends faster than its sensor measures repeats the latest value, and so do boards that
poll their sensors and controllers that publish joints faster than these are read. As samples these
are stairs, late by half a step in the middle and wrong by the motion of a step everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.naming import shortened
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.threads import each

# A sensor that hardly moves repeats itself where its steps are of a digit or two. Between larger
# ones it does so by a chance of some per cent at most, where noise is as large as the digits.
_DIGITS = 3.0
_SHARE = 0.05
# Values between two large steps that have to be there for their repetitions to tell.
_FEWEST = 20
# Deviations of the mean that no stretch of values lasts below by chance, of all that a log has.
_SURELY = 5.0
# A value that stands longer than so many times the usual is a sensor that froze, for others to say.
_FROZEN = 3.0
# Messages that are lost at most, over those received, where steps between them tell of losses. Of
# random arrivals without any 0.44 would seem to be, as steps have a median of log 2 of their mean.
_LOST = 0.25
# Measurements a second without which a sensor follows no pattern, whose slowest has 1 Hz. Values
# that come more seldom are those of rests, of which whoever recorded them kept one each [Hz].
_SLOWEST = 2.0


class Held(NamedTuple):
    """The measurements of a stream.

    Attributes:
        kept: (M,) numbers of the samples at which they appeared.
        times: how often each was sent, in the mean; 1 where none is sent twice.
    """

    kept: Int
    times: float


def measurements(values: F64, time: F64) -> Held:
    """Find the samples that are measurements and no repetitions of the one before.

    Values stand still where nothing moves and the digits are coarse; that is no repetition. But one
    that came by several digits, and goes by several digits, stood for a single measurement. How
    many samples such values last says how many measurements the others are. A shaking at a quarter
    of the rate makes such pairs of equal values, too, where digits are coarser than noise; but then
    values change with every sample elsewhere. Messages that were lost are counted: what is left of
    a measurement lasts no shorter for that. One whose first message was lost is left out.

    Args:
        values: (N, C) samples in their order.
        time: (N,) when each was sent [s].

    Returns:
        The measurements; all samples where the sensor's digits explain what repeats, or where each
        value is that of a rest: it holds as long as it was sent, not when it first was.
    """
    count = len(values)
    changed = np.logical_or.reduce(values[1:] != values[:-1], axis=1)
    start = np.concatenate([[0], np.flatnonzero(changed) + 1])
    everything = Held(np.arange(count), 1.0)
    if count - start.size < _SHARE * count or start.size < _FEWEST:
        return everything
    sent = _numbers_sent(time)
    length = np.diff(sent[start], append=sent[-1] + 1)
    step = np.abs(np.diff(values[start], axis=0))
    digit = np.array([np.quantile(s[s > 0], 0.02) if s.any() else np.inf for s in step.T])
    large = (step > _DIGITS * digit).any(axis=1)
    one = np.append(large, False) & np.insert(large, 0, False)
    if np.count_nonzero(one) < _FEWEST or np.mean(length[one] > 1) < _SHARE:
        return everything
    one &= length <= _FROZEN * np.median(length[one])
    times = float(length[one].mean())
    if _are_as_short(sent[start], times, float(length[one].std())):
        return everything
    received = np.diff(start, append=count)
    number = np.where(one, 1, np.maximum(np.rint(received / times), 1)).astype(np.int64)
    if number.sum() < _SLOWEST * float(np.ptp(time)):
        return everything
    within = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
    kept = np.repeat(start, number) + np.rint(times * within).astype(np.int64)
    # One whose first message may have been lost came earlier than it appears, nobody knows by what.
    first_lost = sent[start] > sent[start - 1] + 1
    return Held(kept[~(np.repeat(first_lost, number) & (within == 0))], times)


def _numbers_sent(time: F64) -> Int:
    """(N,) numbers of messages among all that were sent, those that were lost included.

    Args:
        time: (N,) when each was sent, or arrived after delays [s].
    """
    index = np.arange(len(time))
    step = np.diff(time)
    period = float(np.median(step[step > 0])) if (step > 0).any() else np.inf
    # One that arrives late takes no number of those that follow it.
    lost = np.maximum.accumulate(np.rint((time - time[0]) / period).astype(np.int64) - index)
    # Of messages that come in bursts, or at random, steps tell of no loss.
    return np.asarray(index + lost) if lost[-1] <= _LOST * len(time) else index


def _are_as_short(start: Int, times: float, deviation: float) -> bool:
    """Say whether values come in closer succession than measurements sent several times can.

    Args:
        start: (R,) number of the message in which each value appears.
        times: how often each measurement was sent, in the mean.
        deviation: of that from one measurement to the next.

    Returns:
        Whether some stretch, short or long, has more values than measurements come in it.
    """
    values = _FEWEST
    while values < start.size:
        shortest = int((start[values:] - start[:-values]).min())
        if shortest < times * values - _SURELY * deviation * np.sqrt(values):
            return True
        values *= 2
    return False


def as_measured(sus: Sequence[SuStream]) -> tuple[list[SuStream], list[ReadingNote]]:
    """Leave the repetitions out of streams.

    Args:
        sus: streams as they were sent.

    Returns:
        The streams with each measurement once, and a note on each that had others.
    """

    def once(su: SuStream) -> tuple[SuStream, float]:
        held = measurements(su.specific_force, su.time)
        measured = su.at(held.kept) if held.times > 1.0 else su
        measured.put_away()
        return measured, held.times

    found = list(each(once, sus, len(sus)))
    repeating = {su.name: times for su, times in found if times > 1.0}
    return [su for su, _ in found], held_notes(repeating)


def joints_as_measured(recording: Recording) -> Recording:
    """Leave repetitions out of the joints of a recording: a message is one where all repeat.

    Args:
        recording: streams as they were sent.

    Returns:
        The recording, with a note on joints that had any.
    """
    joints: dict[str, JointStream] = {}
    repeating: dict[str, float] = {}
    for members in recording.joints_together:
        time = members[0].time
        values = np.stack([joint.position for joint in members], axis=1)
        held = measurements(values, time)
        for joint in members:
            joints[joint.name] = joint.at(held.kept) if held.times > 1.0 else joint
        if held.times > 1.0:
            repeating.update(dict.fromkeys((joint.name for joint in members), held.times))
    if not repeating:
        return recording
    return replace(
        recording,
        joints=tuple(joints[joint.name] for joint in recording.joints),
        notes=(*recording.notes, *held_notes(repeating, "position")),
    )


def held_notes(repeating: Mapping[str, float], what: str = "reading") -> list[ReadingNote]:
    """Notes on streams whose values are sent several times.

    Args:
        repeating: how often each is sent in the mean, by the name of the SU or the joint.
        what: they send.

    Returns:
        One note for all that do so alike.
    """
    alike: dict[str, list[str]] = {}
    for name, times in repeating.items():
        alike.setdefault(f"{times:.3g}", []).append(name)
    return [
        ReadingNote(
            "held values",
            f"{shortened(names)} {'sends' if len(names) == 1 else 'send'} each {what} {times} "
            "times in the mean; they count once, at the time they first appear",
            tuple(names),
            float(times),
        )
        for times, names in alike.items()
    ]
