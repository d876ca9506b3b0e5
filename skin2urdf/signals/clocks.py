"""How far each SU's clock is off the joints', from the whole log: an offset and a drift.

Around any configuration the reading of an SU is linear in the positions and accelerations of the
joints. In a stretch of some seconds these span a small space, and the readings lie in it where they
are taken at the right time and nowhere else: what they leave beside it, as a function of the lag,
is a profile likelihood of the lag. Patterns have it narrow, with side lobes a period away, and the
beginnings and ends of motion have it wide without: one line over the log, an offset and a drift,
has to suit all stretches, which leaves no doubt where one of them alone would. Where all joints
move slowly and at once, their motion spans all that slow readings can be in such a time, at any
lag: a stretch counts by the values that its readings have beyond those that the motion takes.

What is found here is good to about a millisecond; the search for latencies around the poses
(:mod:`skin2urdf.signals.features`) goes on from there, and reaches no further than a quarter of a
pattern's period.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import ndtr, stdtrit

from skin2urdf.arrays import F64, Bool
from skin2urdf.recording.records import SuStream
from skin2urdf.signals.commotion import change, refined, searched, speeds
from skin2urdf.signals.motion import Motion
from skin2urdf.signals.records import SuClock

LARGEST_OFFSET = 2.0
"""Offset of a clock that is looked for [s]."""
LARGEST_DRIFT = 0.01
"""Drift of a clock that is looked for."""
_EVERY = 4
"""Grid samples to one of the search: 31 Hz, twice what patterns of 4 Hz have in their squares."""
_STRETCH = 8.0
"""Length of a stretch [s]: at the largest drift its ends are 80 ms apart, a sixth of the period of
a pattern of 2 Hz, and several patterns and rests lie in it."""
_COLUMNS = 40
"""Most dimensions of the joints' motion in a stretch that are kept, the largest."""
_MODEL = 0.02
"""Share of a stretch's energy that linear motion leaves at the right lag: second-order effects of
patterns by 0.15 rad. It bounds how much one stretch can say."""
_FELT = 0.05
"""Change of the readings in a stretch [m/s^2 rms] that is never taken for motion on its own."""
_EXPLAINED = 0.6
"""Share of a stretch's energy that motion must explain for its lag to count."""
_FEWEST = 3
"""Stretches, and values in them that are not the motion's own, from which a line is known."""
_LEAST_LEFT = 1e-3
"""Share of a stretch's energy that is left beside linear motion at the least."""
_PRIOR_FREEDOM = 4.0
"""Degrees of freedom for which the stretches' own variances count beside their scatter about the
line: few moves scatter little about any line, and slow ones over large angles share one error."""
MEDIAN_OF_SQUARES = 0.455
"""Median of the square of a standard normal variable."""
_SIGNIFICANT = 4.0
"""Standard deviations from which an offset or a drift is no chance."""
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
_VAGUE = 0.01
"""Deviation of a latency [s] from which it is worth another look."""
_SAMPLES = 8
"""Samples of a stream that may tell anything."""
_FEW = 16
"""Lags up to which products cost less than a Fourier transform."""


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Joint motion in some seconds: first sample and (L, r) orthonormal basis, the constant in."""

    begin: int
    basis: F64


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
    stretches = _stretches(motion)
    grid = motion.grid
    middle = grid.start + (grid.size - 1) / (2 * grid.rate)
    sus_heard = [su for su in sus if len(su.time) >= _SAMPLES]
    clocks = _clocks(sus_heard, motion, stretches, middle)
    vague = [u for u, clock in enumerate(clocks) if clock.latency_sd > _VAGUE]
    rough = _by_commotion([sus_heard[u] for u in vague], motion, middle)
    for u, clock in zip(vague, rough, strict=True):
        clocks[u] = min(clocks[u], clock, key=lambda c: c.latency_sd)
    groups = _groups([clock for clock in clocks if np.isfinite(clock.latency_sd)])
    off = [clock for group in groups for clock in group if _is_off(clock, motion)]
    if off and len(groups) == 1:
        quiet = [clock.su for clock in clocks if not np.isfinite(clock.latency_sd)]
        off += [replace(off[0], su=name, shared=True) for name in quiet]
    return tuple(sorted(off, key=lambda clock: clock.su))


def _clocks(
    sus: Sequence[SuStream], motion: Motion, stretches: Sequence[_Stretch], middle: float
) -> list[SuClock]:
    """The line of each SU; its deviation is infinite where no motion is felt."""
    clocks = [SuClock(su.name, 0.0, np.inf, 0.0, np.inf, middle) for su in sus]
    rate, span = motion.grid.rate / _EVERY, motion.grid.size / motion.grid.rate
    reach, steep, open_ = LARGEST_OFFSET, LARGEST_DRIFT, list(range(len(sus)))
    looked_at = stretches[::2] if len(stretches) >= 4 * _FEWEST else stretches
    for _ in range(_PASSES):
        means = [_means(sus[u], clocks[u], motion) for u in open_]
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
            if change >= _SETTLED or looked_at is not stretches:
                again.append(u)
        reach, steep, looked_at, open_ = _NEAR, 2 * _NEAR / span, stretches, again
        if not open_:
            break
    return clocks


def _by_commotion(sus: Sequence[SuStream], motion: Motion, middle: float) -> list[SuClock]:
    """The clock of each SU as how much it is moved when tells; infinite deviations where not."""
    rate = motion.grid.rate / _EVERY
    n = motion.grid.size // _EVERY
    q = motion.q[: n * _EVERY].reshape(n, _EVERY, -1).mean(axis=1)
    regressors = speeds(q[:, motion.moved], rate)
    return [_of_one(su, motion, regressors, middle) for su in sus]


def _of_one(su: SuStream, motion: Motion, regressors: F64, middle: float) -> SuClock:
    """The clock of one SU by its commotion."""
    nothing = SuClock(su.name, 0.0, np.inf, 0.0, np.inf, middle)
    integral, rate = _Integral.of(su), motion.grid.rate / _EVERY
    size = change(*integral.means(nothing, motion), rate)
    if size is None:
        return nothing
    found = searched(size, regressors, rate, LARGEST_OFFSET, LARGEST_DRIFT)
    if found is None:
        return nothing
    clock = replace(nothing, latency=found[0], drift=found[1])
    for _ in range(_PASSES):
        size = change(*integral.means(clock, motion), rate)
        step = None if size is None else refined(size, regressors, rate)
        if step is None:
            return nothing
        (late, fast), sds, freedom = step
        late_sd, fast_sd = map(float, sds * _by_few(freedom))
        clock = replace(
            clock, latency=clock.latency + float(late), latency_sd=late_sd,
            drift=clock.drift + float(fast), drift_sd=fast_sd,
        )  # fmt: skip
    far = abs(clock.latency - found[0]) > _NEAR or abs(clock.drift) > 1.1 * LARGEST_DRIFT
    return nothing if far else clock


def _by_few(freedom: float) -> float:
    """Factor that makes deviations with few degrees of freedom as significant as normal ones."""
    return float(stdtrit(freedom, float(ndtr(_SIGNIFICANT)))) / _SIGNIFICANT


def _is_off(clock: SuClock, motion: Motion) -> bool:
    """Whether a clock is off significantly, and by more than the poses' own search mends."""
    half = motion.grid.size / motion.grid.rate / 2
    late = abs(clock.latency) > max(_LEAST_OFFSET, _SIGNIFICANT * clock.latency_sd)
    least = max(_LEAST_BEND / half, _SIGNIFICANT * clock.drift_sd)
    return late or abs(clock.drift) > least


def _groups(clocks: Sequence[SuClock]) -> list[list[SuClock]]:
    """Clocks by what one publisher may run, each with what its group says together.

    SUs on one bus have one clock, and those that motion turns by little show it badly.
    """
    groups: list[list[SuClock]] = []
    for clock in sorted(clocks, key=lambda c: c.latency_sd):
        mine = next((group for group in groups if _agree(clock, group[0])), None)
        if mine is None:
            groups.append([clock])
        else:
            mine.append(clock)
    return [_together(group) for group in groups]


def _agree(a: SuClock, b: SuClock) -> bool:
    """Whether chance may make two clocks as different as they are."""
    late = abs(a.latency - b.latency) <= _SIGNIFICANT * float(np.hypot(a.latency_sd, b.latency_sd))
    fast = abs(a.drift - b.drift) <= _SIGNIFICANT * float(np.hypot(a.drift_sd, b.drift_sd))
    return late and fast


def _together(group: Sequence[SuClock]) -> list[SuClock]:
    """The clocks of a group, each with the weighted mean of all."""

    def mean(values: F64, sds: F64) -> tuple[float, float]:
        # The SUs' errors come from the same motion, so that many are not better than the best.
        weight = 1 / sds**2
        return float(weight @ values / weight.sum()), float(sds.min())

    latency, latency_sd = mean(*np.array([(c.latency, c.latency_sd) for c in group]).T)
    drift, drift_sd = mean(*np.array([(c.drift, c.drift_sd) for c in group]).T)
    return [
        replace(c, latency=latency, latency_sd=latency_sd, drift=drift, drift_sd=drift_sd)
        for c in group
    ]


def _stretches(motion: Motion) -> list[_Stretch]:
    """Stretches of the log in which joints move and are recorded throughout."""
    rate = motion.grid.rate / _EVERY
    n = motion.grid.size // _EVERY
    shape = (n, _EVERY, -1)
    q = motion.q[: n * _EVERY].reshape(shape).mean(axis=1)
    qdd = motion.qdd[: n * _EVERY].reshape(shape).mean(axis=1)
    valid = np.asarray(motion.valid[: n * _EVERY].reshape(n, _EVERY).all(axis=1))
    length = int(_STRETCH * rate)
    still = motion.creep
    out = []
    for begin in range(0, n - length + 1, length // 2):
        part = slice(begin, begin + length)
        active = np.ptp(q[part], axis=0) > still
        if not active.any() or not bool(valid[part].all()):
            continue
        columns = np.concatenate([q[part][:, active], qdd[part][:, active]], axis=1)
        columns = columns - columns.mean(axis=0)
        size = np.sqrt((columns**2).sum(axis=0))
        columns = columns[:, size > 0] / size[size > 0]
        left, values, _ = np.linalg.svd(columns, full_matrices=False)
        kept = left[:, (values > 1e-2 * values[0])][:, :_COLUMNS]
        constant = np.full((length, 1), 1 / np.sqrt(length))
        out.append(_Stretch(begin, np.concatenate([constant, kept], axis=1)))
    return out


@dataclass(frozen=True, eq=False)
class _Integral:
    """The integral of a stream, linear between samples, on its own clock.

    Attributes:
        time: (M,) times [s].
        area: (M, 3) integral from the first [m/s].
        gaps: (G, 2) begin and end of what is missing [s].
    """

    time: F64
    area: F64
    gaps: F64

    @classmethod
    def of(cls, su: SuStream) -> _Integral:
        """The integral of an SU's readings, spikes cut down to what motion may be."""
        some = su.specific_force[:: len(su.time) // 4096 + 1]
        middle = np.median(some, axis=0)
        bound = 6 * np.median(np.abs(some - middle), axis=0) + 15.0
        values = np.clip(su.specific_force, middle - bound, middle + bound)
        steps = np.diff(su.time)
        area = np.zeros_like(values)
        np.cumsum(0.5 * (values[1:] + values[:-1]) * steps[:, None], axis=0, out=area[1:])
        torn = steps > max(0.1, 6 * float(np.median(steps)))
        return cls(su.time, area, np.stack([su.time[:-1][torn], su.time[1:][torn]], axis=1))

    def means(self, clock: SuClock, motion: Motion) -> tuple[F64, Bool]:
        """(n, 3) means over the bins of the search, and (n,) where the stream is whole."""
        n, width = motion.grid.size // _EVERY, _EVERY / motion.grid.rate
        first = motion.grid.start - 0.5 / motion.grid.rate
        edges = clock.stamped(np.asarray(first + width * np.arange(n + 1)))
        at = np.stack([np.interp(edges, self.time, column) for column in self.area.T], axis=1)
        valid = (edges[:-1] >= self.time[0]) & (edges[1:] <= self.time[-1])
        for begin, end in self.gaps:
            valid &= (edges[1:] < begin) | (edges[:-1] > end)
        return np.diff(at, axis=0) / np.diff(edges)[:, None], valid


def _means(su: SuStream, clock: SuClock, motion: Motion) -> tuple[F64, Bool]:
    """See :meth:`_Integral.means`; integrals are as large as streams, and are not kept."""
    means = _Integral.of(su).means(clock, motion)
    su.put_away()
    return means


def _lines(
    readings: F64,
    valid: Bool,
    stretches: Sequence[_Stretch],
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
    times, curves, counts, freedoms = [], [], [], []
    most = int(np.ceil((reach + steep * n / (2 * rate)) * rate)) + 2
    holes = np.cumsum(np.concatenate([np.zeros((1, U)), ~valid]), axis=0)
    for stretch in stretches:
        length = len(stretch.basis)
        lo, hi = stretch.begin - most, stretch.begin + length + most
        a, b = max(lo, 0), min(hi, n)
        if b - a < length + min(8, 2 * most):
            continue
        segment = readings[a:b] - readings[a:b].mean(axis=0)
        left, counted, beyond = _left(segment, stretch.basis)
        # Beyond the log nothing is known: lags that reach there count as the worst.
        curve = np.repeat(left.max(axis=0)[None], 2 * most + 1, axis=0)
        curve[a - lo : a - lo + len(left)] = left
        times.append((stretch.begin + length / 2 - n / 2) / rate)
        curves.append(curve)
        counts.append(counted & (holes[b] == holes[a]))
        freedoms.append(beyond)
    if not times:
        return [None] * U
    time, scores, counted = np.array(times), -np.array(curves), np.array(counts)
    free = np.array(freedoms)
    lags = np.arange(-most, most + 1) / rate
    out: list[_Line | None] = []
    for u in range(U):
        use = counted[:, u]
        if use.sum() < _FEWEST or free[use, u].sum() < _FEWEST:
            out.append(None)
            continue
        score = scores[use, :, u]
        offset, drift = _best(time[use], score, lags, reach, steep, n / rate)
        line = _refined(time[use], score, lags, offset, drift)
        out.append(line if line is None else line.wider(_by_few(float(free[use, u].sum()))))
    return out


def _left(segment: F64, basis: F64) -> tuple[F64, Bool, F64]:
    """What motion leaves of the readings at every lag, as half the logarithm of its share.

    Args:
        segment: (m, U, 3) readings, longer than the stretch by the lags.
        basis: (L, r) orthonormal, the constant first.

    Returns:
        (m - L + 1, U) what is left, (U,) True where motion is felt and explains most at some lag,
        and (U,) how many independent values there are beyond those that motion takes for itself.
    """
    length, m = len(basis), len(segment)
    flat = segment.reshape(m, -1)
    count = m - length + 1
    if count <= _FEW:
        product = np.array([flat[k : k + length].T @ basis for k in range(count)])
    else:
        size = next_fast_len(m, real=True)
        spectrum = rfft(flat, size, axis=0)
        shape = np.conj(rfft(basis, size, axis=0))
        product = np.empty((count, flat.shape[1], basis.shape[1]))
        for k in range(flat.shape[1]):
            product[:, k] = irfft(spectrum[:, k, None] * shape, size, axis=0)[:count]
    inside = (product**2).reshape(count, -1, 3, basis.shape[1]).sum(axis=2)
    squares = np.cumsum((segment**2).sum(axis=2), axis=0)
    squares = np.concatenate([np.zeros((1, squares.shape[1])), squares])
    total = squares[length:] - squares[:-length]
    centred = np.maximum(total - inside[..., 0], 1e-12)
    rest = np.maximum(total - inside.sum(axis=2), 0.0)
    level = centred.mean(axis=0)
    felt = level >= length * _FELT**2
    explained = (rest / centred).min(axis=0) <= 1 - _EXPLAINED
    # Independent values of three axes in the stretch, as fast as the readings change.
    steps = (np.diff(segment, axis=0) ** 2).sum(axis=(0, 2))
    values = 3 * length / np.pi * np.sqrt(steps / np.maximum(squares[-1], 1e-12))
    free = np.maximum(values - 3 * (basis.shape[1] - 1), 0.0)
    # Of what is felt at each lag: one that leads to a rest leaves little, and explains nothing.
    return 0.5 * np.log(rest / centred + _MODEL), felt & explained, free


def _best(
    time: F64, score: F64, lags: F64, reach: float, steep: float, span: float
) -> tuple[float, float]:
    """Offset and drift with the largest sum of scores (W, K), on a grid of lags."""
    step = lags[1] - lags[0]
    # Half a sample at the ends of the log from one drift to the next.
    count = int(np.ceil(steep * span / 2 / step))
    best, found = -np.inf, (0.0, 0.0)
    inner = np.flatnonzero(np.abs(lags) <= reach)
    rows = np.arange(len(time))[:, None]
    for k in range(-count, count + 1):
        drift = steep * k / max(count, 1)
        shift = np.rint(drift * time / step).astype(int)
        index = np.clip(inner[None] + shift[:, None], 0, len(lags) - 1)
        total = score[rows, index].sum(axis=0)
        i = int(total.argmax())
        if total[i] > best:
            best, found = float(total[i]), (float(lags[inner[i]]), drift)
    return found


def _refined(time: F64, score: F64, lags: F64, offset: float, drift: float) -> _Line | None:
    """A line through the peaks of the stretches near a line, by robust weighted least squares.

    What is left in a stretch rises with the square of the lag's error; how fast tells the width of
    the readings' spectrum, and with it how many independent values three axes have in a stretch.
    What is left at the best lag, over both, is the variance of the peak.
    """
    step = lags[1] - lags[0]
    near = np.rint((offset + drift * time - lags[0]) / step).astype(int)
    peaks, weights, rows = [], [], []
    for w, k in enumerate(near):
        a, b = max(k - 2, 1), min(k + 3, len(lags) - 1)
        if b <= a:
            continue
        i = a + int(score[w, a:b].argmax())
        # What motion leaves grows with the square of the error, its logarithm does not.
        before, here, after = np.exp(-2 * score[w, i - 1 : i + 2])
        bend = before + after - 2 * here
        if i in (a, b - 1) or bend <= 0:
            continue
        rise = bend / (2 * step**2)
        values = max(1.0, 6 * _STRETCH * np.sqrt(rise) / (2 * np.pi))
        peaks.append(lags[i] + 0.5 * step * (before - after) / bend)
        weights.append(values * rise / (here - _MODEL + _LEAST_LEFT))
        rows.append(w)
    if len(rows) < _FEWEST:
        return None
    x, y, certain = time[rows], np.array(peaks), np.array(weights)
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
    if abs(solution[0]) > 1.1 * LARGEST_OFFSET or abs(solution[1]) > 1.1 * LARGEST_DRIFT:
        return None
    return _Line(float(solution[0]), float(solution[1]), float(sd[0]), float(sd[1]), len(y))
