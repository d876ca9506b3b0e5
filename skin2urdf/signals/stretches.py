"""Stretches of some seconds in which readings are linear in the joints' motion, at the right lag.

Around any configuration the reading of an SU is linear in the positions and accelerations of the
joints. In a stretch of some seconds these span a small space, and the readings lie in it where they
are taken at the right time and nowhere else: what they leave beside it, as a function of the lag,
is a profile likelihood of the lag. One line over the log, an offset and a drift, has to suit all
stretches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from skin2urdf.arrays import F64, Bool
from skin2urdf.recording.records import SuStream
from skin2urdf.signals.motion import Motion
from skin2urdf.signals.poses import find_rests, stop_blur
from skin2urdf.signals.profiles import valley
from skin2urdf.signals.records import SuClock

EVERY = 4
"""Grid samples to one of the search: 31 Hz, twice what patterns of 4 Hz have in their squares."""
STRETCH = 8.0
"""Length of a stretch [s]: at the largest drift its ends are 80 ms apart, a sixth of the period of
a pattern of 2 Hz, and several patterns and rests lie in it."""
MODEL = 0.02
"""Share of a stretch's energy that linear motion leaves at the right lag: second-order effects of
patterns by 0.15 rad. It bounds how much one stretch can say."""
FEWEST = 3
"""Stretches, and values in them that are not the motion's own, from which a line is known."""
SIGNIFICANT = 4.0
"""Standard deviations from which an offset or a drift is no chance."""
SAMPLES = 8
"""Samples of a stream that may tell anything."""
_COLUMNS = 40
"""Most dimensions of the joints' motion in a stretch that are kept, the largest."""
_FELT = 0.05
"""Change of the readings in a stretch [m/s^2 rms] that is never taken for motion on its own."""
_EXPLAINED = 0.6
"""Share of a stretch's energy that motion must explain for its lag to count."""
_FEW = 16
"""Lags up to which products cost less than a Fourier transform."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """Joint motion in some seconds: first sample and (L, r) orthonormal basis, the constant in.

    That of joints that rest is the constant alone.
    """

    begin: int
    basis: F64

    @property
    def rests(self) -> bool:
        """Whether all joints rest."""
        return bool(self.basis.shape[1] == 1)


def binned(values: F64) -> F64:
    """(n, C) means of (N, C) grid samples over the bins of the search."""
    n = len(values) // EVERY
    return np.asarray(values[: n * EVERY].reshape(n, EVERY, -1).mean(axis=1))


def whole_bins(valid: Bool) -> Bool:
    """(n,) bins of the search in which all of (N,) grid samples are valid."""
    n = len(valid) // EVERY
    return np.asarray(valid[: n * EVERY].reshape(n, EVERY).all(axis=1))


def stretches(motion: Motion) -> list[Stretch]:
    """Stretches of the log in which joints are recorded throughout, whether they move or rest."""
    q, qdd, valid = binned(motion.q), binned(motion.qdd), whole_bins(motion.valid)
    still = motion.creep
    out = []
    for part in windows(len(q), motion):
        active = np.ptp(q[part], axis=0) > still
        if not bool(valid[part].all()):
            continue
        columns = np.hstack([q[part][:, active], qdd[part][:, active]])
        out.append(Stretch(part.start, spanned(columns)))
    return out


def rests_between(motion: Motion) -> list[Stretch]:
    """What is left of each rest once half a bin more than its edges' blur is taken off both ends.

    Windows of some seconds hold rests and motion, and what is not linear in that hides that an SU
    turns in a rest, which no lag but a wrong one makes it do.
    """
    margin = stop_blur(motion.grid.rate) // EVERY + 1
    out = []
    for rest in find_rests(motion):
        begin, end = -(-rest.begin // EVERY) + margin, rest.end // EVERY - margin
        if end - begin >= FEWEST:
            out.append(Stretch(begin, np.full((end - begin, 1), (end - begin) ** -0.5)))
    return out


def windows(n: int, motion: Motion) -> list[slice]:
    """Where stretches lie among n bins; neighbours share half their samples."""
    length = int(STRETCH * motion.grid.rate / EVERY)
    return [slice(b, b + length) for b in range(0, n - length + 1, length // 2)]


def spanned(columns: F64) -> F64:
    """(L, r) orthonormal basis of a constant, its first, and what (L, C) columns span beside."""
    length = len(columns)
    columns = columns - columns.mean(axis=0)
    size = np.sqrt((columns**2).sum(axis=0))
    columns = columns[:, size > 0] / size[size > 0]
    constant = np.full((length, 1), 1 / np.sqrt(length))
    if not columns.shape[1]:
        return constant
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    kept = left[:, (values > 1e-2 * values[0])][:, :_COLUMNS]
    return np.concatenate([constant, kept], axis=1)


class Heard:
    """Readings of U SUs in and around a stretch, to be held against its motion at every lag.

    Args:
        segment: (m, U, 3) readings, longer than the stretch by K - 1 lags.
        length: samples of the stretch.

    Attributes:
        segment: (m, U, 3) readings less their mean.
        total: (K, U) sum of their squares at every lag.
    """

    def __init__(self, segment: F64, length: int) -> None:
        self.segment = segment - segment.mean(axis=0)
        self._length, self._count = length, len(segment) - length + 1
        squares = np.cumsum((self.segment**2).sum(axis=2), axis=0)
        self._energy = squares[-1]
        squares = np.concatenate([np.zeros((1, squares.shape[1])), squares])
        self.total = squares[length:] - squares[:-length]
        flat = self.segment.reshape(len(segment), -1)
        self._size = next_fast_len(len(flat), real=True)
        self._flat = flat
        # Time comes last: transforms go through the memory in order.
        in_order = np.ascontiguousarray(flat.T)
        self._spectrum = None if self._count <= _FEW else rfft(in_order, self._size)

    def inside(self, basis: F64) -> F64:
        """(K, U, r) squares of what lies along each of r orthonormal columns (L, r)."""
        count, length, flat = self._count, self._length, self._flat
        if self._spectrum is None:
            product = np.array([flat[k : k + length].T @ basis for k in range(count)])
            return np.asarray((product**2).reshape(count, -1, 3, basis.shape[1]).sum(axis=2))
        shape = np.conj(rfft(np.ascontiguousarray(basis.T), self._size))
        squares = np.empty((len(self._spectrum) // 3, basis.shape[1], count))
        for su, axes in zip(squares, self._spectrum.reshape(len(squares), 3, 1, -1), strict=True):
            product = irfft(axes * shape, self._size)[..., :count]
            np.einsum("arc,arc->rc", product, product, out=su)
        return squares.transpose(2, 0, 1)

    def values(self) -> F64:
        """(U,) independent values of three axes in the stretch, as fast as the readings change."""
        steps = (np.diff(self.segment, axis=0) ** 2).sum(axis=(0, 2))
        fast = np.sqrt(steps / np.maximum(self._energy, 1e-12))
        return np.asarray(np.clip(3 * self._length / np.pi * fast, 3.0, 3.0 * self._length))

    def free(self, dimensions: int) -> F64:
        """(U,) how many independent values there are beyond those that motion takes for itself.

        Args:
            dimensions: of the motion, the constant in.
        """
        return np.asarray(np.maximum(self.values() - 3 * (dimensions - 1), 0.0))

    def judged(self, inside: F64, constant: F64) -> Left:
        """What motion leaves of the readings at every lag.

        Args:
            inside: (K, U) squares of what lies in the motion, the constant in, and
            constant: (K, U) in the constant alone.
        """
        centred = np.maximum(self.total - constant, 1e-12)
        rest = np.maximum(self.total - inside, 0.0)
        quiet = self._length * _FELT**2
        # Of what is felt at each lag: one that leads to a rest leaves little, and explains nothing.
        share = 0.5 * np.log(rest / centred + MODEL)
        return Left(
            share=share,
            size=0.5 * np.log(_least_near(rest) + MODEL * centred + quiet * MODEL),
            felt=centred.mean(axis=0) >= quiet,
            explained=(rest / centred).min(axis=0) <= 1 - _EXPLAINED,
        )


def _least_near(rest: F64) -> F64:
    """(K, U) least that is left within half a step of each lag (K, U), by Lagrange's cubic.

    Half a step off, patterns leave more than second-order effects.
    """
    if len(rest) < 4:
        return rest
    least = rest.copy()
    before, here, there, after = rest[:-3], rest[1:-2], rest[2:-1], rest[3:]
    for x in (0.25, 0.5, 0.75):
        weights = (
            -x * (1 - x) * (2 - x) / 6,
            (1 + x) * (1 - x) * (2 - x) / 2,
            (1 + x) * x * (2 - x) / 2,
            -(1 + x) * x * (1 - x) / 6,
        )
        between = sum(w * r for w, r in zip(weights, (before, here, there, after), strict=True))
        between = np.maximum(between, 0.0)
        if x <= 0.5:
            np.minimum(least[1:-2], between, out=least[1:-2])
        if x >= 0.5:
            np.minimum(least[2:-1], between, out=least[2:-1])
    return least


@dataclass(frozen=True, eq=False)
class Left:
    """What motion leaves of U SUs' readings in a stretch, at each of K lags.

    Attributes:
        share: (K, U) half the logarithm of the share that is left of what is felt at that lag.
        size: (K, U) the same of its size. A lag that leads to a rest has a large share and a small
            size, one that leads from a rest into motion has a small share of a large size: sizes
            tell lags far from each other apart, shares those near the right one.
        felt: (U,) whether motion is felt.
        explained: (U,) whether motion explains most of what is felt at some lag.
    """

    share: F64
    size: F64
    felt: Bool
    explained: Bool


@dataclass(frozen=True, eq=False)
class Integral:
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
    def of(cls, su: SuStream) -> Integral:
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
        n, width = motion.grid.size // EVERY, EVERY / motion.grid.rate
        first = motion.grid.start - 0.5 / motion.grid.rate
        edges = clock.stamped(np.asarray(first + width * np.arange(n + 1)))
        at = np.stack([np.interp(edges, self.time, column) for column in self.area.T], axis=1)
        valid = (edges[:-1] >= self.time[0]) & (edges[1:] <= self.time[-1])
        for begin, end in self.gaps:
            valid &= (edges[1:] < begin) | (edges[:-1] > end)
        return np.diff(at, axis=0) / np.diff(edges)[:, None], valid


def means_of(su: SuStream, clock: SuClock, motion: Motion) -> tuple[F64, Bool]:
    """See :meth:`Integral.means`; integrals are as large as streams, and are not kept."""
    means = Integral.of(su).means(clock, motion)
    su.put_away()
    return means


def best_line(
    time: F64, score: F64, lags: F64, reach: float, steep: float, span: float
) -> tuple[float, float]:
    """Offset and drift with the largest sum of scores, on a grid of lags.

    Args:
        time: (W,) times of stretches since the middle of the log [s].
        score: (W, K) of each stretch at every lag.
        lags: (K,) the lags, evenly apart [s].
        reach: largest offset [s].
        steep: largest drift.
        span: length of the log [s].
    """
    ((offset, drift),), _ = best_lines(time, score[..., None], lags, reach, steep, span)
    return float(offset), float(drift)


def best_lines(
    time: F64, scores: F64, lags: F64, reach: float, steep: float, span: float
) -> tuple[F64, F64]:
    """Lines as `best_line` finds them, for scores (W, K, U) of U SUs.

    Returns:
        (U, 2) lines, and (U,) by how much each is better than any whose offset is not near: beyond
        the next to which scores rise again. Infinite where there is none.
    """
    step = lags[1] - lags[0]
    # Half a sample at the ends of the log from one drift to the next.
    count = int(np.ceil(steep * span / 2 / step))
    U = scores.shape[2]
    inner = np.flatnonzero(np.abs(lags) <= reach)
    profile, drifts = np.full((len(inner), U), -np.inf), np.zeros((len(inner), U))
    for k in range(-count, count + 1):
        drift = steep * k / max(count, 1)
        shift = np.rint(drift * time / step).astype(int)
        total = np.zeros((len(inner), U))
        for row, by in zip(scores, shift, strict=True):
            total += row[np.clip(inner + by, 0, len(lags) - 1)]
        better = total > profile
        profile[better], drifts[better] = total[better], drift
    i, each = profile.argmax(axis=0), np.arange(U)
    lead = np.array([_lead(column) for column in profile.T])
    return np.stack([lags[inner[i]], drifts[i, each]], axis=1), lead


def _lead(profile: F64) -> float:
    """By how much the largest of some scores leads all beyond the slopes that rise to it."""
    first, last = valley(-profile)
    elsewhere = np.delete(profile, np.s_[first : last + 1])
    return float(profile.max() - elsewhere.max(initial=-np.inf))
