"""Joints that are sent on change stay while nothing is sent; where some are lost they do not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skin2urdf.arrays import F64, Bool
from skin2urdf.notes import of_reading
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.recording.retiming import retimed
from skin2urdf.recording.silence import joints_through_silence, silences

RATE = 50.0
N = 4000


def positions(bits: int, seed: int = 0) -> F64:
    """(N, 2) of joints that move for two seconds and rest for two, from pose to pose."""
    rng = np.random.default_rng(seed)
    stops = np.cumsum(rng.uniform(0.2, 0.9, (N // 100, 2)) * rng.choice([-1, 1], (N // 100, 2)), 0)
    share = np.clip(np.arange(N) % 200 / 100.0, 0.0, 1.0)
    eased = share**3 * (10 - 15 * share + 6 * share**2)
    leg = np.arange(N) // 200
    q = stops[leg] + eased[:, None] * (stops[leg + 1] - stops[leg])
    step = 2 * np.pi / 2**bits
    return np.asarray(np.round(q / step) * step)


def sent_on_change(q: F64, every: int = 50) -> Bool:
    """(N,) messages in which a joint has another position, and each one after a while."""
    changed = np.append(True, (np.diff(q, axis=0) != 0).any(axis=1))
    return np.asarray(changed | (np.arange(len(q)) % every == 0))


def streams(q: F64, sent: Bool) -> tuple[JointStream, ...]:
    time = np.arange(len(q))[sent] / RATE
    return tuple(
        JointStream(name, time, x, effort=10 * x) for name, x in zip("ab", q[sent].T, strict=True)
    )


@pytest.mark.parametrize("bits", [12, 16, 19])
@pytest.mark.parametrize("every", [25, 50, 150, N])
def test_joints_go_on_through_silence(bits: int, every: int) -> None:
    q = positions(bits)
    found = joints_through_silence(Recording(streams(q, sent_on_change(q, every)), ()))
    (note,) = of_reading(found.notes, "sent on change")
    assert note.sources == ("a", "b")
    for joint, x in zip(found.joints, q.T, strict=True):
        at = np.rint(RATE * joint.time).astype(int)
        assert np.diff(at).max() <= 4  # a message or two may be late
        np.testing.assert_array_equal(joint.position, x[at])
        assert joint.effort is not None
        np.testing.assert_array_equal(joint.effort, 10 * x[at])


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_joints_of_which_messages_are_lost_are_left_alone(noise: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = positions(16) + noise * rng.standard_normal((N, 2))
    sent = np.ones(N, dtype=bool)
    for begin in rng.integers(0, N, 30):
        sent[begin : begin + rng.integers(10, 100)] = False
    recording = Recording(streams(q, sent), ())
    assert joints_through_silence(recording) is recording


def test_one_motion_that_came_back_is_not_bridged() -> None:
    """Nothing is sent for three seconds in which a joint may have swung."""
    time = np.arange(2000) / RATE
    q = np.stack([np.sin(time), np.cos(time)], axis=1)
    sent = (time < 10.0) | (time > 10.0 + 2 * np.pi)
    assert not len(silences(time[sent], q[sent]))


def test_times_are_decided_once_silence_is_filled() -> None:
    """Without rests positions look smoothest one after the other, whatever their stamps say."""
    q = positions(16)
    found = retimed(Recording(streams(q, sent_on_change(q)), ()))
    for joint, x in zip(found.joints, q.T, strict=True):
        at = np.rint(RATE * joint.time).astype(int)
        np.testing.assert_allclose(joint.time, at / RATE, atol=1e-6)
        np.testing.assert_array_equal(joint.position, x[at])
    assert retimed(found).joints[0].time.size == found.joints[0].time.size


def test_a_log_tells_of_joints_that_are_sent_on_change(ros_log: Any) -> None:
    q = positions(17)[:2000]
    sent = sent_on_change(q)
    rng = np.random.default_rng(0)
    for k in range(2000):
        at = 10**9 * 1_700_000_000 + 2 * 10**7 * k
        if sent[k]:
            nan = float("nan")  # of which a message lacks one position is sent all the same
            ros_log.joints(at, {"j": q[k, 0], "k": q[k, 1] if k != 60 else nan})
        ros_log.imu(at, rng.standard_normal(3))
    recording = read(ros_log.close())
    (note,) = of_reading(recording.notes, "sent on change")
    assert note.sources == ("j", "k")
    for joint in recording.joints:
        assert np.diff(joint.time).max() < 0.05
