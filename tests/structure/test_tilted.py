"""Gravity's direction over time as the SU feels it in which gravity turns least."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skin2urdf.arrays import F64
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.tilted import tilts_of_base

_RATE, _SUS = 100.0, 4
_TIME = np.arange(0, 60, 1 / _RATE)
_MOUNTED = Rotation.random(_SUS, random_state=1)
_MEAN = Rotation.from_euler("xy", [0.2, -0.1])


def _sampled(tilt: F64, on: int, lost: slice = slice(0)) -> Sampled:
    """SUs that turn with joints, but for one that stands on a base that tilts by angles (N,)."""
    rng = np.random.default_rng(2)
    readings = np.empty((len(_TIME), _SUS, 3))
    base = _MEAN * Rotation.from_rotvec(tilt[:, None] * [1.0, 0.0, 0.0])
    for u in range(_SUS):
        swing = 0.0 if u == on else 0.8
        joint = Rotation.from_rotvec(swing * np.sin(0.3 * _TIME + u)[:, None] * [0.0, 1.0, 0.0])
        readings[:, u] = (base * joint * _MOUNTED[u]).inv().apply([0.0, 0.0, 9.81])
    readings += 0.02 * rng.standard_normal(readings.shape)
    valid = np.ones(readings.shape[:2], dtype=bool)
    valid[lost, on] = False
    motion = SimpleNamespace(grid=SimpleNamespace(rate=_RATE))
    return cast(Sampled, SimpleNamespace(motion=motion, readings=readings, valid=valid))


@pytest.mark.parametrize("on", [0, 2])
def test_the_su_on_the_base_tells_its_tilts(on: int) -> None:
    tilt = 0.03 * np.sin(0.5 * _TIME)
    found = tilts_of_base([_sampled(tilt, on, lost=slice(1000, 1500))])
    assert found is not None
    assert found.su == on
    up = found.up[found.span[0]]
    heard = np.r_[:900, 1600 : len(_TIME)]
    true = (_MEAN * Rotation.from_rotvec(tilt[:, None] * [1.0, 0.0, 0.0])).inv().apply([0, 0, 1.0])
    angle = np.arccos(np.clip(up[heard] @ up[heard].mean(axis=0), -1, 1))
    expected = np.arccos(np.clip(true[heard] @ true[heard].mean(axis=0), -1, 1))
    # Its frame may be turned about the vertical, and half a second is one direction.
    np.testing.assert_allclose(angle, expected, atol=6e-3)
    assert np.isfinite(found.up).all()
    np.testing.assert_allclose(np.linalg.norm(found.up, axis=1), 1.0)


def test_spans_of_several_logs_are_counted_on() -> None:
    logs = [_sampled(0.02 * np.sin(0.5 * _TIME), 1)] * 2
    found = tilts_of_base(logs)
    assert found is not None
    P = len(found.up)
    np.testing.assert_array_equal(found.log, np.repeat([0, 1], P // 2))
    np.testing.assert_array_equal(found.span[1], found.span[0] + P // 2)


@pytest.mark.parametrize("on", [1, -1], ids=["it stands still", "no SU is on it"])
def test_nothing_is_told_of_a_base_that_stands_or_has_no_su(on: int) -> None:
    assert tilts_of_base([_sampled(np.zeros(len(_TIME)), on)]) is None
