"""Recordings -> Features: rests, neighbourhoods, latencies, regression."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.errors import InsufficientDataError
from skin2urdf.recording.records import Recording
from skin2urdf.signals.filters import (
    eroded,
    filtered,
    first_derivative,
    low_pass,
    noise_bandwidth,
    sample,
    shifted,
)
from skin2urdf.signals.health import frozen, saturated, unusable
from skin2urdf.signals.motion import Motion, joint_motion
from skin2urdf.signals.poses import Neighbourhood, Rest, find_neighbourhoods, find_rests
from skin2urdf.signals.records import Features, StaticMoves
from skin2urdf.signals.regression import (
    Design,
    enough,
    excited,
    fit,
    hidden_motion,
    noise_by_row,
    regressors,
)

Curvature = Callable[[F64, F64, F64, F64, int], F64]
"""(q (D,), dq (N, D), qd, qdd, log) -> (N, U, 3) readings beyond first order around pose q."""

STANDARD_GRAVITY = 9.81
_G_UNITS = (0.5, 2.0)
_MODEL_NOISE = 3e-4
"""Error of interpolating and differentiating sampled signals [m/s^2]; a floor for the noise."""
_STILL = 20.0
"""Encoder steps per second below which rounding does not average out [1/s]."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """One log on its grid, and what was found in it.

    Attributes:
        motion: joint motion.
        rests: where nothing moves.
        neighbourhoods: poses with their windows.
        readings: (N, U, 3) SU readings on the grid [m/s^2].
        valid: (N, U) where they are whole.
        cutoff: low-pass cutoff that suits the patterns [Hz].
        notes: words for the user.
    """

    motion: Motion
    rests: tuple[Rest, ...]
    neighbourhoods: tuple[Neighbourhood, ...]
    readings: F64
    valid: Bool
    cutoff: float
    notes: tuple[str, ...]


def sample_recording(
    recording: Recording, dof_names: Sequence[str], su_names: Sequence[str]
) -> Sampled:
    """Put a recording on one grid and find its poses.

    Raises:
        InsufficientDataError: too few samples, or the robot never rests.
    """
    motion = joint_motion(recording, dof_names)
    _check_unit(motion, recording.source)
    rests = find_rests(motion)
    if not rests:
        raise InsufficientDataError(
            f"{recording.source}: the robot never rests: no quarter of a second in which all "
            "joints keep still",
            "let the robot rest for about a second in every pose, before and after each pattern",
        )
    neighbourhoods = find_neighbourhoods(motion, rests)
    streams = {s.name: s for s in recording.sus}
    readings = np.zeros((motion.grid.size, len(su_names), 3))
    valid = np.zeros((motion.grid.size, len(su_names)), dtype=bool)
    notes = list(recording.notes)
    frozen_ones = frozen([s.specific_force for s in recording.sus])
    stuck = {s.name for s, f in zip(recording.sus, frozen_ones, strict=True) if f}
    still = np.zeros(motion.grid.size, dtype=bool)
    for r in rests:
        still[r.begin : r.end] = True
    for u, name in enumerate(su_names):
        if name not in streams:
            continue
        stream = streams[name]
        readings[:, u], ok = sample(stream.time, stream.specific_force, motion.grid)
        valid[:, u] = ok & motion.valid
        factor = _unit(readings[still & valid[:, u], u])
        if factor != 1.0:
            readings[:, u] *= factor
            notes.append(f"{name} reports g instead of m/s^2; its readings were converted")
        why = unusable(readings[:, u], still, valid[:, u], STANDARD_GRAVITY)
        if name in stuck:
            why = "repeats one value all the time: it is frozen"
        if why:
            valid[:, u] = False
            notes.append(f"{name} {why}; it is left out")
        elif share := saturated(stream.specific_force):
            notes.append(
                f"{name} is at the end of its range in {100 * share:.1f} % of its samples: use a "
                "larger range or weaker patterns"
            )
    cutoff = _cutoff(motion, neighbourhoods)
    return Sampled(motion, rests, neighbourhoods, readings, valid, cutoff, tuple(notes))


def _check_unit(motion: Motion, source: str) -> None:
    """Raise where most joints swing and spin as far as degrees would."""
    moved = np.ptp(motion.q, axis=0)
    fast = np.abs(motion.qd).max(axis=0)
    moving = moved > 0
    if moving.any() and np.median(moved[moving]) > 15 and np.median(fast[moving]) > 20:
        raise InsufficientDataError(
            f"{source}: joint positions span {np.median(moved[moving]):.0f} and move at up to "
            f"{np.median(fast[moving]):.0f} per second: they look like degrees",
            "record the joint states in rad (REP 103)",
        )


def _unit(static: F64) -> float:
    """Factor that makes a stream's static readings m/s^2."""
    if not len(static):
        return 1.0
    size = float(np.median(np.linalg.norm(static, axis=1)))
    return STANDARD_GRAVITY if _G_UNITS[0] < size < _G_UNITS[1] else 1.0


def _cutoff(motion: Motion, neighbourhoods: Sequence[Neighbourhood]) -> float:
    """Low-pass cutoff [Hz] that keeps the patterns' accelerations and their second harmonics.

    The encoder's rounding, seen through two differentiations, grows with the cutoff to the power
    of 2.5; the patterns' own content sets how low it can be.
    """
    rate = motion.grid.rate
    energy = np.zeros(257)
    for pose in neighbourhoods:
        for begin, end in pose.windows:
            if end - begin < 64:
                continue
            window = np.hanning(end - begin)[:, None]
            spectrum = np.abs(np.fft.rfft(motion.qd[begin:end] * window, axis=0)) ** 2
            f = np.fft.rfftfreq(end - begin, 1 / rate)
            total = spectrum / np.maximum(motion.noise * 100, 1e-4) ** 2
            index = np.minimum((f * 8).astype(int), 256)
            np.add.at(energy, index, total.sum(axis=1))
    if energy.sum() <= 0:
        return 10.0
    share = np.cumsum(energy) / energy.sum()
    highest = float(np.searchsorted(share, 0.98) / 8)
    return float(np.clip(2.2 * highest + 1.0, 5.0, 20.0))


def extract_features(
    sampled: Sequence[Sampled],
    su_names: Sequence[str],
    *,
    curvature: Curvature | None = None,
    latency: F64 | None = None,
) -> Features:
    """Regress the readings around every pose of every log.

    Args:
        sampled: the logs, all with the same DoF and SU names.
        su_names: U names.
        curvature: predicts what is beyond first order; with it the regression has no nuisances.
        latency: (U,) where to start the search for each SU's latency [s].

    Raises:
        InsufficientDataError: no pose has a pattern around it.
    """
    U = len(su_names)
    lag = np.zeros(U) if latency is None else np.array(latency, dtype=np.float64)
    lag_sd = np.full(U, np.inf)
    for _ in range(6):
        parts = [_poses(s, lag, curvature, log) for log, s in enumerate(sampled)]
        change, lag_sd = _latency_step([p for part in parts for p in part])
        if np.max(np.abs(change), initial=0.0) < 2e-5:
            break
        lag = np.clip(lag + change, -0.25, 0.25)
    poses = [p for part in parts for p in part]
    if not poses:
        raise InsufficientDataError(
            "no pose with readings around it was found",
            "record rests of about a second, with small motions of the joints between them",
        )
    notes = tuple(n for s in sampled for n in s.notes)
    return Features(
        su_names=tuple(su_names),
        dof_names=sampled[0].motion.dof_names,
        q=np.array([p.q for p in poses]),
        log=np.array([p.log for p in poses]),
        coefficients=np.array([p.coefficients for p in poses]),
        information=np.array([p.information for p in poses]),
        noise=np.array([p.noise for p in poses]),
        position_sd=np.array([p.offset for p in poses]),
        hidden=np.array([p.hidden for p in poses]),
        latency=lag,
        latency_sd=lag_sd,
        moves=static_moves(sampled),
        notes=notes,
    )


@dataclass(frozen=True, eq=False)
class _Pose:
    q: F64
    log: int
    coefficients: F64
    information: F64
    noise: F64
    offset: F64
    hidden: F64
    lag_numerator: F64
    lag_denominator: F64


def _poses(s: Sampled, lag: F64, curvature: Curvature | None, log: int) -> list[_Pose]:
    """Regress around every pose of one log."""
    motion, rate = s.motion, s.motion.grid.rate
    taps = low_pass(s.cutoff, rate)
    half = len(taps) // 2
    independence = min(1.0, 2 * noise_bandwidth(taps, rate) / rate)
    readings = np.stack([shifted(s.readings[:, u], rate, lag[u]) for u in range(len(lag))], axis=1)
    reach = int(np.ceil(np.max(np.abs(lag), initial=0.0) * rate))
    noise = _regressor_noise(motion, s.cutoff)
    out = []
    for pose in s.neighbourhoods:
        pieces = [_span(motion, a, b, half) for a, b in pose.windows]
        spans = np.concatenate([np.arange(lo, hi) for lo, hi in pieces])
        dq = motion.q[spans] - pose.q
        qd, qdd = motion.qd[spans], motion.qdd[spans]
        X, Z = regressors(dq, qd, qdd, curvature is not None)
        y = readings[spans]
        if curvature is not None:
            y = y - curvature(pose.q, dq, qd, qdd, log)
        still = (np.abs(qd) < _STILL * motion.resolution).mean(axis=0)
        hidden = hidden_motion(qd, qdd, motion.resolution)
        inner, usable, at = [], [], 0
        for (a, b), (lo, hi) in zip(pose.windows, pieces, strict=True):
            inner.append(np.arange(at + a - lo, at + b - lo))
            trim = min(half, max(0, (b - a) // 4))
            ok = np.zeros((hi - lo, len(lag)), dtype=bool)
            ok[a - lo + trim : b - lo - trim] = True
            usable.append((ok & eroded_columns(s.valid[lo:hi], half + reach))[a - lo : b - lo])
            part = slice(at, at + hi - lo)
            X[part], y[part] = filtered(X[part], taps), filtered(y[part], taps)
            Z[part] = filtered(Z[part], taps) if Z.shape[1] else Z[part]
            at += hi - lo
        use = np.concatenate(inner)
        ok = np.concatenate(usable)
        out.append(
            _regress(
                pose.q, log, X[use], Z[use], y[use], ok, noise, (still * motion.noise, hidden),
                (independence, rate, s.cutoff),
            )
        )  # fmt: skip
    return [p for p in out if np.isfinite(p.noise).any()]


def _span(motion: Motion, begin: int, end: int, margin: int) -> tuple[int, int]:
    """A window widened by the filter's reach, inside the grid."""
    return max(0, begin - margin), min(motion.grid.size, end + margin)


def eroded_columns(valid: Bool, reach: int) -> Bool:
    """(N, U) True where every column holds for ``reach`` samples on either side as well."""
    if valid.all():
        return valid
    return np.stack([eroded(column, reach) for column in valid.T], axis=1)


def _regress(
    q: F64,
    log: int,
    X: F64,
    Z: F64,
    y: F64,
    ok: Bool,
    noise: tuple[F64, F64],
    unseen: tuple[F64, F64],
    sampling: tuple[float, float, float],
) -> _Pose:
    """Fit all SUs around one pose; SUs with the same valid samples share one factorisation."""
    independence, rate, cutoff = sampling
    U, n = y.shape[1], X.shape[1]
    coefficients = np.zeros((U, n, 3))
    information = np.zeros((U, n, n))
    deviation = np.full((U, 3), np.inf)
    numerator, denominator = np.zeros(U), np.zeros(U)
    patterns: dict[bytes, list[int]] = {}
    for u in range(U):
        patterns.setdefault(ok[:, u].tobytes(), []).append(u)
    for members in patterns.values():
        use = ok[:, members[0]]
        if not enough(use, rate):
            continue
        Xe = excited(X[use], noise[0])
        Ze = Z[use]
        result = fit(Design(Xe, Ze, *noise), y[use][:, members], independence)
        coefficients[members] = result.coefficients
        factor = noise_by_row(Xe, result.residual, rate, cutoff, independence)
        root = np.sqrt(factor)
        information[members] = result.information / (root[:, :, None] * root[:, None, :])
        deviation[members] = np.hypot(result.deviation, _MODEL_NOISE)
        fitted = np.zeros((len(use), len(members), 3))
        fitted[use] = y[use][:, members] - result.residual
        slope = first_derivative(fitted, rate)
        slope = slope[use] * eroded(use, 5)[use, None, None]
        basis, _ = np.linalg.qr(np.concatenate([Xe, Ze], axis=1))
        flat = slope.reshape(len(slope), -1)
        across = (flat - basis @ (basis.T @ flat)).reshape(slope.shape)
        weight = 1 / deviation[members] ** 2
        numerator[members] = -np.einsum("nui,nui,ui->u", result.residual, across, weight)
        denominator[members] = np.einsum("nui,nui,ui->u", across, across, weight)
    scale = independence
    return _Pose(
        q, log, coefficients, information, deviation, *unseen,
        numerator * scale, denominator * scale,
    )  # fmt: skip


def _latency_step(poses: Sequence[_Pose]) -> tuple[F64, F64]:
    """Change of each SU's latency [s] and its standard deviation."""
    numerator = np.sum([p.lag_numerator for p in poses], axis=0)
    denominator = np.sum([p.lag_denominator for p in poses], axis=0)
    sd = np.where(denominator > 0, 1 / np.sqrt(np.maximum(denominator, 1e-300)), np.inf)
    step = np.divide(numerator, denominator, out=np.zeros_like(sd), where=denominator > 0)
    # A large lag leaves large residuals, hence a large sd: a step of many sd is real all the same.
    known = (sd < 3e-4) | (np.abs(step) > 5 * sd)
    return np.where(known, np.clip(step, -0.03, 0.03), 0.0), np.where(known, sd, np.inf)


def _regressor_noise(motion: Motion, cutoff: float) -> tuple[F64, F64]:
    """Variances (1 + 2 D,) of encoder noise in the filtered regressors, covariances (D,)."""
    f = np.linspace(0.0, 2 * cutoff, 400)
    taps = low_pass(cutoff, motion.grid.rate)
    k = np.arange(len(taps))
    gain = np.abs(np.exp(-2j * np.pi * f[:, None] * k / motion.grid.rate) @ taps) ** 2
    density = 2 * motion.noise**2 / motion.raw_rate
    position = np.trapezoid(gain, f) * density
    acceleration = np.trapezoid(gain * (2 * np.pi * f) ** 4, f) * density
    both = -np.trapezoid(gain * (2 * np.pi * f) ** 2, f) * density
    return np.concatenate([[0.0], position, acceleration]), both


def static_moves(sampled: Sequence[Sampled]) -> StaticMoves:
    """Readings at rest before and after a single DoF moved (paper II-B.1)."""
    dofs, distances, changes, doubts = [], [], [], []
    for s in sampled:
        span = np.ptp(s.motion.q, axis=0)
        small = np.minimum(0.03, np.maximum(0.03 * span, 1e-4))
        for a, b in zip(s.rests[:-1], s.rests[1:], strict=True):
            step = b.q - a.q
            moved = np.flatnonzero(np.abs(step) > small)
            if len(moved) != 1 or abs(step[moved[0]]) < 3 * small[moved[0]]:
                continue
            before, after = _mean(s, a), _mean(s, b)
            dofs.append(int(moved[0]))
            distances.append(float(step[moved[0]]))
            changes.append(after - before)
            others = np.abs(step).sum() - abs(step[moved[0]])
            doubts.append(STANDARD_GRAVITY * float(others))
    U = sampled[0].readings.shape[1]
    return StaticMoves(
        np.array(dofs, dtype=np.int64),
        np.array(distances),
        np.array(changes).reshape(-1, U, 3),
        np.array(doubts),
    )


def _mean(s: Sampled, rest: Rest) -> F64:
    """(U, 3) mean readings over a rest, NaN where an SU has no valid sample."""
    trim = min(12, (rest.end - rest.begin) // 4)
    part = slice(rest.begin + trim, rest.end - trim)
    whole = np.asarray(s.valid[part].all(axis=0))
    return np.where(whole[:, None], s.readings[part].mean(axis=0), np.nan)
