"""Samples -> Features: regression around every pose, latencies of the SUs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.errors import InsufficientDataError
from skin2urdf.faults import distinct
from skin2urdf.signals.encoder_noise import EncoderNoise
from skin2urdf.signals.filters import aligned, eroded, filtered
from skin2urdf.signals.information import Information
from skin2urdf.signals.pose_fit import PoseFit, Samples, pose_fit
from skin2urdf.signals.poses import Neighbourhood
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled, static_moves
from skin2urdf.signals.steadiness import allowance, moderated
from skin2urdf.signals.swings import Swing
from skin2urdf.signals.turn_evidence import turn_evidence
from skin2urdf.threads import each

OfSus = Callable[[slice], tuple[F64, F64]]
"""SUs -> (N, u, 3) their readings beyond first order around a pose, and (1 + 2 D, u, 3) the
coefficients that the first order should have."""
Curvature = Callable[[F64, F64, F64, F64, int], OfSus]
"""What gives those of (q (D,), dq (N, D), qd, qdd, log), of a motion around pose q."""
_TOGETHER = 64
"""SUs whose samples around a pose are in memory at a time: some 10 MB, of which several copies."""


def extract_features(
    sampled: Sequence[Sampled],
    su_names: Sequence[str],
    *,
    curvature: Curvature | None = None,
    latency: F64 | None = None,
    tell: Callable[[float], None] = lambda _: None,
) -> Features:
    """Regress the readings around every pose of every log.

    Args:
        sampled: the logs, all with the same DoF and SU names.
        su_names: U names.
        curvature: predicts what is beyond first order; with it the regression has no nuisances.
        latency: (U,) where to start the search for each SU's latency [s].
        tell: told the share of the work that is done.

    Raises:
        InsufficientDataError: no pose has a pattern around it.
    """
    U = len(su_names)
    lag = np.zeros(U) if latency is None else np.array(latency, dtype=np.float64)
    change, lag_sd = np.zeros(U), np.full(U, np.inf)
    n_poses = max(1, sum(len(s.neighbourhoods) for s in sampled))
    for again in range(6):
        parts: list[list[_Pose]] = []
        for log, s in enumerate(sampled):
            before = sum(map(len, parts))

            def told(pose: int, before: int = before, left: float = 0.5**again) -> None:
                # How many looks there will be is not known: each takes half of what is left.
                tell(1.0 - left * (1.0 - 0.5 * (before + pose) / n_poses))

            parts.append(_poses(s, lag, curvature, log, told))
        previous = np.abs(change) if again else np.full(U, np.inf)
        change, lag_sd = _latency_step([p for part in parts for p in part])
        lag = np.clip(lag + change, -0.25, 0.25)
        # Steps to a lag that shows are a hundred times shorter each time; others follow noise.
        follows = (np.abs(change) > _SHORTER * previous) & (np.abs(change) < _REAL * lag_sd)
        if np.max(np.where(follows, 0.0, np.abs(change)), initial=0.0) < 2e-5:
            break
    poses = _moderated([p for part in parts for p in part])
    if not poses:
        raise InsufficientDataError(
            "no pose with readings around it was found",
            "record rests of about a second, with small motions of the joints between them",
            lacks="poses",
        )
    notes = tuple(n for s in sampled for n in s.notes)
    return Features(
        su_names=tuple(su_names),
        dof_names=sampled[0].motion.dof_names,
        q=np.array([p.q for p in poses]),
        log=np.array([p.log for p in poses]),
        coefficients=np.array([p.fit.coefficients for p in poses]),
        information=Information.joined([p.fit.information for p in poses]),
        noise=np.array([p.fit.noise for p in poses]),
        encoders=EncoderNoise.joined([p.encoders for p in poses]),
        span=np.array([p.span for p in poses]),
        left=np.array([p.left for p in poses]),
        latency=lag,
        latency_sd=np.hypot(lag_sd, _clock_error(sampled)),
        moves=static_moves(sampled),
        notes=notes,
        faults=distinct(f for s in sampled for f in s.faults),
        turns=turn_evidence(sampled, lag),
    )


_REAL = 5.0
"""Standard deviations of a step to another latency beyond which it is real."""
_SHORTER = 0.5
"""A step to another latency over the one before, beyond which it follows noise."""


@dataclass(frozen=True, eq=False)
class _Pose:
    q: F64
    log: int
    fit: PoseFit
    encoders: EncoderNoise
    span: tuple[float, float]
    left: bool


def _poses(
    s: Sampled, lag: F64, curvature: Curvature | None, log: int, told: Callable[[int], None]
) -> list[_Pose]:
    """Regress around every pose of one log."""
    motion, rate, swings = s.motion, s.motion.grid.rate, s.swings
    half, every = len(swings.taps) // 2, swings.every
    readings = aligned(s.readings, rate, lag)
    reach = int(np.ceil(np.max(np.abs(lag), initial=0.0) * rate))
    around = swings.with_nuisances if curvature is None else swings.linear

    def regress(near: tuple[Neighbourhood, Swing]) -> _Pose:
        pose, swing = near
        beyond = None
        if curvature is not None:
            beyond = curvature(pose.q, swing.dq, swing.qd, swing.qdd, log)
        parts = [
            _readings(s, readings, pose, swing, beyond, reach, sus)
            for sus in sus_together(len(lag))
        ]
        y, expected = (np.concatenate(both, axis=1) for both in zip(*parts, strict=True))
        usable, lost = [], []
        for (a, b), (lo, hi) in zip(pose.windows, swings.pieces(pose), strict=True):
            trim = min(half, max(0, (b - a) // 4))
            ok = np.zeros((hi - lo, len(lag)), dtype=bool)
            ok[a - lo + trim : b - lo - trim] = True
            whole = eroded_columns(s.valid[lo:hi], half + reach)
            usable.append((ok & whole)[a - lo : b - lo : every])
            lost.append(s.computed[a:b:every])
        ok = np.concatenate(usable)
        found = pose_fit(
            Samples(
                swing.low_passed, swing.nuisances, y, ok, expected,
                swings.noise, swings.independence, rate / every, s.cutoff,
            )
        )  # fmt: skip
        measured = _measured(ok, np.concatenate(lost))
        return _Pose(
            q=pose.q,
            log=log,
            fit=replace(found, noise=found.noise / measured),
            encoders=swing.encoders,
            span=pose.span(motion.grid),
            left=pose.left,
        )

    out = []
    for found in each(regress, zip(s.neighbourhoods, around, strict=True), len(lag)):
        out.append(found)
        told(len(out))
    return [p for p in out if np.isfinite(p.fit.noise).any()]


def sus_together(n_sus: int) -> list[slice]:
    """SUs by as many as are worked on at a time."""
    return [slice(u, min(u + _TOGETHER, n_sus)) for u in range(0, n_sus, _TOGETHER)]


def _readings(
    s: Sampled,
    readings: F64,
    pose: Neighbourhood,
    swing: Swing,
    of_sus: OfSus | None,
    reach: int,
    sus: slice,
) -> tuple[F64, F64]:
    """Low-passed readings (K, u, 3) of some SUs around a pose, and what is expected of them.

    Args:
        s: the log.
        readings: (N, U, 3) of it, on the joints' clock [m/s^2].
        pose: the pose.
        swing: what joints do around it.
        of_sus: predicts what is beyond first order, which is taken off.
        reach: samples by which readings were shifted at most.
        sus: which.

    Returns:
        These, and (1 + 2 D, u, 3) coefficients; 0 where nothing predicts them.
    """
    y = np.concatenate([readings[lo:hi, sus] for lo, hi in s.swings.pieces(pose)])
    expected = np.zeros((swing.X.shape[1], *y.shape[1:]))
    if of_sus is not None:
        beyond, expected = of_sus(sus)
        y -= beyond
        _recompute(swing, y, s, pose, reach, sus)
    return s.swings.kept(y, pose), expected


def _moderated(poses: Sequence[_Pose]) -> list[_Pose]:
    """Poses with the noise at rest of each SU as all rests show it together."""
    if not poses:
        return []
    noise = np.array([p.fit.noise for p in poses])
    heard = np.isfinite(noise).all(axis=2)
    freedom = np.array([p.fit.freedom for p in poses])
    variance, freedom = moderated(
        np.where(heard[..., None], noise, 1.0) ** 2, freedom, heard & [p.fit.rests for p in poses]
    )
    variance *= allowance(freedom)[..., None]
    noise = np.where(heard[..., None], np.sqrt(variance), np.inf)
    return [replace(p, fit=replace(p.fit, noise=n)) for p, n in zip(poses, noise, strict=True)]


def _recompute(
    swing: Swing, y: F64, s: Sampled, pose: Neighbourhood, reach: int, sus: slice
) -> None:
    """Compute missing samples of y (N, u, 3) again, in place, now that the regressors explain it.

    They are low-passed, the readings can not be while samples are missing: their noise does
    no harm in a regression, that of the encoders would.
    """
    X, spans, taps, pieces = swing.X, swing.spans, s.swings.taps, s.swings.pieces(pose)
    lost = np.concatenate([s.computed[lo:hi, sus] for lo, hi in pieces])
    if not lost.any():
        return
    starts = np.cumsum([0, *(hi - lo for lo, hi in pieces)])
    smooth = np.concatenate([filtered(X[i:j], taps) for i, j in pairwise(starts)])
    inside = np.concatenate(
        [(np.arange(*ends) >= a) & (np.arange(*ends) < b)
         for (a, b), ends in zip(pose.windows, pieces, strict=True)]
    )  # fmt: skip
    measured = eroded_columns(s.valid[spans, sus] & ~lost, reach)
    scale = np.sqrt((smooth[inside] ** 2).mean(axis=0))
    known = scale > 1e-9
    Z = smooth[:, known] / scale[known]
    alike: dict[bytes, list[int]] = {}
    for u in np.flatnonzero(lost.any(axis=0)):
        lacks = measured[:, u].tobytes() + lost[:, u].tobytes()
        alike.setdefault(lacks, []).append(int(u))
    for some in map(np.array, alike.values()):
        ok, missing = inside & measured[:, some[0]], inside & lost[:, some[0]]
        readings = y[np.ix_(ok, some)].reshape(-1, 3 * len(some))
        solution = np.linalg.lstsq(Z[ok], readings, rcond=1e-6)[0]
        y[np.ix_(missing, some)] = (Z[missing] @ solution).reshape(-1, len(some), 3)


def _measured(used: Bool, computed: Bool) -> F64:
    """(U, 1) share of measured samples among those used (N, U).

    Computed ones have no residual, which makes the noise look smaller by the root of that share,
    and bring no information, of which the share is left.
    """
    n = np.maximum(used.sum(axis=0), 1)
    return np.asarray(np.maximum(1 - (used & computed).sum(axis=0) / n, 0.1))[:, None]


def eroded_columns(valid: Bool, reach: int) -> Bool:
    """(N, U) True where every column holds for ``reach`` samples on either side as well."""
    if valid.all():
        return valid
    return np.stack([eroded(column, reach) for column in valid.T], axis=1)


def _clock_error(sampled: Sequence[Sampled]) -> float:
    """Standard deviation of the time by which the joints' own clock is off [s].

    It is the mean error of the stamps while the joints move, whose errors count with the squares of
    the accelerations, and goes into the latency of every SU.
    """
    weights, variances = [0.0], [0.0]
    for s in sampled:
        motion = s.motion
        windows = [np.arange(*w) for pose in s.neighbourhoods for w in pose.windows]
        square = (motion.qdd[np.concatenate(windows)] ** 2).sum(axis=1) if windows else np.zeros(1)
        weights.append(float(square.sum()))
        seconds = weights[-1] ** 2 / max(float((square**2).sum()), 1e-12) / motion.grid.rate
        noise = float((motion.stamp_noise**2 / motion.raw_rate).max(initial=0.0))
        variances.append(noise / seconds if seconds > 0 else 0.0)
    total = max(sum(weights), 1e-12)
    return float(
        np.sqrt(sum((w / total) ** 2 * v for w, v in zip(weights, variances, strict=True)))
    )


def _latency_step(poses: Sequence[_Pose]) -> tuple[F64, F64]:
    """Change of each SU's latency [s] and its standard deviation."""
    numerator = np.sum([p.fit.lag_numerator for p in poses], axis=0)
    denominator = np.sum([p.fit.lag_denominator for p in poses], axis=0)
    sd = np.where(denominator > 0, 1 / np.sqrt(np.maximum(denominator, 1e-300)), np.inf)
    step = np.divide(numerator, denominator, out=np.zeros_like(sd), where=denominator > 0)
    # A large lag leaves large residuals, hence a large sd: a step of many sd is real all the same.
    known = (sd < 3e-4) | (np.abs(step) > _REAL * sd)
    return np.where(known, np.clip(step, -0.03, 0.03), 0.0), np.where(known, sd, np.inf)
