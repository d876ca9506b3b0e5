"""What comes back after most stops is how large noise is there; what comes once is not."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.motion import Motion, joint_motion
from skin2urdf.signals.poses import find_stops
from skin2urdf.signals.ringing import rises_after_stops

RATE, REACH, SIZE = 125, 5, 12.0
STOPS: Int = np.arange(8) * 2 * RATE + RATE


def ringing(stops: Int, seed: int = 0) -> F64:
    """(N,) sizes of noise, and of vibration of 10 Hz that decays in 0.3 s after each stop."""
    size = np.abs(np.random.default_rng(seed).normal(size=STOPS[-1] + 2 * RATE))
    for stop in stops:
        since = np.arange(len(size) - stop) / RATE
        size[stop:] += SIZE * np.exp(-since / 0.3) * np.abs(np.sin(20 * np.pi * since))
    return size


def test_vibration_after_every_stop_is_usual_there() -> None:
    size = ringing(STOPS)
    (rise,) = rises_after_stops([(0, size)], STOPS, REACH)
    assert size.max() > 9.0
    assert (size / rise).max() < 4.5
    # Nothing is raised before the next stop, where it has decayed.
    before = rise[STOPS[1:] - RATE // 4]
    assert before == pytest.approx(1.0, abs=0.5)


def test_windows_tell_of_one_another() -> None:
    size = ringing(STOPS)
    (whole,) = rises_after_stops([(0, size)], STOPS, REACH)
    cut = [(a, size[a:b]) for a, b in ((0, 600), (600, 1300), (1300, len(size)))]
    parts = np.concatenate(rises_after_stops(cut, STOPS, REACH))
    inside = np.abs(np.arange(len(size))[:, None] - np.array([600, 1300])).min(axis=1) > 2 * REACH
    np.testing.assert_allclose(parts[inside], whole[inside], rtol=0.1)


@pytest.mark.parametrize("stops", [STOPS[3:4], STOPS[:0]])
def test_what_comes_once_stands_out_as_before(stops: Int) -> None:
    size = ringing(stops)
    (rise,) = rises_after_stops([(0, size)], STOPS, REACH)
    assert rise.min() >= 1.0
    assert rise.max() < 1.6


@pytest.mark.parametrize("n", [0, 4])
def test_few_stops_tell_nothing(n: int) -> None:
    (rise,) = rises_after_stops([(0, ringing(STOPS[:n]))], STOPS[:n], REACH)
    assert (rise == 1.0).all()
    assert rises_after_stops([], STOPS, REACH) == []


def motion() -> Motion:
    """Two joints: both move, one stops half a second before the other, then one moves alone."""
    time = np.arange(0.0, 8.0, 0.004)
    first = np.interp(time, [1.0, 2.0], [0.0, 1.0])
    second = np.interp(time, [1.0, 2.5, 4.0, 5.0], [0.0, 1.0, 1.0, 2.0])
    joints = (JointStream("a", time, first), JointStream("b", time, second))
    return joint_motion(Recording(joints, ()))


def test_stops_are_those_of_every_joint() -> None:
    found = motion()
    at = found.grid.time[find_stops(found)]
    assert at == pytest.approx([2.0, 2.5, 5.0], abs=0.15)
