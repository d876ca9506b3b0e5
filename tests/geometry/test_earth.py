"""Gravity on Earth against tabulated values."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.geometry.earth import normal_gravity


@pytest.mark.parametrize(
    ("latitude", "height", "expected"),
    [(0.0, 0.0, 9.78033), (45.0, 0.0, 9.80620), (90.0, 0.0, 9.83219), (48.15, 520.0, 9.80743)],
)
def test_normal_gravity_is_that_of_tables(latitude: float, height: float, expected: float) -> None:
    assert normal_gravity(np.deg2rad(latitude), height) == pytest.approx(expected, abs=3e-5)
