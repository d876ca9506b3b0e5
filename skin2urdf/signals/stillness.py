"""Positions of joints that stay where they are, without what their encoders toggle.

An encoder that rounds goes to and fro between two counts while its joint is moved by less. Twice
differentiated, that is more than all sensors' noise together, on every link beyond it. What the
joint really does meanwhile is within a step, and told by no reading of it; so it is taken as slow.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.signals.filters import eroded, filtered, first_derivative
from skin2urdf.signals.motion import Motion

MOVING = 20.0
"""Encoder steps per second from which a joint moves; below, rounding does not average out [1/s]."""
_SPAN = 1.0
"""Time over which positions of joints that stay are averaged [s]: that of a slow swing, and of a
short rest."""


def without_toggling(motion: Motion, taps: F64) -> tuple[F64, F64]:
    """Average positions over a second where a joint stays within its encoder's steps.

    Args:
        motion: N samples of D joints on the grid.
        taps: the low-pass of the positions that a joint's speed is told from.

    Returns:
        (N, D) positions [rad or m], and (N, D) the share of what encoders round off that is left in
        them: all while a joint moves, and from there to where averages are whole ever less.
    """
    speed = np.abs(first_derivative(filtered(motion.q, taps), motion.grid.rate))
    share = averaged_share(speed, motion.resolution, motion.grid.rate)
    return with_averages(motion.q, share, motion.grid.rate), 1 - share


def averaged_share(speed: F64, resolution: F64, rate: float) -> F64:
    """(N, D) share that averages have in positions: all where a joint stays, none where it moves.

    Args:
        speed: (N, D) of the joints, low-passed [rad/s or m/s].
        resolution: (D,) smallest step of each encoder [rad or m], 0 for none.
        rate: samples per second [Hz].
    """
    out, window = np.zeros(speed.shape), _window(rate)
    for d in np.flatnonzero(resolution > 0):
        still = eroded(speed[:, d] < MOVING * resolution[d], len(window))
        if still.any():
            out[:, d] = filtered(still.astype(np.float64)[:, None], window)[:, 0]
    return out


def with_averages(q: F64, share: F64, rate: float) -> F64:
    """Positions (N, D) of which averages over a second have a share (N, D).

    Args:
        q: positions [rad or m].
        share: of the averages.
        rate: samples per second [Hz].
    """
    some = share.any(axis=0)
    if not some.all():
        out = np.array(q)
        if some.any():
            out[:, some] = with_averages(q[:, some], share[:, some], rate)
        return out
    out = filtered(q, _window(rate))
    out -= q
    out *= share
    out += q
    return out


def _window(rate: float) -> F64:
    """(n,) weights of an average over a second."""
    n = max(3, round(_SPAN * rate) | 1)
    window = np.hanning(n + 2)[1:-1]
    return np.asarray(window / window.sum())
