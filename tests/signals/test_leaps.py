"""What sampling leaves open where motion leaps."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.filters import filtered, low_pass, sample, second_derivative
from skin2urdf.signals.leaps import Leaps, between_positions
from skin2urdf.signals.motion import Motion, joint_motion

CUTOFF = 10.0
LEVER = 0.4


def motion_of(position: F64, time: F64) -> Motion:
    step = 2 * np.pi / 2**17
    seen = np.round(position / step) * step
    return joint_motion(Recording((JointStream("j", time, seen),), ()))


def leaps_of(motion: Motion, readings: F64, period: float) -> Leaps:
    taps = low_pass(CUTOFF, motion.grid.rate)
    kept = np.arange(motion.grid.size)
    return Leaps.of(motion, readings.swapaxes(0, 1), np.array([period]), taps, kept)


def test_smooth_motion_does_not_leap() -> None:
    time = np.arange(0.0, 20.0, 0.004)
    motion = motion_of(0.1 * np.sin(2 * np.pi * 2.0 * time), time)
    leaps = leaps_of(motion, np.zeros((motion.grid.size, 1, 3)), 0.01)
    inside = slice(100, -100)
    assert leaps.variance(np.array([[LEVER]]))[inside].max() < 1e-9
    assert leaps.readings.max() == 0.0


FINE = np.arange(0.0, 120.0, 1e-3)
BEGINS = np.arange(1.0, 118.0, 0.75) + np.random.default_rng(3).uniform(0.0, 0.1, 156)


def pushes(size: float) -> F64:
    """Acceleration of a drive that starts and stops within 30 ms."""
    push = np.zeros(len(FINE))
    for n, begin in enumerate(BEGINS):
        inside = slice(*np.searchsorted(FINE, [begin, begin + 0.03]))
        push[inside] = (size, -size)[n % 2]
    return push


@pytest.mark.parametrize("size", [20.0, 40.0])
def test_no_leap_is_missed_where_joints_are_slower_than_sus(size: float) -> None:
    """Joints at 50 Hz know little of what lasts for 30 ms, but always that it was there."""
    push = pushes(size)
    position = np.cumsum(np.cumsum(push)) * 1e-6
    motion = motion_of(position[::20], FINE[::20])
    grid, taps = motion.grid, low_pass(CUTOFF, motion.grid.rate)
    # Twice summed, positions are those of a millisecond before.
    felt = sample(FINE, np.interp(FINE + 1e-3, FINE, push)[:, None], grid)[0]
    off = LEVER * filtered(filtered(motion.qdd - felt, taps), taps)[:, 0]
    variance = leaps_of(motion, np.zeros((grid.size, 1, 3)), 0.002).variance(np.array([[LEVER]]))
    for begin in BEGINS:
        about = np.abs(grid.time - begin) < 0.15
        assert np.abs(off[about]).max() < 3.0 * np.sqrt(variance[about].max())


@pytest.mark.parametrize("period", [0.02, 0.01, 0.004, 0.001])
def test_noise_of_positions_does_not_leap(period: float) -> None:
    time = np.arange(0.0, 60.0, period)
    noise = 1e-5 * np.random.default_rng(4).normal(size=len(time))
    position = 0.1 * np.sin(2 * np.pi * 0.3 * time) + noise
    motion = joint_motion(Recording((JointStream("j", time, position),), ()))
    leaps = leaps_of(motion, np.zeros((motion.grid.size, 1, 3)), 0.01)
    assert (leaps.joints[100:-100] > 1e-9).mean() < 0.01


@pytest.mark.parametrize("period", [0.01, 0.016])
def test_what_readings_miss_of_a_drive_that_starts_at_once_is_stated(period: float) -> None:
    """The velocity changes within 30 ms, at times that readings know nothing of."""
    fine, push = FINE, pushes(40.0)
    position = np.cumsum(np.cumsum(push)) * 1e-6
    motion = motion_of(position[::4], fine[::4])
    grid, taps = motion.grid, low_pass(CUTOFF, motion.grid.rate)

    def read(at: F64) -> F64:
        felt = np.zeros((len(at), 3))
        felt[:, 0] = LEVER * np.interp(at, fine, push)
        return sample(at, felt, grid)[0]

    often, seldom = read(fine), read(np.arange(0.0, 119.9, period))
    inside = slice(100, -100)
    off = filtered(filtered(seldom - often, taps), taps)[inside, 0]
    variance = leaps_of(motion, seldom[:, None], period).variance(np.array([[LEVER]]))[inside, 0]
    there = variance > 0.1 * variance.max()
    assert 0.5 < np.sqrt((off[there] ** 2).mean() / variance[there].mean()) < 2.0
    # Far from leaps nothing is missed.
    assert (off[variance < 1e-9] ** 2).mean() < 1e-3 * (off[there] ** 2).mean()


def test_columns_are_exchanged_together() -> None:
    rng = np.random.default_rng(0)
    leaps = Leaps(rng.random((5, 2)), rng.random((5, 3)), np.array([0.5, 1.0, 2.0]))
    dofs, sus = np.array([1, 0]), np.array([2, 0, 1])
    levers = rng.random((3, 2))
    swapped = leaps.ordered(dofs, sus)
    expected = leaps.variance(levers)[:, sus]
    assert swapped.variance(levers[np.ix_(sus, dofs)]) == pytest.approx(expected)
    assert (swapped.readings == leaps.readings[:, sus]).all()


@pytest.mark.parametrize("rate", [20.0, 25.0, 50.0, 125.0])
def test_what_joints_do_between_positions_is_covered(rate: float) -> None:
    """A swing of 3 Hz, which begins and ends as patterns do, in streams of several rates."""
    span = np.clip(np.arange(0.0, 20.0, 1e-3) - 5.0, 0.0, 8.0)
    begins = np.clip(np.minimum(span, 8.0 - span) / 0.5, 0.0, 1.0)
    smooth = begins**3 * (10.0 - 15.0 * begins + 6.0 * begins**2)
    fine = np.arange(0.0, 20.0, 1e-3)
    position = 0.05 * smooth * np.sin(2 * np.pi * 3.1 * span)
    time = np.arange(0.0, 19.9, 1 / rate)
    motion = joint_motion(Recording((JointStream("j", time, np.interp(time, fine, position)),), ()))
    grid, taps = motion.grid, low_pass(8.0, motion.grid.rate)
    q = filtered(motion.q, taps)
    true = filtered(np.interp(grid.time, fine, position)[:, None], taps)
    off = filtered(second_derivative(q - true, grid.rate), taps)[:, 0]
    variance = between_positions(q, grid.rate, motion.raw_rate, taps)[:, 0]
    if rate == 125.0:
        assert variance.max() < 1e-12
        return
    moments = [slice(k, k + 62) for k in range(300, 2000, 62)]
    for moment in moments:
        left, stated = (off[moment] ** 2).mean(), variance[moment].mean()
        assert left <= 9 * stated + 1e-10
    # What is read often enough leaves next to nothing of 19 rad/s^2.
    assert np.sqrt(variance.max()) < {20.0: 3.0, 25.0: 1.0, 50.0: 0.05}[rate]
