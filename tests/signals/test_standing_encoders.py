"""Positions that stand still while their joint moves on are left out, and are no leaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.encoders import leaps, without_what_stood

_TIME = np.arange(0.0, 40.0, 0.01)
_STEP = 2 * np.pi / 2**17


def _track(phase: float) -> F64:
    """Moves of 2 s from place to place with rests of 1 s between them, as an encoder has them."""
    rng = np.random.default_rng(3)
    places = np.r_[0.0, rng.uniform(-1.0, 1.0, 20)]
    share = np.clip(np.mod(_TIME + phase, 3.0) / 2.0, 0.0, 1.0)
    at = ((_TIME + phase) // 3.0).astype(int)
    smooth = share**3 * (10 - 15 * share + 6 * share**2)
    x = places[at] + (places[at + 1] - places[at]) * smooth
    return np.asarray(_STEP * np.round(x / _STEP))


def _recording(*tracks: F64) -> Recording:
    joints = tuple(JointStream(f"j{n}", _TIME, x) for n, x in enumerate(tracks))
    return Recording(joints, (), source="log.mcap")


def _standing(x: F64, begin: float, end: float) -> F64:
    """A track whose last value before a time is sent again until another time."""
    first, last = np.searchsorted(_TIME, [begin, end])
    out = np.array(x)
    out[first:last] = x[first - 1]
    return out


@pytest.mark.parametrize("end", [10.1, 10.9, 14.3])
def test_what_stood_is_left_out_of_all_joints(end: float) -> None:
    begin = 9.9
    recording = _recording(_standing(_track(0.0), begin, end), _track(0.7))
    left, faults = without_what_stood(recording)
    (fault,) = faults
    assert (fault.kind, fault.subject, fault.detail) == ("frozen", "j0", "encoder")
    assert fault.to_repair
    assert fault.begin == pytest.approx(begin, abs=0.02)
    assert fault.end == pytest.approx(end, abs=0.02)
    for joint in left.joints:
        assert not ((joint.time > begin + 0.02) & (joint.time < end - 0.02)).any()
        assert len(joint.time) == pytest.approx(len(_TIME) - 100 * (end - begin), abs=3)
    assert leaps(recording, 0) == ()


def test_joints_that_rest_and_move_stand_nowhere() -> None:
    recording = _recording(_track(0.0), _track(0.7))
    left, faults = without_what_stood(recording)
    assert left is recording
    assert faults == ()


@pytest.mark.parametrize("at", [8.5, 9.9])
def test_an_encoder_that_leaps_at_rest_or_on_its_way_did_not_stand(at: float) -> None:
    x = _track(0.0) + 0.1 * (at <= _TIME)
    recording = _recording(x, _track(0.7))
    assert without_what_stood(recording) == (recording, ())
    (leap,) = leaps(recording, 0)
    assert leap.size == pytest.approx(0.1, abs=0.01)


def test_setpoints_that_go_in_leaps_do_not_stand() -> None:
    places = np.random.default_rng(2).uniform(-1.0, 1.0, 10)
    x = places[(_TIME // 4.0).astype(int)]
    recording = _recording(x, _track(0.7))
    assert without_what_stood(recording) == (recording, ())


def test_what_stood_until_the_joint_rested_is_left_out() -> None:
    """It ends in a leap at rest, and began on the way: no joint stops from sample to sample."""
    x = _standing(8.0 * _track(0.0), 9.9, 11.3)
    _, (fault,) = without_what_stood(_recording(x, _track(0.7)))
    assert fault.end == pytest.approx(11.3, abs=0.02)


def test_a_leap_besides_what_stood_is_still_one() -> None:
    x = _standing(_track(0.0), 9.9, 10.9) + 0.1 * (_TIME >= 26.5)
    recording = _recording(x, _track(0.7))
    (leap,) = leaps(recording, 0)
    assert leap.begin == pytest.approx(26.5, abs=0.02)
    _, faults = without_what_stood(replace(recording))
    assert len(faults) == 1
