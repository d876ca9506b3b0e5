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
    n = max(3, round(_SPAN * motion.grid.rate) | 1)
    window = np.hanning(n + 2)[1:-1]
    window /= window.sum()
    speed = np.abs(first_derivative(filtered(motion.q, taps), motion.grid.rate))
    out, left = np.array(motion.q), np.ones(motion.q.shape)
    for d in np.flatnonzero(motion.resolution > 0):
        still = eroded(speed[:, d] < MOVING * motion.resolution[d], n)
        if still.any():
            share = filtered(still.astype(np.float64)[:, None], window)[:, 0]
            slow = filtered(motion.q[:, d : d + 1], window)[:, 0]
            out[:, d] += share * (slow - motion.q[:, d])
            left[:, d] -= share
    return out, left
