"""Sensors as they are made: what would need other errors is no sensor, but a wrong model."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.estimation.problem.state import State

IMPLAUSIBLE_SHAPE = 0.2
"""Scale or cross-axis error [1] that no working sensor has."""
IMPLAUSIBLE_BIAS = 4.0
"""Bias [m/s^2] that no working sensor has."""


def are_plausible(state: State) -> Bool:
    """(U,) whether each sensor has a bias, scale and cross-axis errors as working sensors have."""
    shape, bias = (np.abs(x).max(axis=1, initial=0.0) for x in (state.shape, state.bias))
    return np.asarray((shape <= IMPLAUSIBLE_SHAPE) & (bias <= IMPLAUSIBLE_BIAS))
