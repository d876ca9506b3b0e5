"""What is wrong with an SU's stream as it stands in the log, before any robot is known."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import erf

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.faults import Detail, Fault
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.credibility import digit_of
from skin2urdf.recording.records import SuStream
from skin2urdf.signals.digits import noise_in_digits
from skin2urdf.signals.unattached import unattached
from skin2urdf.threads import each

_PLAUSIBLE = (0.6, 1.4)
"""Static readings of a working sensor, in g."""
WEIGHTLESS = 0.1
"""Static readings, in g, of a sensor from which something takes gravity off: biases of any sensor
are less, and no unit that accelerometers use makes as little of gravity."""
_VARIED = 50
"""Values that an axis must take to be judged: one that hardly moves has few."""
_AGAIN = 10
"""Times a signal must come to its extreme for the number of its samples there to tell."""
_PILED, _NEIGHBOURS = 6.0, 3
"""Samples at the extreme over those at each of the next values, from which it is cut off."""
_BEYOND = 30
"""Samples that should lie beyond the extreme, from which it is no chance that none does."""
_SURELY = 3.0
"""Standard deviations by which the density of readings is bent more sharply than noise bends it."""
_PLATEAU = 6
"""Samples in a row at an extreme from which their sides tell whether it was cut off."""
_DIGIT = 2.5e-3
"""A digit of a 10 bit sensor, over its range."""
_MOVING = 100
"""Measurements while the robot moves from which a range can be judged."""
_ALIKE = 0.8
"""End of an axis' range over that of another: scale and bias that drivers correct are less."""
_SPIKES = 5
"""Samples that may lie beyond any range, as damage of the transmission."""
_FALSE_ALARM = 1e-9
"""Probability that chance alone makes an SU of a log count as frozen."""
_SHORTEST_FREEZE = 0.25
"""Shortest repetition of one value [s] that is a fault."""
_QUIETEST = 0.25
"""Part of the stretches and axes at rest, the quietest ones, that tells how noise compares with a
digit. In few places half of them may lie at the edge of a digit, which looks like more noise."""
_LOST = 0.05
"""Share of lost samples from which an SU counts as intermittent."""
_UNTOLD = 0.3
"""Shortest steps over the mean step below which stamps come in bursts and tell of no loss."""
_EVEN = 0.8
"""The shortest twentieth of the steps over the shortest quarter, below which they scatter so much
that no step tells of a loss: scatter alone then makes one step in 25 half as long again."""
_SILENT = 3.0
"""Time at an end of the log without a sample [s] from which an SU counts as dead there."""
_NOISY = 5.0
"""Noise over the median SU's from which an SU is named. Units of one sort differ by some tens of
per cent, and the estimate of a noise from thousands of samples by a few."""
_IN_MOTION = 3
"""Order of the differences that tell noise from slow motion, where nothing ever rests: at 100 Hz a
swing of 5 m/s^2 at 1 Hz leaves 32 mg of the first ones, and of the third ones an eighth of a mg."""
_IMPULSIVE = 10.0
"""Root mean square of second differences of samples at rest, over what the median of their steps
says of normal noise, from which readings hold what no motion made: of normal noise it is 1, of
digits 2 at most; of zeros in one of a thousand samples of an axis in which gravity is, 10 with
noise of 2 mg."""
_LEANING = 3.0
"""Sum of what leaves the values around it, over the root of its sum of squares, which is what
chance makes of the sum where either sense is as likely: from here on the mean of readings is off.
Zeros in place of readings all lead away from gravity (14 for 200 of them)."""
_AROUND = 11
"""Samples around one whose median says where it should be: the period of a vibration of 20 Hz in a
stream of 200 Hz, and more than twice the few that are lost together."""
_FEW, _GONE = 0.01, 0.4
"""Share of the readings at rest that count for none, and change of what two axes read of gravity,
in g, from which the third can not have stayed as it was: biases make up to a third."""
_IN_G = 3.0
"""Size of readings at rest that are in g, at most: a dead axis may add a false g or two."""
_AXES: tuple[Detail, ...] = ("x axis", "y axis", "z axis")
_LEAST_NOISE = 1e-3
"""Noise [m/s^2] that no accelerometer's falls below: what is less is not held against others."""


@dataclass(frozen=True, eq=False)
class Checked:
    """An SU's stream and what is wrong with it.

    Attributes:
        stream: the samples that say something.
        clipped: (M,) True for those at the end of the sensor's range.
        faults: what was found.
    """

    stream: SuStream
    clipped: Bool
    faults: tuple[Fault, ...]


def checked(
    sus: Sequence[SuStream],
    rests: Sequence[tuple[float, float]],
    span: tuple[float, float],
    pauses: Sequence[tuple[float, float]] = (),
    *,
    still: bool = True,
    cut: Container[str] = (),
) -> list[Checked]:
    """Look through all streams of a log.

    Args:
        sus: the streams.
        rests: begin and end of the times at which the robot rests [s].
        span: begin and end of the joints' streams [s].
        pauses: begin and end of the times at which no joints were recorded either [s].
        still: False where the robot moves slowly at these times, and never rests.
        cut: SUs of which a part is in use, so that nothing is known of when they send.
    """

    def resting(su: SuStream) -> tuple[Bool, float, float, float]:
        quiet = is_within(su.time, rests)
        values = su.specific_force
        found = (
            quiet,
            _repeated(values[quiet]),
            rest_noise(values, quiet, 1 if still else _IN_MOTION),
            digit_of(_steps_at_rest(values, quiet)),
        )
        su.put_away()
        return found

    of_all = list(each(resting, sus, len(sus)))
    quiet = [found[0] for found in of_all]
    at_rest, noise, digit = (np.array([found[i] for found in of_all]) for i in (1, 2, 3))
    by_themselves = unattached(sus, rests if still else (), noise, digit)

    def nothing_of(su: SuStream, fault: Fault) -> Checked:
        none = np.zeros(len(su.time), dtype=bool)
        return Checked(su.at(none), none[:0], (fault,))

    def look(u: int) -> Checked:
        su = sus[u]
        others = np.delete(at_rest, u)
        chance = float(np.median(others)) if len(others) else 0.0
        if (axis := _constant_axis(su.specific_force, quiet[u])) is not None:
            return nothing_of(su, Fault("frozen", su.name, axis))
        kept, faults = _thawed(su, quiet[u], chance)
        whole = su
        if not kept.all():
            whole = su.at(kept)
        if not faults:
            faults = [
                *(_silences(su, span) if su.name not in cut else ()),
                *_losses(su, pauses),
                *_noisiness(su.name, u, noise, digit),
            ]
        if impulses := _impulses(su, rests, max(noise[u], digit[u])):
            # While the robot moves nothing tells them from readings, and their mean is not zero.
            kept, whole = np.zeros_like(kept), su.at(np.zeros_like(kept))
            faults = [f for f in faults if f.kind != "noisy"] + impulses
        elif by_themselves[u]:
            return nothing_of(su, Fault("unattached", su.name))
        clipped = clipping(whole.specific_force, quiet[u][kept])
        if share := float(clipped.mean()) if len(clipped) else 0.0:
            faults = [*faults, Fault("saturated", su.name, size=share)]
        su.put_away()
        return Checked(whole, clipped, tuple(faults))

    return list(each(look, range(len(sus)), len(sus)))


def unusable(name: str, readings: F64, still: Bool, valid: Bool, gravity: float) -> Fault | None:
    """Why an SU can not be used; None where nothing speaks against it.

    Args:
        name: the SU.
        readings: (N, 3) readings on the grid [m/s^2].
        still: (N,) True where the robot rests.
        valid: (N,) True where the stream is whole.
        gravity: magnitude of gravity [m/s^2].
    """
    if not valid.any():
        return Fault("dead", name, "no samples")
    static = readings[still & valid]
    if not len(static):
        return Fault("dead", name, "no samples at rest")
    size = float(np.median(np.linalg.norm(static, axis=1))) / gravity
    if not _PLAUSIBLE[0] < size < _PLAUSIBLE[1]:
        return Fault("wrong unit", name, size=size, unit="g")
    return None


def is_within(time: F64, spans: Sequence[tuple[float, float]]) -> Bool:
    """(M,) True for times inside one of the intervals, their beginnings included [s]."""
    inside = np.zeros(len(time), dtype=bool)
    for begin, end in spans:
        a, b = np.searchsorted(time, [begin, end])
        inside[a:b] = True
    return inside


def _repeated(samples: F64) -> float:
    """Share of samples (M, 3) that are exactly like the one before."""
    return float((np.diff(samples, axis=0) == 0).all(axis=1).mean()) if len(samples) > 1 else 0.0


def rest_noise(samples: F64, still: Bool, order: int = 1) -> float:
    """Standard deviation of white noise [m/s^2] from the steps between samples (M, 3) at rest.

    Args:
        samples: readings.
        still: (M,) True where the robot rests.
        order: 1 for steps, more for differences of these, in which slow motion leaves less.
    """
    steps = _steps_at_rest(samples, still, order)
    if not len(steps):
        return 0.0
    return float(np.sqrt(np.median(steps**2, axis=0).mean() / comb(2 * order, order)) / 0.6745)


def _steps_at_rest(samples: F64, still: Bool, order: int = 1) -> F64:
    """(K, 3) from each of the samples (M, 3) at rest to the next one [m/s^2], or more of these."""
    throughout = still
    for _ in range(order):
        throughout = throughout[1:] & throughout[:-1]
    return np.diff(samples, n=order, axis=0)[throughout]


def _thawed(su: SuStream, still: Bool, chance: float) -> tuple[Bool, list[Fault]]:
    """Samples (M,) that are no repetitions of a frozen value, and the fault if there are any.

    A run of n repetitions is no chance where ``p^n`` is small for every place it could stand at.
    p is the share of repetitions outside of the run, but at least that of the other SUs at rest:
    sensors without noise repeat themselves while the robot rests. And at least that of a reading in
    the middle of a digit: where digits are coarser than noise, it stays there for as long as no
    joint moves the SU.

    Args:
        su: the stream.
        still: (M,) True where the robot rests.
        chance: share of repetitions of the other SUs at rest.
    """
    kept = np.ones(len(su.time), dtype=bool)
    changes = np.diff(su.specific_force, axis=0) != 0
    at_rest = still[1:] & still[:-1]
    seconds = max(float(np.ptp(su.time)), _SHORTEST_FREEZE) if len(su.time) else _SHORTEST_FREEZE
    stretch = max(1, int(_SHORTEST_FREEZE * len(su.time) / seconds))
    same = np.r_[False, ~changes.any(axis=1), False]
    edges = np.flatnonzero(np.diff(same.astype(np.int8)))
    runs = edges.reshape(-1, 2)
    repeated, total = int(same.sum()), max(1, len(su.time) - 1)
    stretches = []
    for begin, end in sorted(runs.tolist(), key=lambda run: run[0] - run[1]):
        n = end - begin
        if su.time[end] - su.time[begin] < _SHORTEST_FREEZE:
            break
        own = (repeated - n + 1) / (total - n + 2)
        outside = at_rest & kept[1:]
        outside[begin:end] = False
        stays = _stays_within_a_digit(changes[outside], stretch)
        if n * np.log(max(own, chance, stays)) > np.log(_FALSE_ALARM / total):
            break
        kept[begin + 1 : end + 1] = False
        stretches.append((float(su.time[begin]), float(su.time[end])))
        repeated, total = repeated - n, max(1, total - n)
    if not stretches:
        return kept, []
    if kept.sum() < 0.02 * len(kept):
        size = float(np.median(np.linalg.norm(su.specific_force, axis=1)))
        gravity = any(_PLAUSIBLE[0] < size / one_g < _PLAUSIBLE[1] for one_g in (1.0, GRAVITY))
        return np.zeros_like(kept), [Fault("frozen" if gravity else "dead", su.name, "always")]
    first, last = min(a for a, _ in stretches), max(b for _, b in stretches)
    long = sum(b - a for a, b in stretches)
    return kept, [Fault("frozen", su.name, begin=first, end=last, size=long, unit="s")]


def _constant_axis(readings: F64, still: Bool) -> Detail | None:
    """The axis that has one value throughout, although gravity turns into it and out of it.

    An axis that a joint turns about, or that stays along gravity, may have one value of a quiet
    sensor with coarse digits, but then the others read as much of gravity in every rest.

    Args:
        readings: (M, 3) samples.
        still: (M,) True while the robot rests.
    """
    constant = (readings == readings[:1]).all(axis=0)
    if not constant.any() or constant.all() or not still.any():
        return None
    size = np.linalg.norm(readings[still][:, ~constant], axis=1)
    least, most = np.quantile(size, [_FEW, 1 - _FEW])
    whole = float(np.median(np.linalg.norm(readings[still], axis=1)))
    one_g = GRAVITY if whole > _IN_G else 1.0
    return _AXES[int(np.argmax(constant))] if most - least > _GONE * one_g else None


def _stays_within_a_digit(changes: Bool, stretch: int) -> float:
    """Probability that a reading in the middle of its digits is followed by the same.

    The share that differs tells the noise. Both readings stay within half a digit in three axes.

    Args:
        changes: (M, 3) True where samples at rest are not what the one before was.
        stretch: samples that lie about one value.
    """
    n = len(changes) // stretch
    if not n:
        return 0.0
    shares = changes[: n * stretch].reshape(n, stretch, 3).mean(axis=1)
    noise = noise_in_digits(np.quantile(shares, _QUIETEST))
    return float(erf(0.5 / (np.sqrt(2) * noise)) ** 6)


def _silences(su: SuStream, span: tuple[float, float]) -> list[Fault]:
    """The fault of sending nothing at the end or at the beginning of the log."""
    if not len(su.time):
        return []
    begin, end = float(su.time[0]), float(su.time[-1])
    late, early = begin - span[0] > _SILENT, span[1] - end > _SILENT
    if not (late or early):
        return []
    return [
        Fault(
            "dead", su.name, "silent", begin=begin if late else np.nan, end=end if early else np.nan
        )
    ]


def _losses(su: SuStream, pauses: Sequence[tuple[float, float]]) -> list[Fault]:
    """The fault of losing samples again and again, but for pauses of the whole recording."""
    steps = np.diff(su.time)
    middle = su.time[:-1] + steps / 2
    within = np.flatnonzero(~is_within(middle, pauses))
    steps = steps[within]
    if len(steps) < 8:
        return []
    period = float(np.quantile(steps, 0.25))
    shortest = float(np.quantile(steps, 0.05))
    if period < _UNTOLD * float(steps.mean()) or shortest < _EVEN * period:
        return []
    missing = np.maximum(np.round(steps / period) - 1, 0)
    share = float(missing.sum() / (missing.sum() + len(su.time)))
    if share < _LOST:
        return []
    longest = int(within[np.argmax(steps)])
    begin, end = su.time[longest : longest + 2]
    return [Fault("intermittent", su.name, begin=float(begin), end=float(end), size=share)]


def _noisiness(name: str, u: int, noise: F64, digit: F64) -> list[Fault]:
    """The fault of being far noisier than the other SUs.

    Where a digit is coarser than noise, more than half of the steps are none or one of these, which
    looks like no noise or like as much as a digit, by where the readings lie.

    Args:
        name: of the SU.
        u: its number.
        noise: (U,) standard deviations of noise of all SUs at rest [m/s^2].
        digit: (U,) their digits, 0 where they have none [m/s^2].
    """
    if len(noise) < 3:
        return []
    usual = max(float(np.median(np.delete(noise, u))), float(digit[u]), _LEAST_NOISE)
    if noise[u] < _NOISY * usual:
        return []
    return [Fault("noisy", name, size=float(noise[u] / usual))]


def _impulses(su: SuStream, rests: Sequence[tuple[float, float]], noise: float) -> list[Fault]:
    """The fault of readings that leave a value at rest again and again, and come back to it.

    Half of the rests show it, unlike a hit. A sensor without noise shows its digits. What shakes as
    joints creep leaves it to both sides, which costs no more than noise does.

    Args:
        su: the stream.
        rests: begin and end of the times at which the robot rests [s].
        noise: standard deviation of its noise, as most samples at rest show it, or its digit where
            this is more [m/s^2].
    """
    sizes, still = [], []
    for begin, end in rests:
        a, b = np.searchsorted(su.time, [begin, end])
        if b - a > 2:
            still.append(su.specific_force[a:b])
            # Of what swings on at the begin of a rest a sample is near the mean of its neighbours.
            bends = np.diff(still[-1], n=2, axis=0)
            sizes.append(float(np.sqrt((bends**2).mean() / 6)))
    usual = max(noise, _LEAST_NOISE)
    times = float(np.median(sizes)) / usual if sizes else 0.0
    if times < _IMPULSIVE or not _leans(still, _NOISY * usual):
        return []
    return [Fault("noisy", su.name, "impulses", size=times)]


def _leans(rests: Sequence[F64], least: float) -> bool:
    """Whether what leaves the values around it does so to one side.

    Args:
        rests: (M, 3) readings of each rest [m/s^2].
        least: deviation from the values around it that no noise makes [m/s^2].
    """
    off = np.concatenate([x - median_filter(x, size=(_AROUND, 1), mode="nearest") for x in rests])
    off = off[(np.abs(off) > least).any(axis=1)]
    return bool(np.linalg.norm(off.sum(axis=0)) > _LEANING * np.linalg.norm(off))


def clipping(raw: F64, still: Bool) -> Bool:
    """(M,) True for samples (M, 3) at the ends of the sensor's range; all False if it is not met.

    A clipped signal stays at its extreme: once for long and with steep sides, or time and again
    so that its extreme holds far more samples than the values next to it. That is judged while
    the robot moves where a sensor has less noise than a digit, for it may rest at its extreme; what
    noise should have spread tells at rest as well.
    """
    # A value that is sent again is no measurement that stayed where it was.
    new = np.ones(len(raw), dtype=bool)
    new[1:] = (np.diff(raw, axis=0) != 0).any(axis=1)
    values, quiet = raw[new], still[new]
    moving, noise = values[~quiet], rest_noise(raw, still)
    if len(moving) < _MOVING:
        return np.zeros(len(raw), dtype=bool)
    may_be = [
        column for column in values.T
        if any(map(_stays_at_an_extreme, (column, column[~quiet])))
    ]  # fmt: skip
    if not may_be:
        return np.zeros(len(raw), dtype=bool)  # whatever the digit is, which takes longer to find
    noise = 1 / max(1 / noise, *map(_sharpness, values.T)) if noise else 0.0
    ends = [abs(end) for column in may_be for end in _ends(column, quiet, noise)]
    # One range for all axes: what another reads beyond is inside of it, but for what a driver
    # corrects of each axis, and for spikes.
    size = np.abs(values).max(axis=1)
    largest = float(np.partition(size, -_SPIKES)[-_SPIKES])
    ends = [end for end in ends if end > _ALIKE * largest]
    # The digit that two's complement lacks above zero is in it.
    limit = min(ends, default=np.inf) * (1 - _DIGIT)
    return np.asarray((np.abs(raw) >= limit).any(axis=1))


def _digit(column: F64) -> float:
    """The smallest step [m/s^2] between values of an axis (M,)."""
    return float(np.diff(np.unique(column)).min(initial=np.inf))


def _ends(column: F64, quiet: Bool, noise: float) -> list[float]:
    """Ends of the range that one axis (M,) meets, but for samples at rest that say nothing.

    Args:
        column: the axis.
        quiet: (M,) True for samples at rest, which say nothing where there is less noise than a
            digit.
        noise: standard deviation of the sensor's noise.
    """
    still = quiet & (noise <= _digit(column))
    moving = column[~still]
    values, counts = np.unique(moving, return_counts=True)
    if not len(values) or values[-1] - values[0] < _LEAST_NOISE:
        return []

    def is_end(inward: slice, own: float) -> bool:
        at = moving == values[inward][0]
        if not _is_held(at):
            return False
        begin, stop = _longest((column == values[inward][0]) & ~still)
        long = len(values) > _VARIED and stop - begin >= _PLATEAU
        piled = _piled(at, values[inward], counts[inward], noise, own)
        return (long and _steep(column, begin, stop)) or piled

    up, down = slice(None), slice(None, None, -1)
    if values[0] <= 0 <= values[-1]:
        return [float(values[inward][0]) for inward in (up, down) if is_end(inward, 0.0)]
    # Zero lies in every range: where an axis stays beyond it, its end next to zero is no range's,
    # and shows how the signal itself ends, as what shakes between two values does.
    near, far = (up, down) if values[0] > 0 else (down, up)
    own = _beyond(values[near], counts[near], noise)
    shakes = is_end(near, 0.0) or not is_end(far, own)
    return [] if shakes else [float(values[far][0])]


def _stays_at_an_extreme(column: F64) -> bool:
    """Whether an axis (M,) may be clipped at either of its extremes."""
    return any(_is_held(column == extreme) for extreme in (column.min(), column.max()))


def _is_held(at: Bool) -> bool:
    """Whether samples at an extreme (M,) are a plateau or come again; most extremes hold one."""
    return bool(at.sum() >= min(_PLATEAU, _AGAIN))


def _piled(at: Bool, values: F64, counts: Int, noise: float, own: float) -> bool:
    """Whether an extreme holds what should have spread beyond it.

    The peaks of a smooth motion lie within the last digit 2.4 times as often as within the one
    before (the density of a parabola); a clipped signal leaves at its extreme all that lies
    beyond. With Gaussian noise the density f of the readings is that of a mixture of Gaussians,
    and (log f)'' is nowhere below ``-1 / noise^2``: what the last two values hold says how many
    samples at least there should be one step further out, where there are none.

    Args:
        at: (M,) True for samples at the extreme.
        values: (K,) all values that occur, from the extreme on [m/s^2].
        counts: (K,) how many samples each holds.
        noise: standard deviation of the sensor's noise [m/s^2].
        own: how many there should be beyond where the signal itself ends as sharply.
    """
    if len(values) < 2 or (at[1:] > at[:-1]).sum() < _AGAIN:
        return False
    if len(values) > _VARIED and counts[0] > _PILED * counts[1 : 1 + _NEIGHBOURS].max():
        return True
    return counts[0] >= _BEYOND and _beyond(values, counts, noise) > _BEYOND + own


def _beyond(values: F64, counts: Int, noise: float) -> float:
    """How many samples at least Gaussian noise would have put one step beyond an extreme.

    Args:
        values: (K,) all values that occur, from the extreme on [m/s^2].
        counts: (K,) how many samples each holds.
        noise: standard deviation of the noise; 0 where it is not known [m/s^2].
    """
    if not noise:
        return 0.0
    step = (values[1] - values[0]) / noise
    return float(counts[0] ** 2 / counts[1] * np.exp(-(step**2)))


def _sharpness(column: F64) -> float:
    """One over the noise [s^2/m] that the readings (M,) of an axis have at most, by their density.

    Of Gaussian noise, alone or beside any motion, (log f)'' is nowhere below ``-1 / noise^2``. What
    shakes, as motors and fans do, looks like noise from sample to sample, but stays within edges.
    """
    values, counts = np.unique(column, return_counts=True)
    if len(values) < 3:
        return 0.0
    logs, few, step = np.log(counts), 1 / counts, np.diff(values)
    doubt = _SURELY * np.sqrt(few[:-2] + 4 * few[1:-1] + few[2:])
    bends = 2 * logs[1:-1] - logs[:-2] - logs[2:] - doubt
    digit = step.min()
    in_a_row = np.maximum(step[1:], step[:-1]) < 1.5 * digit
    return float(np.sqrt(bends[in_a_row].max(initial=0.0)) / digit)


def _longest(at: Bool) -> tuple[int, int]:
    """Begin and end of the longest stretch in which ``at`` (M,) holds."""
    edges = np.flatnonzero(np.diff(np.r_[0, at.astype(np.int8), 0])).reshape(-1, 2)
    begin, end = max(edges, key=lambda stretch: stretch[1] - stretch[0], default=(0, 0))
    return int(begin), int(end)


def _steep(column: F64, begin: int, end: int) -> bool:
    """Whether a stretch at an extreme is a cut-off peak.

    A peak that is as wide within one digit drops by four digits, half its width beyond either
    side; one that was cut off drops by far more.
    """
    half = (end - begin) // 2
    if begin - 1 - half < 0 or end + half >= len(column):
        return False
    sides = column[[begin - 1 - half, end + half]]
    return bool(np.abs(sides - column[begin]).min() > 2 * 4 * _digit(column))
