"""The clock of an SU by how much it is moved when: for motion of many joints at once, and far.

Where all joints move at once by large angles, no stretch of seconds is linear in their motion. How
fast the readings change goes with how fast the joints are, all the same, by factors that hold for
the whole log: gravity turns past the sensor as fast as it turns. So the size of the readings'
change is regressed on the speeds of the joints over the whole log, for every offset and drift, and
what explains it best is refined by Gauss-Newton.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from skin2urdf.arrays import F64, Bool
from skin2urdf.signals.profiles import valley

WINDOW = 8.0
"""Windows in which one lag stands for a drift [s]: its ends are 80 ms apart, a part of a move."""
_SLOWEST = 0.5
"""Change of the readings [m/s^3 rms] that motion makes at the least: gravity at 0.05 rad/s, below
which joints count as resting."""
_DECISIVE = 0.5
"""Share of what any lag elsewhere leaves that the right one leaves at most. Of 34 SUs in pick and
place, patterns and single moves it left 0.46 and less; wrong ones 0.73 and more, where all joints
move on without rest and speeds explain little."""
_ALIKE = 0.15
"""Correlation of what speeds leave unexplained with what a lag makes, by which errors that come
back with the motion may shift an offset. In 55 SUs of ten logs of five kinds of motion its root of
the mean square was 0.10, and its largest 0.35, where motion repeats."""
_LARGEST = 0.999
"""Quantile of the changes beyond which they are shocks."""
DEPENDENT = 1e-6
"""Relative size of a combination of speeds that is none."""


def speeds(q: F64, rate: float) -> F64:
    """(n, K) regressors: a constant, speeds of the joints, of all together, and their jerks.

    Args:
        q: (n, D) joint positions [rad or m].
        rate: samples per second [Hz].
    """
    qd = slope(q, rate)
    jerk = np.abs(slope(slope(qd, rate), rate))
    together = np.linalg.norm(qd, axis=1, keepdims=True)
    columns = np.concatenate([np.ones((len(q), 1)), np.abs(qd), together, jerk], axis=1)
    size = np.sqrt((columns**2).sum(axis=0))
    return np.asarray(columns[:, size > 0] / size[size > 0])


def slope(values: F64, rate: float) -> F64:
    """Derivative of (n, C) samples by central differences, 0 at the ends."""
    out = np.zeros_like(values)
    out[1:-1] = (values[2:] - values[:-2]) * (rate / 2)
    return out


def change(readings: F64, valid: Bool, rate: float) -> F64 | None:
    """(n,) size of the readings' change [m/s^3], 0 where they are missing; None without motion.

    Args:
        readings: (n, 3) means [m/s^2].
        valid: (n,) where they are whole.
        rate: samples per second [Hz].
    """
    whole = valid.copy()
    whole[1:] &= valid[:-1]
    whole[:-1] &= valid[1:]
    whole[[0, -1]] = False
    size = np.linalg.norm(slope(readings, rate), axis=1) * whole
    size = np.minimum(size, np.quantile(size, _LARGEST))
    return size if float(np.sqrt(np.mean(size**2))) > _SLOWEST else None


def searched(
    size: F64, regressors: F64, rate: float, reach: float, steep: float
) -> tuple[float, float] | None:
    """Offset [s] and drift at which speeds explain the readings' change best.

    Args:
        size: (n,) change of the readings.
        regressors: (n, K) speeds.
        rate: samples per second [Hz].
        reach: largest offset [s].
        steep: largest drift.

    Returns:
        None where no lag stands out.
    """
    length = int(WINDOW * rate)
    count = len(size) // length
    if count < 2:
        return None
    n = count * length
    most = int(np.ceil((reach + steep * n / (2 * rate)) * rate)) + 2
    lags = np.arange(-most, most + 1)
    values, vectors = np.linalg.eigh(regressors[:n].T @ regressors[:n])
    kept = values > DEPENDENT * values[-1]
    basis = regressors[:n] @ (vectors[:, kept] / np.sqrt(values[kept]))
    padded = np.pad(size, most)
    segment = np.stack([padded[w * length : (w + 1) * length + 2 * most] for w in range(count)])
    fast = next_fast_len(segment.shape[1], real=True)
    shape = np.conj(rfft(basis.reshape(count, length, -1), fast, axis=1))
    products = irfft(rfft(segment, fast, axis=1)[:, :, None] * shape, fast, axis=1)[:, : len(lags)]
    squares = np.pad(np.cumsum(segment**2, axis=1), ((0, 0), (1, 0)))
    energy = squares[:, length:] - squares[:, :-length]
    time = (np.arange(count) + 0.5) * length - len(size) / 2
    inner = np.flatnonzero(np.abs(lags) <= reach * rate)
    rows, steps = np.arange(count)[:, None], max(int(np.ceil(steep * n / 2)), 1)
    best, found, profile = np.inf, (0.0, 0.0), np.full(len(inner), np.inf)
    for k in range(-steps, steps + 1):
        drift = steep * k / steps
        index = np.clip(inner + np.rint(drift * time).astype(int)[:, None], 0, len(lags) - 1)
        explained = (products[rows, index].sum(axis=0) ** 2).sum(axis=1)
        left = energy[rows, index].sum(axis=0) - explained
        profile = np.minimum(profile, left)
        i = int(left.argmin())
        if left[i] < best:
            best, found = float(left[i]), (float(lags[inner[i]] / rate), drift)
    first, last = valley(profile)
    elsewhere = np.delete(profile, np.s_[first : last + 1])
    return found if best < _DECISIVE * elsewhere.min(initial=np.inf) else None


def refined(size: F64, regressors: F64, rate: float) -> tuple[F64, F64, int] | None:
    """Change of offset [s] and drift that explains more, their (2,) deviations, and those' freedom.

    The deviations are those of windows that are independent of each other, whatever their errors
    are made of. Errors that come back with the motion, as in one that repeats, are in the offset's.

    Args:
        size: (n,) change of the readings, taken at the lag found so far.
        regressors: (n, K) speeds.
        rate: samples per second [Hz].
    """
    n = len(size)
    time = (np.arange(n) - n / 2) / rate
    # Of what speeds explain: the slope of readings is that of their noise as well, which would make
    # an offset look far better known than it is, and every step too short.
    explained = regressors @ (np.linalg.pinv(regressors, rcond=DEPENDENT) @ size)
    late = slope(explained[:, None], rate)
    X = np.concatenate([late, late * time[:, None], regressors], axis=1)
    scale = np.sqrt((X**2).sum(axis=0))
    if not scale.all():
        return None
    inverse = np.linalg.pinv((X / scale).T @ (X / scale), rcond=DEPENDENT)
    solution = inverse @ ((X / scale).T @ size)
    residual = size - (X / scale) @ solution
    length = int(WINDOW * rate)
    scores = np.add.reduceat((X / scale) * residual[:, None], np.arange(0, n, length), axis=0)
    freedom = max(len(scores) - 4, 1)
    covariance = inverse @ (scores.T @ scores) @ inverse * (len(scores) / freedom)
    variance = np.diag(covariance)[:2].copy()
    variance[0] += _ALIKE**2 * (residual @ residual) * inverse[0, 0]
    return -solution[:2] / scale[:2], np.sqrt(variance) / scale[:2], freedom
