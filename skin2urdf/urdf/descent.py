"""Least squares by Gauss-Newton, with steps that are damped until they lead down (Marquardt 1963).

What residuals hardly tell would be moved far by a plain step, to where nothing linear holds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from skin2urdf.arrays import F64

S = TypeVar("S")
_MAX_STEPS = 30
_FIRST_DAMPING, _MOST_DAMPING = 1e-6, 1e3
"""Share of its own information by which a step is held, once it does not lead down at once: from a
thousandth of its length on."""
_ARRIVED = 1e-12
"""Part of the cost below which a step gains nothing."""
_EXACT = 1e-10
"""Residual, rms, that is none [m]: rounding leaves as much."""


def descended(
    here: S,
    left: Callable[[S], F64],
    linear: Callable[[S, F64], tuple[F64, Callable[[F64], S]]],
) -> tuple[S, float]:
    """Where the sum of squares is least, from a first state on.

    Args:
        here: the first state.
        left: tells the residuals of a state, of any shape [m].
        linear: tells of a state and its residuals the derivatives (n, k) of what k numbers take off
            the n residuals, and what makes the state that such numbers (k,) lead to.

    Returns:
        The state, and its sum of squares.
    """
    r = left(here)
    cost, damping = float(np.sum(r**2)), 0.0
    for _ in range(_MAX_STEPS):
        if cost <= _EXACT**2 * r.size:
            break
        A, moved = linear(here, r)
        held = np.sqrt(damping) * np.diag(np.linalg.norm(A, axis=0))
        rows, values = np.vstack([A, held]), np.append(r.reshape(-1), np.zeros(A.shape[1]))
        there = moved(np.linalg.lstsq(rows, values, rcond=1e-10)[0])
        r_there = left(there)
        cost_there = float(np.sum(r_there**2))
        if cost_there < cost:
            arrived = cost - cost_there <= _ARRIVED * cost
            here, r, cost = there, r_there, cost_there
            damping *= 0.1
            if arrived:
                break
        elif damping > _MOST_DAMPING:
            break
        else:
            damping = max(10 * damping, _FIRST_DAMPING)
    return here, cost
