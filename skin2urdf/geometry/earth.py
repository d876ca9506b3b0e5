"""Gravity on Earth."""

from __future__ import annotations

import numpy as np

_EQUATOR = 9.7803253359
"""Normal gravity at the equator [m/s^2] (WGS 84)."""
_SOMIGLIANA = 0.00193185265241
_ECCENTRICITY2 = 0.00669437999013
_FREE_AIR = 3.086e-6
"""Decrease with height [1/s^2]."""
ON_GROUND = 9.76, 9.84
"""Gravity anywhere on the ground is between these [m/s^2]: 9.7639 on Huascaran, 9.8337 on the
Arctic Ocean (Hirt et al. 2013)."""
ANOMALY = 5e-4
"""By how much gravity departs from the formula, as a standard deviation: 50 mGal, which is large
except in mountains [m/s^2]."""


def normal_gravity(latitude: float, height: float) -> float:
    """Magnitude of gravity at a place on Earth [m/s^2] (Somigliana's formula, WGS 84).

    Args:
        latitude: geodetic latitude [rad].
        height: above the sea [m].
    """
    sine2 = float(np.sin(latitude)) ** 2
    on_ellipsoid = _EQUATOR * (1 + _SOMIGLIANA * sine2) / np.sqrt(1 - _ECCENTRICITY2 * sine2)
    return float(on_ellipsoid - _FREE_AIR * height)
