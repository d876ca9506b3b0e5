"""Spread of sensor errors learnt from all SUs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrated import calibration

from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.solve.spread import learnt_hidden, learnt_priors, spread


def test_the_next_member_is_as_far_out_as_said() -> None:
    """Few members, seen through noise: squared errors over the stated variance average 1."""
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(400):
        noise = rng.uniform(0.1, 0.6, 20)
        size = spread(rng.normal(0.0, np.hypot(2.0, noise)), noise**2)
        ratios.append((rng.normal(0.0, 2.0, 50) / size) ** 2)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.06)


def test_noise_alone_has_hardly_any_spread() -> None:
    rng = np.random.default_rng(1)
    found = [spread(rng.normal(0.0, 0.5, 18), np.full(18, 0.25)) for _ in range(100)]
    assert np.median(found) < 0.25
    assert np.mean(np.square(found)) < 0.25**2
    assert np.count_nonzero(found) < 8


def test_priors_are_narrowed_to_the_sensors_and_never_widened() -> None:
    """MEMS sensors of 5 mg bias and no scale error under priors of 50 mg and 3 %."""
    found = calibration().estimate
    assert (found.given.bias, found.given.scale) == (Priors().bias, Priors().scale)
    learnt = found.cost.priors
    assert 0.005 < learnt.bias < 0.1
    assert learnt.scale < 0.3 * Priors().scale
    assert learnt.hidden is not None
    assert learnt.hidden <= learnt.cross
    again = learnt_priors(found.cost, found.state, found.free)
    assert again.bias <= learnt.bias
    assert again.scale <= learnt.scale


def test_hidden_rotations_are_learnt_with_the_variances_that_are_stated() -> None:
    """Cross-axis terms that are as large as what is stated of their errors may be none."""
    found = calibration().estimate
    rng = np.random.default_rng(2)
    features, stated = np.full((found.tree.n_sus, 15), 1e-10), np.full((found.tree.n_sus, 15), 1e-8)
    shape = rng.normal(0.0, 1e-4, found.state.shape.shape)
    state = replace(found.state, shape=shape)
    priors = replace(found.cost.priors, cross=1e-2, hidden=None)
    assert learnt_hidden(priors, state, features, found.free) > 5e-5
    assert learnt_hidden(priors, state, stated, found.free) < 6e-5
    # That they do not stand out does not tell that there are none.
    assert learnt_hidden(priors, state, stated, found.free) > 1e-5
    # Where data determine too few, what is known before speaks.
    assert learnt_hidden(priors, state, np.ones_like(stated), found.free) == 1e-2
