"""Moments in which readings do not follow the motion of the joints: something touched the robot.

Around a pose, what the features and the model leave of the low-passed readings is noise. A hit or
a push moves a joint without its encoder seeing all of it, and stands out for a moment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.stats import chi2 as chi_squared

from skin2urdf.arrays import F64, Bool
from skin2urdf.signals.features import Curvature
from skin2urdf.signals.filters import filtered, low_pass, noise_bandwidth, shifted
from skin2urdf.signals.mending import computed
from skin2urdf.signals.records import Features
from skin2urdf.signals.regression import regressors
from skin2urdf.signals.rounding import regressor_noise
from skin2urdf.signals.sampling import Sampled

_FALSE_ALARM = 1e-6
"""Probability that noise alone stands out anywhere in the logs, were it steady and normal."""
_UNSTEADY = 1.5
"""How far noise may stand above its median over seconds: patterns bring the encoders' along."""
_STEADY = 4.0
"""Time over which the noise level is taken [s]."""
_PARTS = 8
"""Parts of that time whose medians are taken first."""
_LONGEST = 1.0
"""Time that readings are disturbed by a contact at most, the filter's reach aside [s]."""
_TAIL = 2.0
"""Usual residuals at which a disturbance begins and ends."""
_WIDE = 0.2
"""Cutoff at which short hits show, over the rate of the samples."""
_LEAST_RANGE = 1.5 * 9.81
"""Range that every sensor has [m/s^2]."""
_LATE = 1.6
"""How much further residuals of that band stand out by chance than normal noise does."""
_MARGIN = 0.04
"""Left out before and after [s]."""


@dataclass(frozen=True, eq=False)
class Disturbance:
    """A moment in which readings stand out from what the joints' motion explains.

    Attributes:
        log: index of the log.
        pose: index of the pose in the features.
        begin: first grid sample, and
        end: one past the last.
        time: of the largest residual [s].
        strength: the largest residual, over what is usual.
        residual: (N, U, 3) low-passed residuals, of these samples or of those among them at which
            the disturbance is strongest [m/s^2].
        noise: (U,) what is usual for the length of a residual, with some allowance [m/s^2].
        felt: numbers of the SUs whose residuals stand out.
        cut_off: (U,) True for SUs whose readings may have left their range.
    """

    log: int
    pose: int
    begin: int
    end: int
    time: float
    strength: float
    residual: F64
    noise: F64
    felt: tuple[int, ...]
    cut_off: Bool


def disturbances(
    sampled: Sequence[Sampled], features: Features, curvature: Curvature
) -> tuple[Disturbance, ...]:
    """Moments that stand out from the noise around the poses.

    Args:
        sampled: the logs.
        features: their features.
        curvature: predicts what readings hold beyond first order around a pose.
    """
    limit = _limit(sampled, features.n_sus)
    out: list[Disturbance] = []
    for log, s in enumerate(sampled):
        rate = s.motion.grid.rate
        readings = np.stack(
            [shifted(s.readings[:, u], rate, lag) for u, lag in enumerate(features.latency)], axis=1
        )
        for cutoff, allowance in _bands(s):
            acceleration = regressor_noise(s.motion, cutoff)[0][1 + features.n_dofs :]
            taps = low_pass(cutoff, rate)
            for p, begin, residual in _residuals(s, readings, features, curvature, log, taps):
                rounding = np.sqrt((features.tau[p] ** 2).sum(axis=-1) @ acceleration)
                for a, b, at, strength, noise, felt in _peaks(
                    residual, rounding, allowance * limit, s, cutoff
                ):
                    out.append(
                        Disturbance(
                            log, p, begin + a, begin + b, float(s.motion.grid.time[begin + at]),
                            strength, residual[a:b], noise, felt,
                            _cut_off(readings, begin + a, begin + b),
                        )
                    )  # fmt: skip
    return tuple(_merged(out))


def _cut_off(readings: F64, begin: int, end: int) -> Bool:
    """(U,) True for SUs whose readings (N, U, 3) are nowhere as large as in an interval."""
    size = np.abs(readings).max(axis=2)
    largest = size[begin:end].max(axis=0)
    return np.asarray((largest >= size.max(axis=0)) & (largest > _LEAST_RANGE))


def _bands(s: Sampled) -> list[tuple[float, float]]:
    """Cutoffs [Hz], and how much further than normal noise residuals stand out by chance.

    A push shows in the band of the patterns, a short hit far beyond it. There late stamps show as
    well, which are not normal.
    """
    wide = _WIDE * s.motion.grid.rate
    return [(s.cutoff, 1.0), *([(wide, _LATE)] if wide > s.cutoff else [])]


def _merged(found: Sequence[Disturbance]) -> Iterator[Disturbance]:
    """Disturbances that overlap as one, with the residuals of the strongest."""
    left = sorted(found, key=lambda d: (d.log, d.begin))
    while left:
        first, *left = left
        group, end = [first], first.end
        while left and left[0].log == first.log and left[0].begin < end:
            group.append(left.pop(0))
            end = max(end, group[-1].end)
        felt = tuple(sorted({u for d in group for u in d.felt}))
        yield replace(max(group, key=lambda d: d.strength), begin=first.begin, end=end, felt=felt)


def _limit(sampled: Sequence[Sampled], U: int) -> float:
    """Residual's length, over its median, that noise does not reach."""
    independent = 0.0
    for s in sampled:
        rate = s.motion.grid.rate
        samples = sum(b - a for pose in s.neighbourhoods for a, b in pose.windows)
        independent += samples * sum(
            2 * noise_bandwidth(low_pass(cutoff, rate), rate) / rate for cutoff, _ in _bands(s)
        )
    chance = _FALSE_ALARM / max(1.0, independent * U)
    return float(np.sqrt(chi_squared.isf(chance, 3) / chi_squared.median(3)))


def _residuals(
    s: Sampled, readings: F64, features: Features, curvature: Curvature, log: int, taps: F64
) -> Iterator[tuple[int, int, F64]]:
    """Pose, first grid sample and low-passed residuals (N, U, 3) of every window."""
    motion, half = s.motion, len(taps) // 2
    lossy = {fault.subject for fault in s.faults if fault.kind == "intermittent"}
    witness = np.array([name not in lossy for name in features.su_names])
    number = {tuple(features.span[p]): int(p) for p in np.flatnonzero(features.log == log)}
    for pose in s.neighbourhoods:
        p = number.get(pose.span(motion.grid))
        if p is None:
            continue
        for begin, end in pose.windows:
            trim = min(half, max(0, (end - begin) // 4))
            a, b = begin + trim, end - trim
            lo, hi = max(0, begin - half), min(motion.grid.size, end + half)
            part = slice(lo, hi)
            dq, qd, qdd = motion.q[part] - pose.q, motion.qd[part], motion.qdd[part]
            X, _ = regressors(dq, qd, qdd, True)
            beyond, _ = curvature(pose.q, dq, qd, qdd, log)
            left = readings[part] - beyond
            left = left - (X @ features.coefficients[p]).swapaxes(0, 1)
            # An SU that lost samples would show what computing them again got wrong.
            whole = witness & (s.valid[a:b] & ~s.computed[a:b]).all(axis=0)
            left *= (s.valid[part] & whole)[..., None]
            smooth = filtered(left.reshape(len(left), -1), taps).reshape(left.shape)
            yield p, a, smooth[a - lo : b - lo]


def _peaks(
    residual: F64, rounding: F64, limit: float, s: Sampled, cutoff: float
) -> Iterator[tuple[int, int, int, float, F64, tuple[int, ...]]]:
    """Intervals of a window's residuals (N, U, 3) that stand out.

    Args:
        residual: the residuals.
        rounding: (U,) what the encoders' rounding adds to them.
        limit: how far residuals stand out by chance.
        s: the log.
        cutoff: of the low-pass.

    Returns:
        Begin, end, peak, its strength, the usual noise, SUs that feel it.
    """
    rate = s.motion.grid.rate
    size = np.linalg.norm(residual, axis=-1)
    if len(size) < rate:
        return
    usual = _level(size, int(rate * _STEADY / _PARTS))
    usual = np.hypot(_UNSTEADY * np.maximum(usual, np.median(size, axis=0)), rounding)
    z = size / np.maximum(usual, 1e-6)
    highest = z.max(axis=1)
    edges = np.flatnonzero(np.diff(np.r_[False, highest > _TAIL, False].astype(np.int8)))
    margin = int(_MARGIN * rate)
    for a, b in edges.reshape(-1, 2):
        at = int(a + highest[a:b].argmax())
        if highest[at] < limit or (b - a) / rate > _LONGEST + 2 / cutoff:
            continue
        felt = np.flatnonzero(z[a:b].max(axis=0) > limit)
        yield (
            max(0, int(a) - margin), min(len(z), int(b) + margin), at, float(highest[at]),
            usual[at], tuple(int(u) for u in felt),
        )  # fmt: skip


def _level(size: F64, part: int) -> F64:
    """Running medians over seconds of sizes (N, U): medians of the medians of parts."""
    N = len(size)
    starts = np.arange(0, max(1, N - part // 2), part)
    ends = np.append(starts[1:], N)
    medians = np.array([np.median(size[a:b], axis=0) for a, b in zip(starts, ends, strict=True)])
    smooth = median_filter(medians, size=(min(_PARTS, len(medians)) | 1, 1), mode="reflect")
    return np.repeat(smooth, ends - starts, axis=0)


def without(sampled: Sequence[Sampled], found: Sequence[Disturbance]) -> list[Sampled]:
    """The logs with disturbed samples taken as missing, and computed from their window."""
    return [_without(s, [d for d in found if d.log == log]) for log, s in enumerate(sampled)]


def _without(s: Sampled, found: Sequence[Disturbance]) -> Sampled:
    if not found:
        return s
    valid = np.array(s.valid)
    for d in found:
        valid[d.begin : d.end] = False
    readings, filled = computed(s.motion, s.neighbourhoods, s.cutoff, s.readings, valid)
    return replace(
        s, readings=readings, valid=valid | filled, computed=(s.computed & valid) | filled
    )
