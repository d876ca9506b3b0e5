"""What the encoders' resolution does to regressors and coefficients."""

from __future__ import annotations

import numpy as np
from scipy.special import j1

from skin2urdf.arrays import F64, Bool
from skin2urdf.signals.filters import low_pass
from skin2urdf.signals.motion import Motion

_MOVES = 7.5e-7
"""Mean square acceleration, weighted by itself, from which a DoF moves [rad^2/s^4 or m^2/s^4]."""
_SLOWEST = 0.25
"""Frequency from which motion is a pattern [Hz]."""
_LOUD = 0.01
"""Power over the largest from which a frequency belongs to a pattern."""
_ONE_TONE = 0.1
"""Relative spread of the squared frequencies up to which a pattern has one tone."""


def regressor_noise(motion: Motion, cutoff: float) -> tuple[F64, F64]:
    """Variances (1 + 2 D,) of encoder noise in the filtered regressors, covariances (D,)."""
    f = np.linspace(0.0, 2 * cutoff, 400)
    taps = low_pass(cutoff, motion.grid.rate)
    k = np.arange(len(taps))
    gain = np.abs(np.exp(-2j * np.pi * f[:, None] * k / motion.grid.rate) @ taps) ** 2
    density = motion.noise_density
    position = np.trapezoid(gain, f) * density
    acceleration = np.trapezoid(gain * (2 * np.pi * f) ** 4, f) * density
    both = -np.trapezoid(gain * (2 * np.pi * f) ** 2, f) * density
    return np.concatenate([[0.0], position, acceleration]), both


def rest_pull(X: F64, moving: Bool) -> F64:
    """What a change of the readings while a joint rests does to all coefficients, per its mean.

    A pattern that swings to one side of the pose leaves f0 to the few samples at rest.

    Args:
        X: (N, 1 + 2 D) regressors; columns that are not excited are zero.
        moving: (N, D) True where a joint passes many encoder steps between samples.

    Returns:
        (D, 1 + 2 D); f0 alone where a joint rests all the time, or never.
    """
    out = np.tile(np.eye(X.shape[1])[0], (moving.shape[1], 1))
    size = np.sqrt((X**2).sum(axis=0))
    used = np.flatnonzero(size > 0)
    share = 1 - moving.mean(axis=0)
    some = np.flatnonzero((share > 0) & (share < 1))
    if len(used) > 1 and len(some):
        resting = ~moving[:, some] / share[some]
        found = np.linalg.lstsq(X[:, used] / size[used], resting, rcond=1e-5)[0]
        out[some] = 0.0
        out[np.ix_(some, used)] = (found / size[used, None]).T
    return out


def hidden_motion(dq: F64, qdd: F64, resolution: F64) -> tuple[F64, F64]:
    """Motion that encoders round away in step with a DoF's pattern, relative to the pattern.

    While DoF d moves, others move along a little (coupling, sag). What rounding makes of such a
    motion repeats in every cycle and so does not average out (:func:`rounded_away`).

    Args:
        dq: (N, D) low-passed positions [rad or m].
        qdd: (N, D) low-passed accelerations.
        resolution: (D,) encoder steps [rad or m].

    Returns:
        (D, D) mean square hidden motion of joint e per mean square acceleration of DoF d, at
        [d, e], and (D,) squared angular frequencies of the patterns; 0 for DoFs that do not move.
    """
    energy = qdd**2
    total = energy.sum(axis=0)
    weight = np.divide(energy, total, out=np.zeros_like(energy), where=total > 0)
    while_moving = weight.T @ energy
    # A sine's fourth moment over its second is 3/4 of its squared amplitude.
    peak2 = np.diag(while_moving)[:, None] / 0.75
    moves = _moves(qdd)[:, None]
    against = -((dq - dq.mean(axis=0)) * qdd).sum(axis=0)
    omega2 = np.divide(total, against, out=np.zeros_like(total), where=moves[:, 0] & (against > 0))
    peak = np.sqrt(while_moving / 0.75)
    along = np.divide(peak, omega2[:, None], out=np.zeros_like(peak), where=omega2[:, None] > 0)
    steps = np.divide(along, resolution, out=np.zeros_like(along), where=resolution > 0)
    hidden = rounded_away(steps) * resolution**2
    return np.divide(hidden, peak2, out=np.zeros_like(hidden), where=moves), omega2


def pattern_products(dq: F64, qdd: F64) -> F64:
    """(2 D, 2 D) products of positions about their mean and accelerations, summed over samples.

    Args:
        dq: (N, D) low-passed positions [rad or m].
        qdd: (N, D) low-passed accelerations; those of DoFs without a pattern are 0.
    """
    both = np.concatenate([(dq - dq.mean(axis=0)) * qdd.any(axis=0), qdd], axis=1)
    return np.asarray(both.T @ both)


def tones(qdd: F64, rate: float, cutoff: float) -> F64:
    """Two tones that stand for the spectrum of each DoF's pattern (Gaussian quadrature).

    Their first four moments in the squared frequency are those of the pattern. That is as exact as
    the features need it, for a pattern enters them as its position and its acceleration.

    Args:
        qdd: (N, D) low-passed accelerations.
        rate: samples per second [Hz].
        cutoff: of the low-pass [Hz].

    Returns:
        (D, 2) squared angular frequencies, the same twice for a single tone; 0 for DoFs that have
        no pattern.
    """
    f = np.fft.rfftfreq(len(qdd), 1 / rate)
    band = (f > _SLOWEST) & (f < 0.9 * cutoff)
    x = (2 * np.pi * f[band]) ** 2
    power = 2 * np.abs(np.fft.rfft(qdd, axis=0)[band] / len(qdd)) ** 2
    squares = np.zeros((qdd.shape[1], 2))
    for d in np.flatnonzero(_moves(qdd)):
        loud = power[:, d] > _LOUD * power[:, d].max(initial=0.0)
        if not loud.any():
            continue
        density, y = power[loud, d] / x[loud] ** 2, x[loud]
        total = float(density.sum())
        mean = float(density @ y) / total
        m2, m3 = (float(density @ (y - mean) ** k) / total for k in (2, 3))
        if m2 < _ONE_TONE**2 * mean**2:
            squares[d] = mean
            continue
        half, root = m3 / m2 / 2, np.sqrt((m3 / m2 / 2) ** 2 + m2)
        squares[d] = mean + half - root, mean + half + root
    return squares


def white_noise(qdd: F64, moving: Bool, variance: F64) -> F64:
    """Noise of the encoders while a DoF's pattern runs.

    The rounding of a joint that passes many steps is white noise. It is in the residuals, hence in
    the weights; but all SUs beyond the joint meet the same noise.

    Args:
        qdd: (N, D) low-passed accelerations.
        moving: (N, D) True where a joint passes many encoder steps between samples.
        variance: (D,) of the encoders' noise in one independent sample [rad^2 or m^2].

    Returns:
        (D, D) variance of joint e's noise weighted by the pattern of DoF d, at [d, e].
    """
    square = qdd**2
    total = square.sum(axis=0)[:, None]
    both = square.T @ moving
    share: F64 = np.divide(both, total, out=np.zeros_like(both), where=total > 0)
    return share * variance


def _moves(qdd: F64) -> Bool:
    """(D,) True for DoFs that have a pattern."""
    square = qdd**2
    return np.asarray((square**2).sum(axis=0) > _MOVES * square.sum(axis=0))


def rounded_away(steps: F64) -> F64:
    """Mean square error of a sine's amplitude [steps^2] after rounding, by its amplitude [steps].

    Rounding is a Fourier series in the rounded value. Over all positions of the sine's middle
    between two steps, the error of its amplitude a has the mean square
    ``sum_n 2 J1(2 pi n a)^2 / (pi n)^2``, near 0.012 / a for many steps. Below a quarter of a step,
    where the amplitude itself can not be known, the largest error is taken.
    """
    n = np.arange(1, 9)
    series = 2 * j1(2 * np.pi * n * np.maximum(steps, 0.25)[..., None]) ** 2 / (np.pi * n) ** 2
    return np.asarray(series.sum(axis=-1))
