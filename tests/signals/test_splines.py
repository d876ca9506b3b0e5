"""Splines through samples: against SciPy's, and where they end."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from skin2urdf.signals.filters import Spline


def test_a_spline_is_that_of_scipy() -> None:
    rng = np.random.default_rng(0)
    values = rng.standard_normal((200, 3))
    at = rng.uniform(60, 140, 500)
    expected = make_interp_spline(np.arange(200), values, k=5)(at)
    # They differ by how they end, of which nothing is left after some tens of samples.
    np.testing.assert_allclose(Spline(values).at(at), expected, atol=1e-9)


def test_a_spline_goes_through_its_samples_and_no_further() -> None:
    values = np.random.default_rng(1).standard_normal((50, 2))
    spline = Spline(values)
    np.testing.assert_allclose(spline.at(np.arange(50.0)), values, atol=1e-9)
    assert np.isnan(spline.at(np.array([-0.1, 49.1]))).all()
    assert np.isfinite(spline.at(np.array([0.0, 49.0]))).all()


@pytest.mark.parametrize("by", [0.39, -0.58, 2.0, 112.5, -200.0])
def test_all_samples_later_are_each_of_them_later(by: float) -> None:
    values = np.random.default_rng(2).normal(size=(80, 3))
    spline = Spline(values)
    at = np.clip(np.arange(80) + by, 0, 79)
    assert spline.later(by) == pytest.approx(spline.within(at), abs=1e-12)
