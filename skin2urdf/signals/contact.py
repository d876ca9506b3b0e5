"""Moments in which readings do not follow the motion of the joints: something touched the robot.

Around a pose, what the features and the model leave of the low-passed readings is noise: of the
SUs, and of the encoders, which all SUs beyond a joint feel alike. A hit or a push moves a joint
without its encoder seeing all of it. All SUs together tell that from the noise of other encoders,
which hides it in each of them alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter
from scipy.special import chdtri, ndtri

from skin2urdf.arrays import F64, Bool
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.features import Curvature, sus_together
from skin2urdf.signals.filters import aligned, filtered, low_pass, noise_bandwidth
from skin2urdf.signals.mending import computed
from skin2urdf.signals.poses import Neighbourhood, find_stops, stop_blur
from skin2urdf.signals.records import Features
from skin2urdf.signals.regression import regressors
from skin2urdf.signals.ringing import rises_after_stops
from skin2urdf.signals.rounding import regressor_noise
from skin2urdf.signals.sampling import Sampled
from skin2urdf.threads import do_each

_FALSE_ALARM = 1e-6
"""Probability that noise alone stands out anywhere in the logs, were it steady and normal."""
_UNSTEADY = 1.5
"""How far noise may stand above its median over seconds: patterns bring the encoders' along."""
_EXPECTED = 2.0
"""How far it may stand above what is expected of it: rounding of slow joints is not white."""
_LEAST_OWN = 0.05
"""Share of the power of an SU's residuals that is at least its own noise."""
_LEAST_NOISE = 1e-6
"""Noise that every SU has [m/s^2]."""
_STEADY = 4.0
"""Time over which the noise level is taken [s]."""
_PARTS = 8
"""Parts of that time whose medians are taken first."""
_LONGEST = 1.0
"""Time that readings are disturbed by a contact at most, the filter's reach aside [s]."""
_TAIL = 2.0
"""Usual deviations at which a disturbance begins and ends."""
_PLAIN = 5.0
"""Residual over the median from which an SU is said to feel a disturbance."""
_WIDE = 0.2
"""Cutoff at which short hits show, over the rate of the samples."""
_LEAST_RANGE = 1.5 * GRAVITY
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
        time: at which it is strongest [s].
        strength: how far it stands out there, over what is usual.
        residual: (N, U, 3) low-passed residuals, of these samples or of those among them at which
            the disturbance is strongest [m/s^2].
        noise: (U,) each SU's own noise in a residual, per axis, with some allowance [m/s^2].
        encoder_noise: (D,) noise of the joints' accelerations [rad/s^2 or m/s^2].
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
    encoder_noise: F64
    felt: tuple[int, ...]
    cut_off: Bool


def disturbances(
    sampled: Sequence[Sampled],
    features: Features,
    curvature: Curvature,
    *,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[Disturbance, ...]:
    """Moments that stand out from the noise around the poses.

    Args:
        sampled: the logs.
        features: their features.
        curvature: predicts what readings hold beyond first order around a pose.
        progress: told the share of the windows that were looked at.
    """
    limit = _limit(sampled, features.n_dofs)
    out: list[Disturbance] = []
    windows = sum(len(_bands(s)) * sum(len(p.windows) for p in s.neighbourhoods) for s in sampled)
    done = 0
    for log, s in enumerate(sampled):
        grid = s.motion.grid
        stops = find_stops(s.motion)
        readings = aligned(s.readings, grid.rate, features.latency)
        bands = [_Band.of(s, features.n_dofs, *each) for each in _bands(s)]
        for p, pose, window in _windows(s, features, log):
            left = _residuals(s, readings, features, curvature, log, (p, pose, window), bands)
            for band, residual in zip(bands, left, strict=True):
                done += 1
                progress(done / windows)
                begin, _ = band.inner(window)
                own = own_noise(residual, features.tau[p], band.variance)
                pushes = push_strengths(residual, features.tau[p], band.variance, own)
                size = standing_out(pushes, grid.rate)
                if not len(size):
                    continue
                band.sizes.append((begin, size))
                plain = size.max() <= band.allowance * limit
                band.looked.append(None if plain else (p, residual, own))
        for band in bands:
            blur = max(_reach(grid.rate, band.cutoff), stop_blur(grid.rate))
            rises = rises_after_stops(band.sizes, stops, blur)
            for (begin, size), rise, seen in zip(band.sizes, rises, band.looked, strict=True):
                if seen is None:
                    continue
                p, residual, own = seen
                for a, b, at, strength in moments(
                    size / rise, band.allowance * limit, grid.rate, band.cutoff
                ):
                    out.append(
                        Disturbance(
                            log, p, begin + a, begin + b, float(grid.time[begin + at]), strength,
                            residual[a:b], _UNSTEADY * own, np.sqrt(band.variance),
                            felt_by(residual, a, b),
                            _cut_off(readings, begin + a, begin + b),
                        )
                    )  # fmt: skip
    return tuple(_merged(out))


def own_noise(residual: F64, tau: F64, variance: F64) -> F64:
    """(U,) noise per axis of residuals (N, U, 3) that the encoders do not bring [m/s^2].

    Args:
        residual: of a window, in the SUs' frames; 0 for SUs that are not there [m/s^2].
        tau: (U, D, 3) reading per acceleration of each joint, in the SUs' frames [m/rad].
        variance: (D,) of the encoders' noise in the accelerations [rad^2/s^4].

    Returns:
        The noise, infinite for SUs that are not there.
    """
    whole = np.median(np.linalg.norm(residual, axis=-1), axis=0) ** 2 / chdtri(3, 0.5)
    shared = (tau**2).sum(axis=-1) @ variance / 3
    own = np.sqrt(np.maximum(whole - shared, _LEAST_OWN * whole))
    return np.where(whole > 0, np.maximum(own, _LEAST_NOISE), np.inf)


def push_strengths(residual: F64, tau: F64, variance: F64, own: F64) -> F64:
    """Signed square roots of what accelerations that encoders do not see would explain.

    A matched filter at each moment: the likelihood ratio of an acceleration of one joint in
    Gaussian noise, of each SU and of all encoders ``v``, which enters the residuals as
    ``sum_d tau_d v_d``.

    Args:
        residual: (N, U, 3) of a window, in the SUs' frames [m/s^2].
        tau: (U, D, 3) reading per acceleration of each joint, in the SUs' frames [m/rad].
        variance: (D,) of the encoders' noise in the accelerations [rad^2/s^4].
        own: (U,) standard deviation of the SUs' noise per axis [m/s^2].

    Returns:
        (N, J) of the J joints that any SU feels; of variance 1 where nothing is pushed and all
        noise is as expected.
    """
    weighted = tau / own[:, None, None] ** 2
    M = np.tensordot(weighted, tau, axes=([0, 2], [0, 2]))
    # The inverse of the residuals' covariance, by Woodbury's identity.
    sd = np.sqrt(variance)
    lam, V = np.linalg.eigh(sd[:, None] * M * sd)
    known = (V / (1 + np.maximum(lam, 0.0))) @ V.T
    among_noise = np.eye(len(M)) - (M * sd) @ known * sd
    expected = np.diagonal(among_noise @ M)
    score = np.tensordot(residual, weighted, axes=([1, 2], [0, 2])) @ among_noise.T
    felt = expected > 0
    return np.asarray(score[:, felt] / np.sqrt(expected[felt]))


def felt_by(residual: F64, begin: int, end: int) -> tuple[int, ...]:
    """Numbers of the SUs whose residuals (N, U, 3) stand out in an interval, one at least."""
    size = np.linalg.norm(residual, axis=-1)
    usual = np.median(size, axis=0)
    out = np.divide(size[begin:end].max(axis=0), usual, out=np.zeros_like(usual), where=usual > 0)
    return tuple(int(u) for u in np.flatnonzero(out >= min(_PLAIN, float(out.max()))))


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


def _limit(sampled: Sequence[Sampled], D: int) -> float:
    """Deviation, over the standard deviation, that normal noise does not reach."""
    independent = 0.0
    for s in sampled:
        rate = s.motion.grid.rate
        samples = sum(b - a for pose in s.neighbourhoods for a, b in pose.windows)
        independent += samples * sum(
            2 * noise_bandwidth(low_pass(cutoff, rate), rate) / rate for cutoff, _ in _bands(s)
        )
    return float(-ndtri(_FALSE_ALARM / max(1.0, independent * D) / 2))


@dataclass(frozen=True, eq=False)
class _Band:
    """Frequencies in which a log is looked at, and what was seen there so far.

    Attributes:
        cutoff: of the low-pass [Hz], and
        taps: its taps.
        allowance: how much further than normal noise residuals stand out by chance.
        variance: (D,) of the encoders' noise in the accelerations [rad^2/s^4].
        sizes: of every window its first sample, and how far something stands out in it.
        looked: of every window, pose, residuals and noise of the SUs; None where nothing does.
    """

    cutoff: float
    taps: F64
    allowance: float
    variance: F64
    sizes: list[tuple[int, F64]] = field(default_factory=list)
    looked: list[tuple[int, F64, F64] | None] = field(default_factory=list)

    @staticmethod
    def of(s: Sampled, n_dofs: int, cutoff: float, allowance: float) -> _Band:
        """Of a log, nothing of which was looked at."""
        variance = regressor_noise(s.motion, cutoff)[0][1 + n_dofs :]
        return _Band(cutoff, low_pass(cutoff, s.motion.grid.rate), allowance, variance)

    def inner(self, window: tuple[int, int]) -> tuple[int, int]:
        """The samples of a window that filters do not reach beyond, where it is long enough."""
        begin, end = window
        trim = min(len(self.taps) // 2, max(0, (end - begin) // 4))
        return begin + trim, end - trim

    def passed(self, s: Sampled, window: tuple[int, int], left: tuple[int, F64], sus: slice) -> F64:
        """Low-passed residuals (N, u, 3) of some SUs within a window.

        Args:
            s: the log.
            window: its first grid sample and one past its last.
            left: the first sample of what is known in and around it, and that.
            sus: which.
        """
        (begin, end), (first, around) = window, left
        half = len(self.taps) // 2
        lo, hi = max(first, begin - half), min(first + len(around), end + half)
        part = around[lo - first : hi - first]
        smooth = filtered(part.reshape(len(part), -1), self.taps).reshape(part.shape)
        a, b = self.inner(window)
        # An SU that lost samples would show what computing them again got wrong.
        whole = np.all(s.valid[a:b, sus] & ~s.computed[a:b, sus], axis=0)
        return np.asarray(smooth[a - lo : b - lo] * np.asarray(whole)[:, None])


def _windows(
    s: Sampled, features: Features, log: int
) -> Iterator[tuple[int, Neighbourhood, tuple[int, int]]]:
    """Every window of a log, with the number of its pose among the features, and its pose."""
    number = {tuple(features.span[p]): int(p) for p in np.flatnonzero(features.log == log)}
    for pose in s.neighbourhoods:
        p = number.get(pose.span(s.motion.grid))
        if p is not None:
            yield from ((p, pose, window) for window in pose.windows)


def _residuals(
    s: Sampled,
    readings: F64,
    features: Features,
    curvature: Curvature,
    log: int,
    place: tuple[int, Neighbourhood, tuple[int, int]],
    bands: Sequence[_Band],
) -> list[F64]:
    """Low-passed residuals (N, U, 3) within a window, of each band.

    Args:
        s: the log.
        readings: (M, U, 3) of it, on the joints' clock [m/s^2].
        features: of all logs.
        curvature: predicts what readings hold beyond first order around a pose.
        log: number of the log.
        place: number of the pose, the pose, and the window.
        bands: frequencies that are wanted.
    """
    (p, pose, window), motion, U = place, s.motion, features.n_sus
    lossy = {fault.subject for fault in s.faults if fault.kind == "intermittent"}
    witness = np.array([name not in lossy for name in features.su_names])
    reach = max(len(band.taps) // 2 for band in bands)
    part = slice(max(0, window[0] - reach), min(motion.grid.size, window[1] + reach))
    dq, qd, qdd = motion.q[part] - pose.q, motion.qd[part], motion.qdd[part]
    X, _ = regressors(dq, qd, qdd, True)
    coefficients = np.moveaxis(features.coefficients[p], 0, 1)
    inner = (band.inner(window) for band in bands)
    out = [np.empty((b - a, U, 3)) for a, b in inner]

    of_sus = curvature(pose.q, dq, qd, qdd, log)

    def look(sus: slice) -> None:
        beyond, _ = of_sus(sus)
        left = readings[part, sus] - beyond
        left -= (X @ coefficients[:, sus].reshape(X.shape[1], -1)).reshape(left.shape)
        left *= (s.valid[part, sus] & witness[sus])[..., None]
        for band, residual in zip(bands, out, strict=True):
            residual[:, sus] = band.passed(s, window, (part.start, left), sus)

    do_each(look, sus_together(U), U)
    return out


def standing_out(pushes: F64, rate: float) -> F64:
    """How far the joint that stands out most does so, over what is usual for seconds.

    Args:
        pushes: (N, J) of a window, of variance 1 where nothing does.
        rate: samples per second [Hz].

    Returns:
        (N,) 1 and less where nothing does; (0,) where a window is too short to tell what is usual.
    """
    if len(pushes) < rate or not pushes.size:
        return np.zeros(0)
    size = np.abs(pushes)
    usual = _level(size, int(rate * _STEADY / _PARTS))
    usual = np.maximum(usual, np.median(size, axis=0)) / -ndtri(0.25)
    return np.asarray((size / np.hypot(_UNSTEADY * usual, _EXPECTED)).max(axis=1))


def moments(
    size: F64, limit: float, rate: float, cutoff: float
) -> Iterator[tuple[int, int, int, float]]:
    """Intervals of a window in which something stands out.

    Args:
        size: (N,) how far something does, see :func:`standing_out`.
        limit: how far noise stands out by chance.
        rate: samples per second [Hz].
        cutoff: of the low-pass [Hz].

    Returns:
        Begin, end, peak, and how far it stands out over what is usual.
    """
    # A swing goes through zero.
    reach = _reach(rate, cutoff)
    beyond = np.r_[False, maximum_filter1d(size, 2 * reach + 1) > _TAIL, False]
    for a, b in np.flatnonzero(np.diff(beyond.astype(np.int8))).reshape(-1, 2):
        at = int(a + size[a:b].argmax())
        if size[at] > limit and (b - a - 2 * reach) / rate < _LONGEST + 2 / cutoff:
            yield int(a), int(b), at, float(size[at])


def _reach(rate: float, cutoff: float) -> int:
    """Samples on either side in which a swing of low-passed readings has its largest."""
    return int(rate * max(_MARGIN, 0.5 / cutoff))


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
