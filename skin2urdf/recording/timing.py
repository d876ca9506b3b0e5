"""When samples were taken: from header stamps and log times to strictly increasing times.

Drivers mostly stamp a sample when it arrives, so the samples are regular and the stamps noisy;
others sample irregularly and stamp exactly. Both readings are made and the signal decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.bursts import burst_ends, times_of_bursts
from skin2urdf.recording.numbering import median_of
from skin2urdf.recording.regular import regular_times_of
from skin2urdf.recording.smoothness import weigh_stamps

Chosen: TypeAlias = Literal["stamps", "regular"]
Number = TypeVar("Number", np.int64, np.float64)

NS_PER_S = 1_000_000_000
# A stamp this far off its neighbours' offset from the log time is no time of a sample [s].
WILD_STAMP = 10.0
# Wild stamps next to each other pass for sound ones until those around them are gone.
SWEEPS = 5
# Stamps that scatter less than this about regular times [periods] leave nothing to choose.
NEGLIGIBLE = 1e-3
# In its true order a signal that moves is smoother than in another by this factor.
SMOOTHER = 0.7
# Wrong stamps come to lie close to another as often as they run backwards; true ones hardly do.
CLOSE = 0.3
# Samples of streams that are looked at together: as many as stay in a processor's cache with all
# that is made of them.
TOGETHER = 1 << 15


class Stamped(NamedTuple):
    """A stream as it was recorded.

    Attributes:
        stamp: (N,) header stamps in the order of the log [ns], 0 where unset.
        log_time: (N,) times the messages were recorded [ns].
        signal: (N, C) the samples.
    """

    stamp: Int
    log_time: Int
    signal: F64


class TimedStream(NamedTuple):
    """One joint or SU with the times of its samples.

    Attributes:
        name: joint or SU name.
        topic: where it came from.
        time: (N,) strictly increasing times [ns]; the same array for joints that share times.
        values: (N,) positions or (N, 3) readings.
        clock_offset: the clock's lead on the log time [ns], None if unknown.
        stamped: False where log times stand in for stamps.
        chosen: whether the times are the stamps or were made regular.
        contradicting: samples left out because of their stamps.
        stamp_noise: scatter of the stamps about the times [s].
        beside: (N, 3) angular velocities of an SU with a gyroscope [rad/s], or (N,) efforts of a
            joint [N m or N].
    """

    name: str
    topic: str
    time: Int
    values: F64
    clock_offset: int | None
    stamped: bool
    chosen: Chosen
    contradicting: int
    stamp_noise: float = 0.0
    beside: F64 | None = None


class SampleTimes(NamedTuple):
    """Times of the samples of one stream.

    Attributes:
        time: (M,) strictly increasing times [ns since the epoch of the clock].
        kept: (M,) numbers of the samples these times belong to.
        chosen: whether the times are the stamps or were made regular.
        stamped: False where no message was stamped and log times stand in.
        clock_offset: stamps minus log times [ns], the median; None where log times do not run.
        noise: scatter of the stamps about times that were made regular, 0 where they are the times
            [s].
    """

    time: Int
    kept: Int
    chosen: Chosen
    stamped: bool
    clock_offset: int | None
    noise: float = 0.0


def sample_times(stamp: Int, log_time: Int, signal: F64) -> SampleTimes:
    """Decide when each sample of a stream was taken.

    Args:
        stamp: (N,) header stamps in the order of the log [ns], 0 where unset.
        log_time: (N,) times the messages were recorded [ns].
        signal: (N, C) the samples.

    Returns:
        Times of the samples; repeated, and where need be contradicting, samples are left out.
    """
    return sample_times_of([Stamped(stamp, log_time, signal)])[0]


def sample_times_of(streams: Sequence[Stamped]) -> list[SampleTimes]:
    """Decide when each sample of each stream was taken, each stream by itself.

    Streams of as many samples are looked at together, which is several times faster where they are
    many and short.

    Args:
        streams: what was recorded.

    Returns:
        What `sample_times` returns for each.
    """
    ordered = [_ordered(stream) for stream in streams]
    found: dict[int, SampleTimes] = {}
    for rows in _alike(ordered):
        found |= zip(rows, _timed([ordered[k] for k in rows]), strict=True)
    return [found[k] for k in range(len(streams))]


class _Ordered(NamedTuple):
    """A stream in the order in which its samples were taken.

    Attributes:
        clock: (N,) times on one clock [ns], not falling but where stamps are wrong.
        signal: (N, C) the samples.
        kept: (N,) their numbers.
        stamped: False where log times stand in for stamps.
        offset: stamps minus log times [ns], None where log times do not run.
    """

    clock: Int
    signal: F64
    kept: Int
    stamped: bool
    offset: int | None


def _ordered(stream: Stamped) -> _Ordered:
    """Put a stream on one clock, and its samples in order."""
    stamp, log_time, signal = stream
    clock, stamped = stamped_clock(stamp, log_time)
    log_runs = log_time.size > 0 and int(log_time.max()) > int(log_time.min())
    offset = int(median_of(clock - log_time)) if log_runs else None
    kept = np.arange(clock.size)
    if (np.diff(clock) <= 0).any():
        kept = _without_repeats(clock, signal)
        kept = kept[_order(clock[kept], signal[kept])]
        clock, signal = clock[kept], signal[kept]
    return _Ordered(clock, signal, kept, stamped, offset)


def _alike(streams: Sequence[_Ordered]) -> Iterator[list[int]]:
    """Numbers of streams with as many samples, and channels, that are looked at together."""
    by_shape: dict[tuple[int, ...], list[int]] = {}
    for k, stream in enumerate(streams):
        by_shape.setdefault(stream.signal.shape, []).append(k)
    for (count, channels), rows in by_shape.items():
        most = max(1, TOGETHER // max(count * -(-channels // 3), 1))
        for first in range(0, len(rows), most):
            yield rows[first : first + most]


def _timed(streams: Sequence[_Ordered]) -> list[SampleTimes]:
    """Times of streams with as many samples each."""
    count = streams[0].clock.size
    if count < 2:
        return [SampleTimes(s.clock, s.kept, "stamps", s.stamped, s.offset) for s in streams]
    origin = [int(stream.clock.min()) for stream in streams]
    clocks = np.stack([s.clock - begin for s, begin in zip(streams, origin, strict=True)])
    stamps: F64 = clocks / NS_PER_S
    ends = [burst_ends(row) for row in stamps]
    regular: list[F64 | None] = [None] * len(streams)
    smooth = [k for k, end in enumerate(ends) if end is None]
    for k, times in zip(smooth, regular_times_of(stamps[smooth]), strict=True):
        regular[k] = times
    for k, end in enumerate(ends):
        if end is not None:
            regular[k] = times_of_bursts(stamps[k], end)
    # What arrived in bursts was not taken in bursts.
    chosen: list[Chosen] = ["regular" if times is not None else "stamps" for times in regular]
    open_ = [k for k in smooth if regular[k] is not None]
    for k, choice in zip(open_, _choices(stamps, regular, streams, open_), strict=True):
        chosen[k] = choice
    out = []
    for k, stream in enumerate(streams):
        fitted, end = regular[k], ends[k]
        if chosen[k] == "regular" and fitted is not None:
            rising = _rising(fitted, stamps[k])
            time = origin[k] + np.rint(fitted[rising] * NS_PER_S).astype(np.int64)
            apart = np.abs(stamps[k] - fitted)
            noise = 1.4826 * median_of(apart if end is None else apart[end])
        else:
            rising = _rising(stamps[k], fitted)
            time = stream.clock[rising]
            noise = 0.0
        kept = stream.kept if rising.size == count else stream.kept[rising]
        out.append(SampleTimes(time, kept, chosen[k], stream.stamped, stream.offset, noise))
    return out


def stamped_clock(stamp: Int, log_time: Int) -> tuple[Int, bool]:
    """Return stamps where they are set and credible, log times moved to the same clock elsewhere.

    Returns:
        (N,) times [ns], and whether any stamp is set.
    """
    if stamp.size and int(stamp.min()) > 0:
        offset = stamp - log_time
        if int(offset.max()) - int(offset.min()) <= WILD_STAMP * NS_PER_S:
            return stamp, True
    usable = stamp > 0
    if not usable.any():
        return log_time, False
    rows = np.flatnonzero(usable)
    offset = stamp[rows] - log_time[rows]
    for _ in range(SWEEPS):
        if not (np.abs(np.diff(offset)) > WILD_STAMP * NS_PER_S).any():
            break
        wild = np.abs(offset - _rolling_median(offset)) > WILD_STAMP * NS_PER_S
        # Where most are wild, the others agree with the middle of nothing.
        wild |= _rolling_median(wild.astype(np.int64)) > 0
        if not wild.any() or wild.all():
            break
        rows, offset = rows[~wild], offset[~wild]
    if rows.size == stamp.size or rows.size == 0:
        return stamp, True
    middle = int(np.median(offset))
    missing = np.setdiff1d(np.arange(stamp.size), rows)
    clock = stamp.copy()
    between = np.interp(missing, rows, (offset - middle).astype(np.float64))
    clock[missing] = log_time[missing] + middle + np.rint(between).astype(np.int64)
    return clock, True


def _rolling_median(values: NDArray[Number], width: int = 11) -> NDArray[Number]:
    """Median of the values around each value."""
    half = min(width // 2, values.size // 2)
    # Reflected without the outermost value, which would outvote its neighbours.
    padded = np.pad(values, half, mode="reflect") if half else values
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    middle: NDArray[Number] = np.partition(windows, half, axis=1)[:, half]
    return middle


def _without_repeats(clock: Int, signal: F64) -> Int:
    """Leave out messages that were delivered twice.

    A coarse clock gives different samples the same stamp; those stay. So equal stamps count as
    repeats only where all neighbours with equal stamps have equal values too.
    """
    same_time = np.flatnonzero(np.diff(clock) == 0)
    if same_time.size == 0:
        return np.arange(clock.size)
    here, there = signal[same_time], signal[same_time + 1]
    same_value = (here == there) | (np.isnan(here) & np.isnan(there))
    if not same_value.all():
        return np.arange(clock.size)
    return np.delete(np.arange(clock.size), same_time + 1)


def _order(clock: Int, signal: F64) -> Int:
    """Put samples that overtook each other on the way back in order.

    Stamps run backwards either because messages were swapped or because the stamps are wrong.
    The signal is rougher in the wrong order. Where it does not tell, the stamps do: put in order,
    those of messages that overtook each other are as far apart as any, while one that is wrong
    comes to lie closer than half a period to another.
    """
    arrival = np.arange(clock.size)
    if not (np.diff(clock) < 0).any():
        return arrival
    stamped = np.argsort(clock, kind="stable")
    differ = np.flatnonzero(stamped != arrival)
    rough, smooth = _roughness(signal, stamped, differ)
    if smooth < SMOOTHER * rough:
        return stamped
    step = np.diff(clock[stamped])
    close = np.count_nonzero(step < 0.5 * median_of(step))
    overtaken = np.count_nonzero(np.diff(clock) < 0)
    if rough >= SMOOTHER * smooth and close < CLOSE * overtaken:
        return stamped
    return arrival


def _roughness(signal: F64, order: Int, places: Int) -> tuple[float, float]:
    """Sum over channels of how much the signal kinks around some places.

    Args:
        signal: (N, C) the samples as they arrived.
        order: (N,) their numbers in another order.
        places: where the two orders differ.

    Returns:
        The sums in the order of arrival and in the other; both relative to the kinks of the other.
    """
    if signal.shape[0] < 3:
        return 0.0, 0.0
    near = np.unique(np.clip(places[:, None] - np.arange(3), 0, signal.shape[0] - 3))
    kinks = []
    for values in (signal, signal[order]):
        kink = np.abs(np.diff(values, n=2, axis=0))
        kinks.append(np.where(np.isfinite(kink), kink, 0.0))
    scale = kinks[1].mean(axis=0)
    scale = np.where(scale > 0.0, scale, np.inf)
    rough, smooth = (float((kink[near].sum(axis=0) / scale).sum()) for kink in kinks)
    return rough, smooth


def _choices(
    stamps: F64, regular: Sequence[F64 | None], streams: Sequence[_Ordered], rows: Sequence[int]
) -> list[Chosen]:
    """Choose the times on which the signal is smoother where it moves.

    Args:
        stamps: (S, N) stamps of all streams [s].
        regular: their regular times; there are some for those that are asked for.
        streams: the streams.
        rows: numbers of those that are asked for.
    """
    if not rows:
        return []
    fitted = np.stack([times for k in rows if (times := regular[k]) is not None])
    stamps = stamps[rows]
    period = (fitted[:, -1] - fitted[:, 0]) / (fitted.shape[1] - 1)
    apart = np.abs(stamps - fitted)
    chosen: list[Chosen] = ["stamps"] * len(rows)
    noisy = np.flatnonzero(apart.max(axis=1) > NEGLIGIBLE * period)
    if not noisy.size:
        return chosen
    signals = [streams[rows[k]].signal for k in noisy.tolist()]
    share, uncertainty = weigh_stamps(stamps[noisy], fitted[noisy], signals)
    # Where the signal hardly moves, either would do; between stamps that all but coincide, noise
    # would be interpolated with slopes that it never had.
    for k, stands in zip(noisy, share - 2.0 * uncertainty > 0.5, strict=True):
        chosen[k] = "stamps" if stands else "regular"
    return chosen


def _rising(time: F64, reference: F64 | None) -> Int:
    """Choose samples so that their times strictly increase, leaving out as few as need be.

    Where a time does not exceed the one before, the one of the two further from the reference
    is left out.

    Args:
        time: (N,) times [s].
        reference: (N,) other times of the same samples [s]; the neighbours' median if None.

    Returns:
        (M,) numbers of the samples that stay.
    """
    # Results are kept in whole nanoseconds, so times must differ by more than that.
    least = 1.5 / NS_PER_S
    kept = np.arange(time.size)
    if (np.diff(time) >= least).all():
        return kept
    distance = np.abs(time - (_rolling_median(time) if reference is None else reference))
    for _ in range(20):
        before = np.flatnonzero(np.diff(time[kept]) < least)
        if before.size == 0:
            return kept
        worse_before = distance[kept[before]] > distance[kept[before + 1]]
        kept = np.delete(kept, np.where(worse_before, before, before + 1))
    highest = np.maximum.accumulate(time[kept])
    rises = np.concatenate([[True], time[kept][1:] >= highest[:-1] + least])
    return kept[np.flatnonzero(rises)]
