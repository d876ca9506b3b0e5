"""How far each SU's clock is off the joints', from the whole log: an offset and a drift.

In stretches of some seconds, what the joints' motion leaves of the readings tells at which lag they
were taken (:mod:`skin2urdf.signals.stretches`). Patterns have that profile narrow, with side lobes
a period away, and the beginnings and ends of motion have it wide without: one line over the log, an
offset and a drift, has to suit all stretches, which leaves no doubt where one of them alone would.
Where all joints move slowly and at once, their motion spans all that slow readings can be in such a
time, at any lag: a stretch counts by the values that its readings have beyond those that the motion
takes.

What is found here is good to about a millisecond; the search for latencies around the poses
(:mod:`skin2urdf.signals.features`) goes on from there, and reaches no further than a quarter of a
pattern's period.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.special import chdtrc, ndtr, stdtrit

from skin2urdf.arrays import F64, Bool
from skin2urdf.recording.records import SuStream
from skin2urdf.signals import commotion, expansion, one_joint
from skin2urdf.signals.commotion import change, speeds
from skin2urdf.signals.expansion import Expansion
from skin2urdf.signals.motion import Motion
from skin2urdf.signals.records import SuClock
from skin2urdf.signals.stretches import (
    EVERY,
    FEWEST,
    MODEL,
    SAMPLES,
    SIGNIFICANT,
    STRETCH,
    Heard,
    Integral,
    Stretch,
    best_lines,
    binned,
    rests_between,
    stretches,
)
from skin2urdf.threads import each

LARGEST_OFFSET = 2.0
"""Offset of a clock that is looked for [s]."""
LARGEST_DRIFT = 0.01
"""Drift of a clock that is looked for."""
_LEAST_LEFT = 1e-3
"""Share of a stretch's energy that is left beside linear motion at the least."""
_PRIOR_FREEDOM = 4.0
"""Degrees of freedom for which the stretches' own variances count beside their scatter about the
line: few moves scatter little about any line, and slow ones over large angles share one error."""
MEDIAN_OF_SQUARES = 0.455
"""Median of the square of a standard normal variable."""
_ONE_CLOCK = 0.01
"""Probability that SUs on one clock show clocks as different as they do, below which each has its
own: to take one for several costs no more than their mean's deviation, and the other way round what
clocks differ by."""
_LEAST_OFFSET = 5e-3
"""Offset [s] below which the search around the poses finds it as well, and better."""
_LEAST_BEND = 5e-4
"""What a drift must make of the lag between the middle and an end of the log to count [s]."""
_PASSES = 6
"""Times the streams are set to what was found and looked at again."""
_NEAR = 0.05
"""What is left of lags after the first pass, at most [s]."""
_SETTLED = 2e-4
"""Change of lags from one pass to the next that is none [s]."""
_TOGETHER = 1 << 21
"""Samples of SUs that are looked at together, whose integrals take 64 MB."""
_VAGUE = 0.01
"""Deviation of a latency [s] from which it is worth another look."""


@dataclass(frozen=True, eq=False)
class _Line:
    """Lag against time: offset in the middle and drift, with deviations and evidence."""

    offset: float
    drift: float
    offset_sd: float
    drift_sd: float
    stretches: int

    def wider(self, factor: float) -> _Line:
        """The line with larger deviations."""
        return replace(self, offset_sd=factor * self.offset_sd, drift_sd=factor * self.drift_sd)


def su_clocks(sus: Sequence[SuStream], motion: Motion) -> tuple[SuClock, ...]:
    """Find the clocks of a log that are off by more than the search around the poses can mend.

    Args:
        sus: the streams, on their own clocks.
        motion: joint motion of the log.

    Returns:
        One record for each SU whose clock is off significantly, none for the others.
    """
    found, rests = stretches(motion), rests_between(motion)
    grid = motion.grid
    middle = grid.start + (grid.size - 1) / (2 * grid.rate)
    sus_heard = [su for su in sus if len(su.time) >= SAMPLES]
    clocks: list[SuClock] = []
    for part in each(
        lambda some: _clocks(some, motion, found, rests, middle),
        _in_parts(sus_heard),
        len(sus_heard),
    ):
        clocks += part
    vague = [u for u, clock in enumerate(clocks) if clock.latency_sd > _VAGUE]
    rough = _by_the_whole_log([sus_heard[u] for u in vague], motion, middle)
    for u, others in zip(vague, rough, strict=True):
        clocks[u] = min(clocks[u], *others, key=lambda c: c.latency_sd)
    known = [clock for clock in clocks if np.isfinite(clock.latency_sd)]
    told = _on_one_clock(known)
    off = [clock for clock in told if is_off(clock, motion)]
    if off and len({clock.latency for clock in told}) == 1:
        quiet = [clock.su for clock in clocks if not np.isfinite(clock.latency_sd)]
        off += [replace(off[0], su=name, shared=True) for name in quiet]
    return tuple(sorted(off, key=lambda clock: clock.su))


def _in_parts(sus: Sequence[SuStream]) -> Iterator[list[SuStream]]:
    """SUs by as many as are looked at together."""
    part: list[SuStream] = []
    samples = 0
    for su in sus:
        part.append(su)
        samples += len(su.time)
        if samples >= _TOGETHER:
            yield part
            part, samples = [], 0
    if part:
        yield part


def _clocks(
    sus: Sequence[SuStream],
    motion: Motion,
    stretches: Sequence[Stretch],
    rests: Sequence[Stretch],
    middle: float,
) -> list[SuClock]:
    """The line of each SU; its deviation is infinite where no motion is felt.

    Where lines far apart are told from each other, each rest counts as a stretch of its own: one
    pattern after the other, of as many seconds each, looks right a pattern later as well.
    """
    clocks = [SuClock(su.name, 0.0, np.inf, 0.0, np.inf, middle) for su in sus]
    rate, span = motion.grid.rate / EVERY, motion.grid.size / motion.grid.rate
    reach, steep, open_ = LARGEST_OFFSET, LARGEST_DRIFT, list(range(len(sus)))
    some = stretches[::2] if len(stretches) >= 4 * FEWEST else stretches
    looked_at = [*some, *rests]
    integrals = []
    for su in sus:
        integrals.append(Integral.of(su))
        su.put_away()
    for _ in range(_PASSES):
        means = [integrals[u].means(clocks[u], motion) for u in open_]
        readings = np.stack([values for values, _ in means], axis=1)
        valid = np.stack([whole for _, whole in means], axis=1)
        again = []
        for u, line in zip(
            open_, _lines(readings, valid, looked_at, rate, reach, steep), strict=True
        ):
            if line is None:
                continue
            clocks[u] = replace(
                clocks[u],
                latency=clocks[u].latency + line.offset,
                latency_sd=line.offset_sd,
                drift=(1 + clocks[u].drift) * (1 + line.drift) - 1,
                drift_sd=line.drift_sd,
            )
            change = abs(line.offset) + abs(line.drift) * span / 2
            if change >= _SETTLED or reach == LARGEST_OFFSET:
                again.append(u)
        reach, steep, looked_at, open_ = _NEAR, 2 * _NEAR / span, list(stretches), again
        if not open_:
            break
    return clocks


def _by_the_whole_log(
    sus: Sequence[SuStream], motion: Motion, middle: float
) -> Iterator[list[SuClock]]:
    """The clocks of each SU as its commotion and an expansion tell; infinite deviations where not.

    Commotion tells more of moves that begin and end, an expansion of motion that goes on and on,
    and one joint by itself of SUs that no other moves.
    """
    if not sus:
        return
    rate = motion.grid.rate / EVERY
    q = binned(motion.q)[:, motion.moved]
    of_all = (_Commotion(speeds(q, rate), rate), _Expanded(Expansion(q, rate), rate))
    alone = [Expansion(column[:, None], rate) for column in q.T]

    def looked_at(su: SuStream) -> list[SuClock]:
        integral = Integral.of(su)
        su.put_away()
        nothing = SuClock(su.name, 0.0, np.inf, 0.0, np.inf, middle)
        found = [_by_one_way(integral, nothing, motion, way) for way in of_all]
        if not any(np.isfinite(clock.latency_sd) for clock in found):
            found.append(_by_one_way(integral, nothing, motion, _Alone(alone, rate)))
        return found

    yield from each(looked_at, sus, len(sus))


class _Way(Protocol):
    """A way to find a clock from the means of an SU's readings (n, 3) and where they are whole."""

    def search(self, means: F64, valid: Bool) -> tuple[float, float] | None:
        """Offset [s] and drift, None where none stands out."""

    def refine(self, means: F64, valid: Bool) -> tuple[F64, F64, int] | None:
        """Change of both, their deviations, and the degrees of freedom of those."""


@dataclass(frozen=True, eq=False)
class _Commotion:
    """See :mod:`skin2urdf.signals.commotion`."""

    regressors: F64
    rate: float

    def search(self, means: F64, valid: Bool) -> tuple[float, float] | None:
        size = change(means, valid, self.rate)
        if size is None:
            return None
        return commotion.searched(size, self.regressors, self.rate, LARGEST_OFFSET, LARGEST_DRIFT)

    def refine(self, means: F64, valid: Bool) -> tuple[F64, F64, int] | None:
        size = change(means, valid, self.rate)
        return None if size is None else commotion.refined(size, self.regressors, self.rate)


@dataclass(frozen=True, eq=False)
class _Expanded:
    """See :mod:`skin2urdf.signals.expansion`."""

    expansion: Expansion
    rate: float

    def search(self, means: F64, valid: Bool) -> tuple[float, float] | None:
        if change(means, valid, self.rate) is None:
            return None
        return expansion.searched(
            means, valid, self.expansion, self.rate, LARGEST_OFFSET, LARGEST_DRIFT
        )

    def refine(self, means: F64, valid: Bool) -> tuple[F64, F64, int] | None:
        return expansion.refined(means, valid, self.expansion, self.rate)


@dataclass
class _Alone:
    """See :mod:`skin2urdf.signals.one_joint`; the joint that was found is the one to refine by."""

    expansions: Sequence[Expansion]
    rate: float
    joint: Expansion | None = None

    def search(self, means: F64, valid: Bool) -> tuple[float, float] | None:
        found = one_joint.searched(
            means, valid, self.expansions, self.rate, LARGEST_OFFSET, LARGEST_DRIFT
        )
        if found is None:
            return None
        self.joint, offset, drift = found
        return offset, drift

    def refine(self, means: F64, valid: Bool) -> tuple[F64, F64, int] | None:
        if self.joint is None:
            return None
        return expansion.refined(means, valid, self.joint, self.rate)


def _by_one_way(integral: Integral, nothing: SuClock, motion: Motion, way: _Way) -> SuClock:
    """The clock of one SU in one way."""
    found = way.search(*integral.means(nothing, motion))
    if found is None:
        return nothing
    clock = replace(nothing, latency=found[0], drift=found[1])
    for _ in range(_PASSES):
        step = way.refine(*integral.means(clock, motion))
        if step is None:
            return nothing
        (late, fast), sds, freedom = step
        late_sd, fast_sd = map(float, sds * _by_few(freedom))
        clock = replace(
            clock, latency=clock.latency + float(late), latency_sd=late_sd,
            drift=clock.drift + float(fast), drift_sd=fast_sd,
        )  # fmt: skip
        if abs(late) < _SETTLED:
            break
    far = abs(clock.latency - found[0]) > max(_NEAR, SIGNIFICANT * clock.latency_sd)
    return nothing if far or abs(clock.drift) > 1.1 * LARGEST_DRIFT else clock


def _by_few(freedom: float) -> float:
    """Factor that makes deviations with few degrees of freedom as significant as normal ones."""
    return float(stdtrit(freedom, float(ndtr(SIGNIFICANT)))) / SIGNIFICANT


def is_off(clock: SuClock, motion: Motion) -> bool:
    """Whether a clock is off significantly, and by more than the poses' own search mends."""
    half = motion.grid.size / motion.grid.rate / 2
    late = abs(clock.latency) > max(_LEAST_OFFSET, SIGNIFICANT * clock.latency_sd)
    # A drift tells nothing of a clock whose offset may be anything.
    at_the_ends = float(np.hypot(half * clock.drift_sd, clock.latency_sd))
    return late or abs(clock.drift) * half > max(_LEAST_BEND, SIGNIFICANT * at_the_ends)


def widening_by_few_moves(motion: Motion) -> float:
    """Factor on deviations of clocks that were fitted to a log; infinite where nothing confirms.

    What two moves show of a line of two numbers nothing confirms: whatever else holds a link back
    behind its encoder, by other amounts in each, fits as well. Every stretch of motion beyond tells
    how much that is; neighbouring ones share half their samples.
    """
    freedom = sum(not stretch.rests for stretch in stretches(motion)) / 2 - 2
    return _by_few(freedom) if freedom > 0 else np.inf


def _on_one_clock(clocks: Sequence[SuClock]) -> list[SuClock]:
    """Clocks with what they say together, where one may run all of them; else as they are.

    SUs on one bus have one clock, and those that motion turns by little show it badly. Where some
    have clocks of their own, nothing tells whose clock such an SU has.
    """
    if not clocks:
        return []
    together = _together(clocks)
    apart = np.array(
        [
            ((c.latency - m.latency) / c.latency_sd, (c.drift - m.drift) / c.drift_sd)
            for c, m in zip(clocks, together, strict=True)
        ]
    ).ravel()
    freedom = max(len(apart) - 2, 1)
    one = np.abs(apart).max(initial=0.0) <= SIGNIFICANT
    return together if one and chdtrc(freedom, float(apart @ apart)) > _ONE_CLOCK else list(clocks)


def _together(clocks: Sequence[SuClock]) -> list[SuClock]:
    """Clocks, each with the weighted mean of all."""

    def mean(values: F64, sds: F64) -> tuple[float, float]:
        # The SUs' errors come from the same motion, so that many are not better than the best.
        weight = 1 / sds**2
        return float(weight @ values / weight.sum()), float(sds.min())

    latency, latency_sd = mean(*np.array([(c.latency, c.latency_sd) for c in clocks]).T)
    drift, drift_sd = mean(*np.array([(c.drift, c.drift_sd) for c in clocks]).T)
    return [
        replace(c, latency=latency, latency_sd=latency_sd, drift=drift, drift_sd=drift_sd)
        for c in clocks
    ]


def _lines(
    readings: F64,
    valid: Bool,
    stretches: Sequence[Stretch],
    rate: float,
    reach: float,
    steep: float,
) -> list[_Line | None]:
    """For each SU the line of lags that suits all stretches best, None where there is none.

    Args:
        readings: (n, U, 3) means [m/s^2].
        valid: (n, U) where they are whole.
        stretches: joint motion.
        rate: samples per second [Hz].
        reach: largest offset [s].
        steep: largest drift.
    """
    n, U = valid.shape
    times, shares, sizes, counts, felt, freedoms, values = [], [], [], [], [], [], []
    most = int(np.ceil((reach + steep * n / (2 * rate)) * rate)) + 2
    holes = np.cumsum(np.concatenate([np.zeros((1, U)), ~valid]), axis=0)
    for stretch in stretches:
        length = len(stretch.basis)
        lo, hi = stretch.begin - most, stretch.begin + length + most
        a, b = max(lo, 0), min(hi, n)
        if b - a < length + min(8, 2 * most):
            continue
        # Beyond the log nothing is known, and a rest there tells nothing.
        if stretch.rests and b - a < hi - lo:
            continue
        heard = Heard(readings[a:b], length)
        inside = heard.inside(stretch.basis)
        left = heard.judged(inside.sum(axis=2), inside[..., 0])
        whole = holes[b] == holes[a]
        times.append((stretch.begin + length / 2 - n / 2) / rate)
        shares.append(_padded(left.share, a - lo, most))
        sizes.append(_padded(left.size, a - lo, most))
        counts.append(left.felt & left.explained & whole)
        felt.append(left.felt & whole & (left.explained | stretch.rests))
        freedoms.append(heard.free(stretch.basis.shape[1]))
        values.append(heard.values())
    if not times:
        return [None] * U
    time, counted, free = map(np.array, (times, counts, freedoms))
    lags = np.arange(-most, most + 1) / rate
    told = (counted.sum(axis=0) >= FEWEST) & ((free * counted).sum(axis=0) >= FEWEST)
    sized = -np.array(sizes) * np.array(felt)[:, None]
    best, lead = best_lines(time, sized, lags, reach, steep, n / rate)
    # Chance changes half the logarithm of what is left of n values by the root of 1 / 2 n.
    chance = np.sqrt((np.array(felt) / (2 * np.array(values))).sum(axis=0))
    scores = -np.array(shares)
    out: list[_Line | None] = [None] * U
    for u in np.flatnonzero(told & (lead > SIGNIFICANT * chance)).tolist():
        use = counted[:, u]
        line = _refined(time[use], scores[use, :, u], lags, *best[u])
        out[u] = line if line is None else line.wider(_by_few(float(free[use, u].sum())))
    return out


def _padded(left: F64, first: int, most: int) -> F64:
    """(2 most + 1, U) what is left at all lags, of lags from the first that is known on.

    Beyond the log nothing is known: lags that reach there count as the worst.
    """
    curve = np.repeat(left.max(axis=0)[None], 2 * most + 1, axis=0)
    curve[first : first + len(left)] = left
    return curve


def _refined(time: F64, score: F64, lags: F64, offset: float, drift: float) -> _Line | None:
    """A line through the peaks of the stretches near a line, by robust weighted least squares.

    What is left in a stretch rises with the square of the lag's error; how fast tells the width of
    the readings' spectrum, and with it how many independent values three axes have in a stretch.
    What is left at the best lag, over both, is the variance of the peak.
    """
    step = lags[1] - lags[0]
    near = np.rint((offset + drift * time - lags[0]) / step).astype(int)
    first, last = np.maximum(near - 2, 1), np.minimum(near + 2, len(lags) - 2)
    index = near[:, None] + np.arange(-2, 3)
    inside = (index >= first[:, None]) & (index <= last[:, None])
    rows = np.arange(len(time))
    around = score[rows[:, None], np.clip(index, 0, len(lags) - 1)]
    i = near - 2 + np.where(inside, around, -np.inf).argmax(axis=1)
    rows = np.flatnonzero((first < i) & (i < last))
    i = i[rows]
    # What motion leaves grows with the square of the error, its logarithm does not.
    before, here, after = (np.exp(-2 * score[rows, i + k]) for k in (-1, 0, 1))
    bend = before + after - 2 * here
    peaked = bend > 0
    rows, i = rows[peaked], i[peaked]
    before, here, after, bend = before[peaked], here[peaked], after[peaked], bend[peaked]
    if len(rows) < FEWEST:
        return None
    rise = bend / (2 * step**2)
    values = np.maximum(1.0, 6 * STRETCH * np.sqrt(rise) / (2 * np.pi))
    x, y = time[rows], lags[i] + 0.5 * step * (before - after) / bend
    certain = values * rise / (here - MODEL + _LEAST_LEFT)
    X = np.stack([np.ones_like(x), x], axis=1)
    solution = np.array([offset, drift])
    # Neighbouring stretches share half their samples.
    freedom = max(len(y) / 2 - 2, 0.0)
    for _ in range(10):
        square = certain * (y - X @ solution) ** 2
        bound = max(4 * float(np.median(square)) / MEDIAN_OF_SQUARES, 1e-4)
        weight = certain / (1 + square / bound) ** 2
        products = X.T @ (weight[:, None] * X)
        if np.linalg.cond(products) > 1e12:
            return None
        solution = np.linalg.solve(products, X.T @ (weight * y))
    square = weight * (y - X @ solution) ** 2
    scale = (_PRIOR_FREEDOM + float(square.mean()) * freedom) / (_PRIOR_FREEDOM + freedom)
    sd = np.sqrt(2 * scale * np.diag(np.linalg.inv(products)))
    # Stretches of one pattern leave the same beside linear motion, which no number of them tells
    # from an offset.
    alike = float(weight @ certain**-0.5 / weight.sum())
    if abs(solution[0]) > 1.1 * LARGEST_OFFSET or abs(solution[1]) > 1.1 * LARGEST_DRIFT:
        return None
    offset_sd = float(np.hypot(sd[0], alike))
    return _Line(float(solution[0]), float(solution[1]), offset_sd, float(sd[1]), len(y))
