"""When samples were taken: from header stamps and log times to strictly increasing times.

Drivers mostly stamp a sample when it arrives, so the samples are regular and the stamps noisy;
others sample irregularly and stamp exactly. Both readings are made and the signal decides.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.bursts import burst_ends, times_of_bursts
from skin2urdf.recording.numbering import median_of
from skin2urdf.recording.regular import regular_times
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
# Scatter of stamps [periods] up to which a stream counts as nearly regular.
NEARLY_REGULAR = 0.25
# In its true order a signal that moves is smoother than in another by this factor.
SMOOTHER = 0.7
# Wrong stamps come to lie close to another as often as they run backwards; true ones hardly do.
CLOSE = 0.3


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
    clock, stamped = stamped_clock(stamp, log_time)
    log_runs = log_time.size > 0 and int(log_time.max()) > int(log_time.min())
    offset = int(median_of(clock - log_time)) if log_runs else None
    kept = np.arange(clock.size)
    if (np.diff(clock) <= 0).any():
        kept = _without_repeats(clock, signal)
        kept = kept[_order(clock[kept], signal[kept])]
        clock, signal = clock[kept], signal[kept]
    if kept.size < 2:
        return SampleTimes(clock, kept, "stamps", stamped, offset)
    origin = int(clock.min())
    stamps = (clock - origin) / NS_PER_S
    ends = burst_ends(stamps)
    regular = regular_times(stamps) if ends is None else times_of_bursts(stamps, ends)
    # What arrived in bursts was not taken in bursts.
    in_bursts = ends is not None and regular is not None
    chosen = "regular" if in_bursts else _choose(stamps, regular, signal)
    if chosen == "regular" and regular is not None:
        rising = _rising(regular, stamps)
        time = origin + np.rint(regular[rising] * NS_PER_S).astype(np.int64)
        apart = np.abs(stamps - regular)
        noise = 1.4826 * median_of(apart if ends is None else apart[ends])
    else:
        rising = _rising(stamps, regular)
        time = clock[rising]
        noise = 0.0
    return SampleTimes(time, kept[rising], chosen, stamped, offset, noise)


def stamped_clock(stamp: Int, log_time: Int) -> tuple[Int, bool]:
    """Return stamps where they are set and credible, log times moved to the same clock elsewhere.

    Returns:
        (N,) times [ns], and whether any stamp is set.
    """
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


def _choose(stamps: F64, regular: F64 | None, signal: F64) -> Chosen:
    """Choose the times on which the signal is smoother where it moves."""
    if regular is None:
        return "stamps"
    period = (regular[-1] - regular[0]) / (regular.size - 1)
    apart = np.abs(stamps - regular)
    if float(apart.max()) <= NEGLIGIBLE * period:
        return "stamps"
    evidence = weigh_stamps(stamps, regular, signal)
    margin = 2.0 * evidence.uncertainty
    if evidence.share - margin > 0.5:
        return "stamps"
    if evidence.share + margin < 0.5:
        return "regular"
    return "regular" if 1.4826 * median_of(apart) < NEARLY_REGULAR * period else "stamps"


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
