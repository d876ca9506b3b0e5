"""Turn gathered samples into the streams of a recording: times, one clock, finite values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.credibility import (
    FORCES_APART,
    POSITIONS_APART,
    absurd,
    real_efforts,
    several_publishers,
)
from skin2urdf.recording.holding import held_notes, measurements
from skin2urdf.recording.namesakes import told_apart
from skin2urdf.recording.naming import shortened, su_names, writable
from skin2urdf.recording.pulses import Read, lonely_spikes
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.shelf import Shelf, put_away
from skin2urdf.recording.silence import silence_notes, silences, through
from skin2urdf.recording.streams import Samples
from skin2urdf.recording.timing import SampleTimes, Stamped, TimedStream, sample_times_of
from skin2urdf.threads import each

# Streams whose stamps differ from the log time this much more than others' were stamped by a
# clock of their own (a device that counts from its start, say), not late [s].
OTHER_CLOCK = 5.0
# No joint reads more [rad or m]; such values are damage.
LARGEST_VALUE = 1e6
# Samples of SUs that are in memory while they are timed: some 30 MB.
TIMED_TOGETHER = 1 << 18


class Source(NamedTuple):
    """What one SU, or joints that share times, sent.

    Attributes:
        name: of the SU.
        topic: where it came from.
        samples: the samples.
    """

    name: str
    topic: str
    samples: Samples


def timed_joints(
    gathered: Mapping[tuple[str, tuple[str, ...]], Samples],
) -> tuple[list[TimedStream], list[ReadingNote]]:
    """Time the samples of all joints.

    Args:
        gathered: positions by topic and joint names.

    Returns:
        One stream per joint, sorted by name, and notes for the user.
    """
    found: dict[str, list[TimedStream]] = {}
    notes: list[ReadingNote] = []
    repeating: dict[str, float] = {}
    on_change: list[str] = []
    for (topic, names), samples in gathered.items():
        credible = np.abs(samples.values) < LARGEST_VALUE
        if not credible.all():
            samples = samples._replace(values=np.where(credible, samples.values, np.nan))
        if several_publishers(samples.values, POSITIONS_APART, of_forces=False):
            words = (
                f"the positions of {shortened(names)} on {topic} were left out: several publishers "
                "send them in turn, and they contradict each other; record only one of them"
            )
            notes.append(ReadingNote("several publishers", words, (topic, *names)))
            continue
        held = measurements(samples.values, _clock(samples))
        if held.times > 1.0:
            repeating.update(dict.fromkeys(names, held.times))
            samples = samples.at(held.kept)
        samples, silent = _through_silence(samples)
        on_change += names if silent else []
        (whole,) = _timed([Source("", topic, samples)])
        for name, values, effort in zip(
            names, whole.values.T, _efforts_of(whole, len(names)), strict=True
        ):
            one = whole._replace(name=name, values=values, beside=effort)
            stream, note = _finite(one, f"joint {name}")
            notes.extend(note)
            if stream is not None:
                found.setdefault(name, []).append(stream)
    single, namesakes = told_apart(found)
    names_found = sorted(single)
    called, renamed = writable(names_found, "joint")
    notes += [*held_notes(repeating, "position"), *silence_notes(on_change), *renamed, *namesakes]
    chosen = [
        single[name]._replace(name=new) for name, new in zip(names_found, called, strict=True)
    ]
    return sorted(chosen, key=lambda stream: stream.name), notes


def _through_silence(samples: Samples) -> tuple[Samples, bool]:
    """Positions that go on where none is sent as none changes, and whether they do anywhere."""
    since = _clock(samples)
    gaps = silences(since, samples.values)
    if not len(gaps):
        return samples, False
    times, number = through(since, gaps)
    later = np.rint((times - since[number]) * 1e9).astype(np.int64)
    held = samples.at(number)
    stamp = np.where(held.stamp > 0, held.stamp + later, held.stamp)
    return held._replace(stamp=stamp, log_time=held.log_time + later), True


def timed_sus(
    gathered: dict[tuple[str, str], Samples], shelf: Shelf
) -> tuple[list[TimedStream], list[SuStream], list[ReadingNote]]:
    """Name the SUs and time their samples.

    Args:
        gathered: readings by topic and frame_id; emptied on the way, as what is not needed any
            more is as large as what is kept.
        shelf: where the streams are kept.

    Returns:
        One stream per SU, sorted by name; SUs that sent messages, none of which holds a reading;
        and notes for the user.
    """
    names, notes = writable(su_names(list(gathered)), "SU")
    few: list[str] = []
    empty: list[SuStream] = []
    repeating: dict[str, float] = {}

    def together() -> Iterator[list[Source]]:
        # What is timed together leaves the memory together.
        waiting: list[Source] = []
        count = 0
        for name, (topic, frame) in zip(names, list(gathered), strict=True):
            sent = gathered[topic, frame].stamp.size
            samples, found = _sound(name, topic, frame, gathered.pop((topic, frame)))
            notes.extend(found)
            if samples is not None and samples.stamp.size < 2:
                # A single message may be anything, as one whose frame_id was damaged.
                if sent > 1:
                    empty.append(SuStream(name, np.zeros(0), np.zeros((0, 3)), topic))
                else:
                    few.append(f"SU {name} ({topic})")
            elif samples is not None:
                held = measurements(samples.values, _clock(samples))
                if held.times > 1.0:
                    repeating[name] = held.times
                    samples = samples.at(held.kept)
                waiting.append(Source(name, topic, samples))
                count += samples.stamp.size
            if count >= TIMED_TOGETHER:
                yield waiting
                waiting, count = [], 0
        yield waiting

    streams: list[TimedStream] = []
    of_spikes: list[ReadingNote] = []
    for timed, found in each(lambda some: _put(some, shelf), together(), len(names)):
        streams += timed
        of_spikes += found
        shelf.put_away()
    notes += [*of_spikes, *held_notes(repeating)]
    if few:
        words = f"left out, with fewer than two usable samples: {shortened(few)}"
        notes.append(ReadingNote("too few", words, tuple(few)))
    return sorted(streams, key=lambda stream: stream.name), empty, notes


def _clock(samples: Samples) -> F64:
    """(N,) times of some samples since the first [s], by their stamps if they have any."""
    clock = samples.stamp if (samples.stamp > 0).any() else samples.log_time
    return np.asarray((clock - clock[:1]) / 1e9)


def _sound(
    name: str, topic: str, frame: str, samples: Samples
) -> tuple[Samples | None, list[ReadingNote]]:
    """The samples of an SU that can be readings, None where they are not one SU's, and notes."""
    what, notes = f"SU {name} ({topic})", []
    # Without its bad samples first: they would spoil the comparison of timings.
    bad = absurd(samples.values)
    if bad.any():
        n = int(np.count_nonzero(bad))
        words = (
            f"{what}: {n} samples are not finite or beyond what any accelerometer gives; left out"
        )
        notes.append(ReadingNote("absurd values", words, (name, topic), n))
        samples = samples.at(~bad)
    if several_publishers(samples.values, FORCES_APART, of_forces=True):
        words = (
            f"{what} was left out: several publishers send as {frame!r} on {topic}, and "
            "nothing tells whose a message is; give each SU a frame_id or a topic of its own"
        )
        return None, [*notes, ReadingNote("several publishers", words, (topic, frame))]
    return samples, notes


def _put(waiting: list[Source], shelf: Shelf) -> tuple[list[TimedStream], list[ReadingNote]]:
    """Time the samples of some SUs, without spikes, and put them on the shelf; none waits then."""
    streams, notes = [], []
    timed = _timed(waiting)
    spiked = lonely_spikes([Read(stream.time / 1e9, stream.values) for stream in timed])
    for stream, alone in zip(timed, spiked, strict=True):
        if alone.any():
            n = int(np.count_nonzero(alone))
            words = (
                f"SU {stream.name} ({stream.topic}): {n} single samples depart far from all "
                "around them; left out"
            )
            notes.append(ReadingNote("spikes", words, (stream.name, stream.topic), n))
            stream = stream._replace(
                time=stream.time[~alone],
                values=stream.values[~alone],
                beside=None if stream.beside is None else stream.beside[~alone],
            )
        streams.append(
            stream._replace(
                time=shelf.put(stream.time),
                values=shelf.put(stream.values),
                beside=None if stream.beside is None else shelf.put(stream.beside),
            )
        )
    waiting.clear()
    return streams, notes


def timing_notes(streams: Sequence[TimedStream]) -> list[ReadingNote]:
    """Say how times were made where they are not simply the stamps.

    Args:
        streams: all joints and SUs.

    Returns:
        Notes for the user.
    """
    notes = [
        ReadingNote(
            "contradicting stamps",
            f"{stream.name} ({stream.topic}): {stream.contradicting} of "
            f"{stream.contradicting + stream.time.size} samples left out, as their stamps repeat "
            "or contradict others",
            (stream.name, stream.topic),
            stream.contradicting,
        )
        for stream in streams
        if stream.contradicting
    ]
    unstamped = sorted({stream.topic for stream in streams if not stream.stamped})
    if unstamped:
        words = f"no header stamps on {', '.join(unstamped)}: log times were used"
        notes.append(ReadingNote("no stamps", words, tuple(unstamped)))
    regular = sum(stream.chosen == "regular" for stream in streams)
    if regular:
        words = (
            f"stamps of {regular} of {len(streams)} joints and SUs scatter, as most do: their "
            "samples were timed at the rate of the sensor, and nothing has to be mended"
        )
        notes.append(ReadingNote("noisy stamps", words, number=regular))
    return [*notes, *_late_messages(streams)]


def _late_messages(streams: Sequence[TimedStream]) -> list[ReadingNote]:
    """Say which topics have stamps that scatter by more than a sampling period."""
    worst: dict[str, float] = {}
    for stream in streams:
        period = (stream.time[-1] - stream.time[0]) / 1e9 / max(stream.time.size - 1, 1)
        if stream.stamp_noise > period:
            worst[stream.topic] = max(stream.stamp_noise, worst.get(stream.topic, 0.0))
    if not worst:
        return []
    topics = sorted(worst)
    words = (
        f"messages on {shortened(topics, 4)} were stamped late, by {1e3 * max(worst.values()):.2g} "
        "ms more or less, which is more than from one to the next: when they were taken is not "
        "known well, least where some are lost; stamp them where they are taken"
    )
    return [ReadingNote("late messages", words, tuple(topics), max(worst.values()))]


def recorded(
    joints: Sequence[TimedStream],
    sus: Sequence[TimedStream],
    empty: Sequence[SuStream],
    shelf: Shelf,
    *,
    source: str,
    digest: str,
    notes: Sequence[ReadingNote],
) -> Recording:
    """Put all streams on one clock that starts with the first sample.

    Args:
        joints: at least one joint, sorted by name.
        sus: at least one SU, sorted by name.
        empty: SUs without a reading.
        shelf: where the times are kept.
        source: where the log came from.
        digest: SHA-256 of the log (hex).
        notes: notes for the user so far.

    Returns:
        The recording.
    """
    reference = max(joints, key=lambda stream: stream.time.size).clock_offset
    shifts: dict[int, int] = {}
    moved: set[str] = set()
    for stream in (*joints, *sus):
        ahead = 0
        if reference is not None and stream.clock_offset is not None:
            ahead = stream.clock_offset - reference
        if abs(ahead) > OTHER_CLOCK * 1e9:
            moved.add(stream.topic)
            shifts[id(stream.time)] = -ahead
        else:
            shifts[id(stream.time)] = 0
    start = min(int(stream.time[0]) + shifts[id(stream.time)] for stream in (*joints, *sus))
    # Streams that share their times go on sharing them.
    seconds: dict[int, F64] = {}
    for stream in (*joints, *sus):
        key = id(stream.time)
        if key not in seconds:
            seconds[key] = shelf.put((stream.time + (shifts[key] - start)) / 1e9)
            seconds[key].flags.writeable = False
            put_away(stream.time)
    # Nothing else holds the readings: as records have them they need not be copied.
    for su in sus:
        for array in (su.values, su.beside):
            if array is not None:
                array.flags.writeable = False
    clocks = f"the clock of {', '.join(sorted(moved))} is not the joints'; matched by log times"
    extra = [ReadingNote("other clock", clocks, tuple(sorted(moved)))] if moved else []
    heard = [SuStream(s.name, seconds[id(s.time)], s.values, s.topic, s.beside) for s in sus]
    return Recording(
        joints=tuple(
            JointStream(s.name, seconds[id(s.time)], s.values, s.stamp_noise, s.beside)
            for s in joints
        ),
        sus=tuple(sorted((*heard, *empty), key=lambda su: su.name)),
        start=start / 1e9,
        source=source,
        digest=digest,
        notes=(*notes, *extra),
    )


def _timed(sources: Sequence[Source]) -> list[TimedStream]:
    """Time the samples of some sources."""
    times = sample_times_of([Stamped(*source.samples[:3]) for source in sources])
    return [_at_times(*pair) for pair in zip(sources, times, strict=True)]


def _at_times(source: Source, times: SampleTimes) -> TimedStream:
    """A source with the times of its samples."""
    samples = source.samples
    count = samples.stamp.size
    whole = times.kept.size == count and bool((np.diff(times.kept) == 1).all())
    kept = samples if whole else samples.at(times.kept)
    return TimedStream(
        name=source.name,
        topic=source.topic,
        time=times.time,
        values=kept.values,
        clock_offset=times.clock_offset,
        stamped=times.stamped,
        chosen=times.chosen,
        contradicting=count - times.kept.size,
        stamp_noise=times.noise,
        beside=kept.beside,
    )


def _efforts_of(whole: TimedStream, n_joints: int) -> list[F64 | None]:
    """(N,) efforts of each of the joints that share times; None where they are not real."""
    if whole.beside is None:
        return [None] * n_joints
    return [real_efforts(column) for column in whole.beside.T]


def _finite(stream: TimedStream, what: str) -> tuple[TimedStream | None, list[ReadingNote]]:
    """Leave out positions that are not finite; None where too few stay."""
    finite = np.isfinite(stream.values)
    bad = int(np.count_nonzero(~finite))
    notes, sources = [], (stream.name, stream.topic)
    if bad:
        words = (
            f"{what} ({stream.topic}): {bad} positions are not finite or absurdly large; left out"
        )
        notes.append(ReadingNote("absurd values", words, sources, bad))
        effort = None if stream.beside is None else stream.beside[finite]
        stream = stream._replace(
            time=stream.time[finite], values=stream.values[finite], beside=effort
        )
    if stream.time.size < 2:
        words = f"{what} ({stream.topic}) was left out: fewer than two usable positions"
        notes.append(ReadingNote("too few", words, sources))
        return None, notes
    return stream, notes
