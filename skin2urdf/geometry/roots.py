"""Where a function of one number is zero; scipy.optimize takes 0.1 s to load for it."""

from __future__ import annotations

import sys
from collections.abc import Callable


def root(f: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Where a continuous function is zero, by halves and inverse quadratics (Chandrupatla 1997).

    Args:
        f: the function.
        low: where it has one sign, and
        high: where it has the other.
        tolerance: by how much the result may be off, beside rounding.

    Raises:
        ValueError: it has the same sign at both ends.
    """
    a, b = low, high
    fa, fb = f(a), f(b)
    if fa * fb > 0:
        raise ValueError(f"no change of sign between {low} and {high}")
    share = 0.5
    while True:
        x = a + share * (b - a)
        fx = f(x)
        if (fx > 0) == (fa > 0):
            c, fc = a, fa
        else:
            c, fc, b, fb = b, fb, a, fa
        a, fa = x, fx
        best, least = (a, fa) if abs(fa) < abs(fb) else (b, fb)
        near = 2 * sys.float_info.epsilon * abs(best) + 0.5 * tolerance
        if least == 0 or abs(b - a) <= 2 * near:
            return best
        share = 0.5
        xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
        if phi**2 < xi and (1 - phi) ** 2 < 1 - xi:
            share = fa / (fb - fa) * fc / (fb - fc)
            share += (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        least_share = near / abs(b - a)
        share = min(max(share, least_share), 1 - least_share)
