"""The band of a log: as wide as its motion, and no wider than its encoders know it."""

from __future__ import annotations

import numpy as np
import pytest
from joint_paths import JointPath

from skin2urdf.arrays import F64
from skin2urdf.signals.band import Cutoffs, quietness, suitable_cutoffs
from skin2urdf.signals.motion import Motion
from skin2urdf.signals.poses import find_neighbourhoods, find_rests

QUIET = 2 * 0.01**2 / 500
"""Density of sensors with noise of 0.01 m/s^2 at 500 samples a second."""


def moves(seconds: float, length: float = 0.6) -> JointPath:
    """Two joints that go to and fro for half a minute, with rests between."""
    path = JointPath([0.0, 0.0])
    rng = np.random.default_rng(0)
    while path.time[-1] < 30.0:
        path.rest(0.8).move(rng.uniform(-length, length, 2).tolist(), seconds)
    return path.rest(1.0)


def read_with(path: JointPath, bits: int | None, rate: float = 100.0) -> Motion:
    """The path through encoders."""
    time = np.arange(0.0, path.time[-1], 1 / rate)
    off: F64 | None = None
    if bits is not None:
        step = 2 * np.pi / 2**bits
        off = np.round(path.at(time) / step) * step - path.at(time)
    return path.motion(rate, off)


def cutoffs(motion: Motion, quiet: float = QUIET) -> Cutoffs:
    return suitable_cutoffs(
        motion, find_neighbourhoods(motion, find_rests(motion)), np.array([quiet])
    )


def cutoff(motion: Motion, quiet: float = QUIET) -> float:
    """That of a log without patterns."""
    found = cutoffs(motion, quiet)
    assert found.patterns == found.along
    return found.along


def test_what_encoders_round_off_is_no_motion() -> None:
    """Rounding of 12 bits has more energy at 20 Hz than slow moves have at 1 Hz."""
    slow = moves(2.5, 0.3)
    assert cutoff(read_with(slow, None)) == 5.0
    assert cutoff(read_with(slow, 12)) <= 5.0


def test_the_coarser_encoders_are_the_narrower_is_the_band() -> None:
    widths = [cutoff(read_with(moves(1.5), bits)) for bits in (11, 13, 15, 18)]
    assert widths == sorted(widths)
    assert widths[0] < 0.5 * widths[-1]
    assert widths[-1] == cutoff(read_with(moves(1.5), None)) == 5.0


def test_loud_sensors_need_no_narrow_band() -> None:
    """Where readings are noisier than predictions, a narrower band tells no more."""
    coarse = read_with(moves(0.8), 12)
    assert cutoff(coarse, 1e4 * QUIET) >= 5.0
    assert cutoff(coarse, QUIET) < 4.0


@pytest.mark.parametrize("bits", [12, None])
def test_patterns_keep_their_second_harmonics(bits: int | None) -> None:
    path = JointPath([0.0, 0.0]).rest(1.0)
    for pose in np.random.default_rng(1).uniform(-1, 1, (4, 2)):
        path.move(pose.tolist(), 2.0).rest(1.0)
        for joint in range(2):
            path.swing({joint: 0.2}, hertz=2.0).rest(0.5)
    # A low-pass leaves 0.6 of its band as it is.
    found = cutoffs(read_with(path, bits))
    assert 0.6 * found.patterns > 2 * 2.0
    # All samples are looked at in as much of it as encoders know.
    assert found.along == found.patterns if bits is None else found.along < found.patterns


@pytest.mark.parametrize("size", [0.01, 0.03])
def test_noise_is_told_from_motion(size: float) -> None:
    rate, n = 125.0, 4000
    t = np.arange(n)[:, None] / rate
    motion = 3.0 * np.sin(2 * np.pi * 0.2 * t + np.arange(3))
    noise = size * np.random.default_rng(2).standard_normal((n, 3))
    still = np.ones(n, dtype=bool)
    assert quietness(motion + noise, still, rate) == pytest.approx(size**2 / (rate / 2), rel=0.1)
    assert np.isnan(quietness(motion + noise, still & False, rate))


def test_a_band_needs_no_sensor_that_rests() -> None:
    assert cutoff(read_with(moves(0.8), 12), float("nan")) < 4.0
