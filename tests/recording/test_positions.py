"""Single positions that an encoder never had are left out; turns, steps and motion are kept."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skin2urdf.notes import of_reading
from skin2urdf.recording.positions import glitches, without_glitches
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import JointStream, Recording


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
    for joint, sense in zip(recording.joints, (1, -1), strict=True):
        assert joint.time is recording.joints[0].time
        np.testing.assert_allclose(
            joint.position, sense * (0.8 + 0.3 * np.sin(np.arange(1500) / 100.0)), atol=1e-8
        )


def test_a_glitch_at_the_seam_of_a_turn_is_bridged() -> None:
    time = np.arange(2000) / 50.0
    turned = (0.4 * time + np.pi) % (2 * np.pi) - np.pi
    wrong = turned.copy()
    first = int(np.argmin(np.diff(turned)))
    wrong[[first - 3, first + 20, 1900]] = 0.3
    joint = JointStream("j", time, wrong)
    (mended,) = without_glitches(Recording((joint,), ())).joints
    np.testing.assert_allclose(np.unwrap(mended.position), np.unwrap(turned), atol=1e-9)
