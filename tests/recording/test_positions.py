"""Single positions that an encoder never had are left out; turns, steps and motion are kept."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skin2urdf.notes import of_reading
from skin2urdf.recording.positions import glitches
from skin2urdf.recording.reading import read


@pytest.mark.parametrize("rate", [20.0, 125.0, 500.0])
@pytest.mark.parametrize("bits", [12, 19, None])
@pytest.mark.parametrize("hertz", [0.2, 1.5])
def test_glitches_are_found_and_nothing_else(rate: float, bits: int | None, hertz: float) -> None:
    rng = np.random.default_rng(0)
    time = np.arange(round(60 * rate)) / rate
    q = (
        1.3
        + np.where(time % 8 < 4, 0.12, 0.0) * np.sin(2 * np.pi * hertz * time) * np.sin(time) ** 2
    )
    q += rng.uniform(-0.5, 0.5) * np.tanh(3 * (time - 30.0))
    q = q + 2e-5 * rng.standard_normal(len(q)) if bits is None else _rounded(q, bits)
    assert not glitches(q).any()
    assert not glitches((q + np.pi - q[100]) % (2 * np.pi) - np.pi).any()
    struck = np.arange(50, len(q) - 50, 97)
    wrong = q.copy()
    wrong[struck] = rng.choice([0.0, -2.0, 3.0], len(struck))
    found = np.flatnonzero(glitches(wrong))
    np.testing.assert_array_equal(found, struck)


def test_a_joint_that_jumps_has_no_glitch() -> None:
    """An encoder that slips stays where it is then: for others to say."""
    q = np.sin(np.arange(3000) / 100.0)
    q[1500:] += 0.4
    assert not glitches(q).any()


def _rounded(q: np.ndarray, bits: int) -> np.ndarray:
    step = 2 * np.pi / 2**bits
    return np.round(q / step) * step


def test_a_log_tells_of_glitches(ros_log: Any) -> None:
    rng = np.random.default_rng(0)
    for k in range(1500):
        at = 10**9 * 1_700_000_000 + 10**7 * k
        q = 0.8 + 0.3 * np.sin(k / 100.0)
        ros_log.joints(at, {"j": 0.0 if k in (300, 700) else q, "k": -q})
        ros_log.imu(at, rng.standard_normal(3))
    recording = read(ros_log.close())
    (note,) = of_reading(recording.notes, "spikes")
    assert (note.sources, note.number) == (("j",), 2)
    assert [joint.time.size for joint in recording.joints] == [1498, 1500]
