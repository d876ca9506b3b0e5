"""Which joints turn which SUs, from gyroscopes around poses.

Around a pose an SU turns by ``w = sum over joints d of w_d qd_d`` with constant w_d: a unit vector
for a revolute joint that carries the SU, nothing for any other. Whatever the axes of a gyroscope
are, and wherever gravity points, the regression of its rates on all joints' velocities tells one
from the other by the length of w_d alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.signals.filters import filtered, low_pass, noise_bandwidth, shifted
from skin2urdf.signals.records import Turns
from skin2urdf.signals.sampling import Sampled

_STILL = 1e-2
"""Velocity of a joint [rad/s] below which it says nothing: what it turns by then is noise."""


def turn_evidence(sampled: Sequence[Sampled], lag: F64) -> Turns | None:
    """Regress what gyroscopes read around all poses on the velocities of all joints.

    Args:
        sampled: the logs.
        lag: (U,) by how much each SU's stamps are late [s].

    Returns:
        None where no SU has a gyroscope.
    """
    if all(s.turning is None for s in sampled):
        return None
    U, D = len(lag), len(sampled[0].motion.dof_names)
    square, fourth, weight = np.zeros((U, D)), np.zeros((U, D)), np.zeros((U, D))
    for s in sampled:
        if s.turning is None:
            continue
        rate = s.motion.grid.rate
        taps = low_pass(s.cutoff, rate)
        independence = min(1.0, 2 * noise_bandwidth(taps, rate) / rate)
        speed = filtered(s.motion.qd, taps)
        for u in np.flatnonzero(s.turning.valid.any(axis=0)):
            turn = filtered(shifted(s.turning.rates[:, u], rate, lag[u]), taps)
            for pose in s.neighbourhoods:
                at = np.concatenate([np.arange(a, b) for a, b in pose.windows])
                at = at[s.turning.valid[at, u]]
                found = _axes(speed[at], turn[at], independence)
                if found is not None:
                    size2, variance = found
                    square[u] += size2 / variance
                    fourth[u] += size2**2 / variance
                    weight[u] += 1 / variance
    known = weight > 0
    mean = np.divide(square, weight, out=np.full((U, D), np.nan), where=known)
    some = np.where(known, weight, 1.0)
    # Poses that contradict each other, as where SUs exchanged their names, tell nothing together.
    scatter = np.sqrt(np.maximum(fourth / some - (square / some) ** 2, 0.0))
    sd = np.where(known, np.hypot(1 / np.sqrt(some), scatter), np.inf)
    return Turns(np.sqrt(np.maximum(mean, 0.0)), sd)


def _axes(speed: F64, turn: F64, independence: float) -> tuple[F64, F64] | None:
    """Squared lengths (D,) of w_d without what noise adds to them, and variances (D,) per axis.

    Args:
        speed: (N, D) velocities of the joints.
        turn: (N, 3) rates.
        independence: independent samples per sample.
    """
    N, D = speed.shape
    if N * independence < D + 2:
        return None
    X = np.concatenate([np.ones((N, 1)), speed], axis=1)
    products = X.T @ X
    # Of joints that hardly move nothing is known, and nothing is taken for theirs.
    products[range(1, D + 1), range(1, D + 1)] += N * _STILL**2
    inverse = np.linalg.inv(products)
    w = inverse @ (X.T @ turn)
    left = turn - X @ w
    freedom = max(N * independence - D - 1, 1.0)
    noise2 = float((left**2).sum()) * independence / (3 * freedom)
    own = np.diag(inverse)[1:]
    variance = noise2 * own / independence
    # Lengths are shortened by as much as a joint hardly moves, which is no knowledge of them.
    return (w[1:] ** 2).sum(axis=1) - 3 * variance, variance + N * _STILL**2 * own
