"""Joint motion on the grid, and what encoders are known by."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_paths import JointPath

from skin2urdf.arrays import F64
from skin2urdf.errors import InsufficientDataError
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.motion import GRID_RATE, encoder_noise, joint_motion


def wandering() -> JointPath:
    """Two joints that move, rest and swing for half a minute."""
    path = JointPath([0.1, -0.4]).rest(1.0)
    for goal in ([0.9, 0.2], [-0.5, 1.1], [0.3, -0.7], [0.6, 0.5]):
        path.move(goal).rest(0.7).swing({0: 0.12}).rest(0.5).swing({1: -0.1}).rest(0.5)
    return path


PATH = wandering()


def rounded(stream: F64, step: float) -> F64:
    return np.round(stream / step) * step


def encoder(bits: int, rate: float, offset: float) -> tuple[float, float, float]:
    """Step of an encoder on the path's first joint; its step and noise as they are recognised."""
    step = 2 * np.pi / 2**bits
    time = np.arange(0.0, PATH.time[-1], 1 / rate)
    position = rounded(PATH.at(time)[:, 0], step) + offset
    return step, *encoder_noise(JointStream("a", time, position))


RATES = st.sampled_from([100.0, 250.0, 500.0])


@given(bits=st.integers(8, 18), rate=RATES, offset=st.floats(0, 1))
@settings(max_examples=40, deadline=None)
def test_the_step_of_an_encoder_is_recognised(bits: int, rate: float, offset: float) -> None:
    step, resolution, noise = encoder(bits, rate, offset)
    assert resolution == pytest.approx(step, rel=1e-3)
    assert step / np.sqrt(12) * 0.999 <= noise <= step / np.sqrt(12) * 1.3


@given(bits=st.integers(19, 24), rate=RATES)
@settings(max_examples=20, deadline=None)
def test_steps_too_small_to_be_seen_alone_are_not_overrated(bits: int, rate: float) -> None:
    """Between two samples such an encoder passes many steps; its noise hardly matters."""
    step, resolution, noise = encoder(bits, rate, 0.0)
    assert resolution <= 4.1 * step
    assert noise <= 5 * step


def test_exact_encoders_have_no_step_and_hardly_any_noise() -> None:
    time = np.arange(0.0, PATH.time[-1], 1 / 500.0)
    resolution, noise = encoder_noise(JointStream("a", time, PATH.at(time)[:, 0]))
    assert resolution == 0.0
    assert noise < 1e-6


def test_a_joint_that_never_moves_has_neither() -> None:
    time = np.arange(500) / 100.0
    assert encoder_noise(JointStream("a", time, np.full(500, 0.7))) == (0.0, 0.0)


@pytest.mark.parametrize("rate", [20.0, 25.0, 50.0])
def test_motion_between_the_samples_of_a_slow_stream_is_no_noise(rate: float) -> None:
    step, resolution, noise = encoder(17, rate, 0.0)
    assert resolution == pytest.approx(step, rel=1e-3)
    assert noise == pytest.approx(step / np.sqrt(12), rel=0.1)


@given(sd=st.floats(1e-5, 3e-3), seed=st.integers(0, 99))
@settings(max_examples=25, deadline=None)
def test_the_noise_of_an_analogue_sensor_is_measured(sd: float, seed: int) -> None:
    time = np.arange(0.0, PATH.time[-1], 1 / 250.0)
    noise = sd * np.random.default_rng(seed).standard_normal(time.size)
    resolution, found = encoder_noise(JointStream("a", time, PATH.at(time)[:, 0] + noise))
    assert resolution == 0.0
    assert found == pytest.approx(sd, rel=0.15)


def test_positions_and_derivatives_are_those_of_the_path() -> None:
    t = np.arange(0.0, 20.0, 0.004)
    w = 2 * np.pi * np.array([0.4, 2.0])
    q = 0.3 * np.sin(w * t[:, None])
    motion = joint_motion(
        Recording(tuple(JointStream(n, t, q[:, d]) for d, n in enumerate("ab")), ())
    )
    g, inside = motion.grid.time[:, None], slice(40, -40)
    assert motion.dof_names == ("a", "b")
    assert motion.grid.rate == GRID_RATE
    np.testing.assert_allclose(motion.raw_rate, 250.0, rtol=1e-6)
    np.testing.assert_allclose(motion.q[inside], 0.3 * np.sin(w * g)[inside], atol=1e-5)
    np.testing.assert_allclose(motion.qd[inside], 0.3 * (w * np.cos(w * g))[inside], atol=1e-4)
    np.testing.assert_allclose(
        motion.qdd[inside], 0.3 * (-(w**2) * np.sin(w * g))[inside], atol=2e-3
    )


def test_joints_may_come_on_streams_of_their_own() -> None:
    """One publisher per joint, each with its own rate, start and end."""
    spans = {"a": (0.0, 30.0, 100.0), "b": (0.35, 29.0, 333.0)}
    streams = []
    for d, (name, (begin, end, rate)) in enumerate(spans.items()):
        time = np.arange(begin, min(end, PATH.time[-1]), 1 / rate)
        streams.append(JointStream(name, time, PATH.at(time)[:, d]))
    motion = joint_motion(Recording(tuple(streams), ()))
    assert motion.grid.start == pytest.approx(0.35)
    expected = PATH.at(motion.grid.time)
    assert motion.valid[20:-20].all()
    np.testing.assert_allclose(motion.q[20:-20], expected[20:-20], atol=2e-4)
    np.testing.assert_allclose(motion.raw_rate, [100.0, 333.0], rtol=1e-3)


def test_streams_of_equal_length_and_ends_are_still_told_apart() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    bent = time + 0.003 * np.sin(np.pi * np.arange(time.size) / (time.size - 1))
    bent[-1] = time[-1]
    streams = tuple(
        JointStream(n, t, np.sin(2 * t)) for n, t in (("a", time), ("b", bent), ("c", bent))
    )
    motion = joint_motion(Recording(streams, ()))
    expected = np.sin(2 * motion.grid.time)[10:-10]
    for d in range(3):
        np.testing.assert_allclose(motion.q[10:-10, d], expected, atol=1e-5)


def test_a_joint_that_this_log_lacks_rests_at_zero() -> None:
    motion = joint_motion(PATH.recording(), ("b", "elsewhere", "a"))
    assert motion.dof_names == ("b", "elsewhere", "a")
    assert not motion.q[:, 1].any()
    assert not motion.qdd[:, 1].any()
    alone = joint_motion(PATH.recording())
    np.testing.assert_allclose(motion.q[:, [2, 0]], alone.q, atol=1e-12)


def test_a_gap_in_one_joint_invalidates_all() -> None:
    recording = PATH.recording()
    joint = recording.joints[1]
    keep = (joint.time < 10.0) | (joint.time > 10.3)
    torn = JointStream("b", joint.time[keep], joint.position[keep])
    motion = joint_motion(Recording((recording.joints[0], torn), ()))
    t = motion.grid.time
    assert not motion.valid[(t > 10.0) & (t < 10.3)].any()
    assert motion.valid[(t > 1.0) & (t < 9.8)].all()


@pytest.mark.parametrize("seconds", [0.5, 20.0])
def test_positions_in_a_gap_stay_between_those_around_it(seconds: float) -> None:
    """A joint that moves fast where its messages stop, as a curve through its samples would."""
    time = np.arange(6000) / 100.0
    joint = JointStream("a", time, np.sin(3.0 * time))
    keep = (time < 10.0) | (time > 10.0 + seconds)
    torn = JointStream("a", time[keep], joint.position[keep])
    motion = joint_motion(Recording((torn,), ()))
    gap = (motion.grid.time > 10.0) & (motion.grid.time < 10.0 + seconds)
    ends = joint.position[keep][[999, 1000]]
    assert motion.q[gap].min() >= ends.min() - 1e-3
    assert motion.q[gap].max() <= ends.max() + 1e-3
    assert not motion.valid[gap].any()


@pytest.mark.parametrize("n", [0, 5])
def test_no_samples_are_an_error_in_words(n: int) -> None:
    short = JointStream("a", np.arange(n) / 100.0, np.zeros(n))
    with pytest.raises(InsufficientDataError) as caught:
        joint_motion(Recording((short,), (), source="x.mcap"))
    assert caught.value.lacks == "samples"
    assert "x.mcap" in str(caught.value)
    assert caught.value.remedy


def test_streams_that_do_not_overlap_are_an_error_in_words() -> None:
    a, b = np.arange(1000) / 100.0, 9.0 + np.arange(1000) / 100.0
    streams = (JointStream("a", a, np.sin(a)), JointStream("b", b, np.sin(b)))
    with pytest.raises(InsufficientDataError) as caught:
        joint_motion(Recording(streams, ()))
    assert caught.value.lacks == "overlap"
    assert caught.value.remedy


def test_positions_that_are_hours_apart_tell_of_no_moves() -> None:
    """They would be a grid of millions of samples, of which none is known."""
    time = np.arange(12) * 4000.0
    stream = JointStream("a", time, np.sin(time))
    with pytest.raises(InsufficientDataError):
        joint_motion(Recording((stream,), (), source="slow"))
