"""Zeros of functions of one number."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from skin2urdf.geometry.roots import root


def test_roots_are_those_of_scipy() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        pole, power, at = rng.uniform(0.1, 9.0, 3)

        def f(x: float, pole: float = pole, power: float = power, at: float = at) -> float:
            return float((x + pole) ** -power - (at + pole) ** -power)

        assert root(f, 0.0, 20.0, 1e-12) == pytest.approx(brentq(f, 0.0, 20.0), abs=1e-11)


def test_a_root_at_an_end_is_found_and_one_that_is_not_there_is_missed() -> None:
    assert root(lambda x: x, 0.0, 3.0, 1e-9) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(ValueError, match="sign"):
        root(lambda x: x * x + 1.0, -1.0, 1.0, 1e-9)


def test_it_stops_where_a_function_jumps() -> None:
    assert root(lambda x: 1.0 if x > 0.7 else -1.0, 0.0, 1.0, 1e-9) == pytest.approx(0.7, abs=1e-8)
