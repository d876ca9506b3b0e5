"""Samples that a stream lost inside a pose's window, from what the rest of the window says.

All features rest on low-passed signals, so a sample that is missing would take its neighbours
within the filter's reach along. Around a pose the reading is a short series in the motion of the
joints, whose coefficients the samples that are there determine: what is missing is computed from
them (the E-step of an EM algorithm, whose fixed point is the fit to the samples that are there).
Computed samples bring no information; the features' noise allows for their share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.recording.shelf import copy_of_streams, put_away
from skin2urdf.signals.filters import (
    filtered,
    first_derivative,
    low_pass,
    second_derivative,
)
from skin2urdf.signals.motion import Motion
from skin2urdf.signals.poses import Neighbourhood

_LEAST = 0.3
"""Share of a window's samples that must be there."""
_SAMPLES_PER_COLUMN = 5
"""Measured samples for each regressor that missing ones are computed from, at least."""
_LEVERAGE = 0.5
"""Variance of a computed sample, over that of a measured one, from which it stays missing."""
_STILL = 1e-6
"""Excursion of a joint [rad or m] that is none."""


def computed(
    motion: Motion,
    neighbourhoods: Sequence[Neighbourhood],
    cutoff: float,
    readings: F64,
    valid: Bool,
) -> tuple[F64, Bool]:
    """Readings with missing samples computed where that is possible.

    Args:
        motion: joint motion, N samples.
        neighbourhoods: the poses.
        cutoff: low-pass cutoff that suits the patterns [Hz].
        readings: (N, U, 3) readings [m/s^2].
        valid: (N, U) False where they are missing.

    Returns:
        (N, U, 3) readings, and (N, U) True where they were computed.
    """
    new, done = readings, np.zeros_like(valid)
    windows = [w for pose in neighbourhoods for w in pose.windows]
    torn = [(a, b, _torn(valid[a:b])) for a, b in windows]
    if not any(len(sus) for _, _, sus in torn):
        return new, done
    new = copy_of_streams(readings)
    rate = motion.grid.rate
    q = filtered(motion.q, low_pass(cutoff, rate))
    qd, qdd = first_derivative(q, rate), second_derivative(q, rate)
    excursion = np.maximum(_STILL, 3 * motion.resolution)
    for a, b, sus in torn:
        part = slice(a, b)
        moving = np.ptp(q[part], axis=0) > excursion
        for alike in map(np.array, _alike(valid[part], sus)):
            ok = valid[part, alike[0]]
            X = _series(q[part, moving], qd[part, moving], qdd[part, moving], int(ok.sum()))
            if X is None:
                continue
            prediction, leverage = _fitted(X, readings[part][:, alike], ok)
            here = a + np.flatnonzero(~ok)[leverage < _LEVERAGE]
            new[np.ix_(here, alike)] = prediction[leverage < _LEVERAGE]
            done[np.ix_(here, alike)] = True
        put_away(readings, new)
    return new, done


def _torn(valid: Bool) -> list[int]:
    """SUs with some samples of a window (N, U) missing, but not most of them."""
    share = valid.mean(axis=0) if len(valid) else np.ones(valid.shape[1])
    return [int(u) for u in np.flatnonzero((share >= _LEAST) & (share < 1.0))]


def _alike(valid: Bool, sus: Sequence[int]) -> list[list[int]]:
    """SUs grouped by the samples of a window (N, U) that they lack."""
    groups: dict[bytes, list[int]] = {}
    for u in sus:
        groups.setdefault(valid[:, u].tobytes(), []).append(u)
    return list(groups.values())


def _series(q: F64, qd: F64, qdd: F64, samples: int) -> F64 | None:
    """Regressors to second order, None where the samples are too few for them.

    All pairs of joints have their products where that leaves samples enough, else each joint alone.
    """
    most, n = samples // _SAMPLES_PER_COLUMN, q.shape[1]
    if most < 1 + 4 * n:
        return None
    dq = q - q.mean(axis=0, keepdims=True)
    pairs = most >= 1 + 2 * n + n * (n + 1)
    i, j = np.triu_indices(n) if pairs else (np.arange(n), np.arange(n))
    second = [dq[:, i] * dq[:, j], qd[:, i] * qd[:, j]]
    return np.concatenate([np.ones((len(q), 1)), dq, qdd, *second], axis=1)


def _fitted(X: F64, y: F64, ok: Bool) -> tuple[F64, F64]:
    """Missing samples as those that are there predict them, and their leverage.

    Args:
        X: (N, k) regressors.
        y: (N, U, 3) readings.
        ok: (N,) False for the M samples that are missing.

    Returns:
        (M, U, 3) and (M,).
    """
    scale = np.sqrt((X[ok] ** 2).mean(axis=0))
    known = scale > 1e-9
    Z = X[:, known] / scale[known]
    there, missing = Z[ok], Z[~ok]
    # What the missing samples alone would tell must show in the leverage, not be projected away.
    ridge = 1e-6 * len(there) * np.eye(Z.shape[1])
    effect = np.linalg.solve(there.T @ there + ridge, missing.T).T
    prediction = np.tensordot(effect @ there.T, y[ok], 1)
    beyond = np.abs(X[~ok][:, ~known]).max(axis=1, initial=0.0) > 1e-6
    return prediction, np.where(beyond, np.inf, np.einsum("ni,ni->n", effect, missing))
