"""Swings of several joints are told from patterns of one, and of several that go their own ways."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import sampled_of, simulation

from skin2urdf.arrays import F64
from skin2urdf.signals.gaits import are_gaits, in_common

T = np.arange(0.0, 8.0, 0.01)


def swings(*hertz: float) -> F64:
    phases = np.random.default_rng(len(hertz)).uniform(0, 6, len(hertz))
    softly = np.sin(np.pi * T / T[-1]) ** 2
    waves = [softly * np.sin(2 * np.pi * f * T + p) for f, p in zip(hertz, phases, strict=True)]
    return np.stack(waves, axis=1)


@pytest.mark.parametrize("joints", [2, 3, 12])
def test_joints_of_one_frequency_swing_as_one_at_any_phase(joints: int) -> None:
    assert in_common(swings(*[0.8] * joints)) == pytest.approx(1.0, abs=0.02)


def test_joints_of_several_frequencies_have_little_in_common() -> None:
    assert in_common(swings(1.1, 1.44, 1.78)) < 0.1


@pytest.mark.parametrize("excite", ["one", "all"])
def test_patterns_are_no_gaits(excite: str) -> None:
    assert not are_gaits([sampled_of(simulation("ur5", excite=excite).recording)])
