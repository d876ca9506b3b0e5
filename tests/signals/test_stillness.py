"""Joints that stay do not shake what they carry by what their encoders toggle."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.filters import filtered, low_pass, second_derivative
from skin2urdf.signals.motion import Motion, joint_motion
from skin2urdf.signals.stillness import without_toggling

_STEP = 2 * np.pi / 2**17
_TIME = np.arange(0.0, 40.0, 0.004)
_SWINGS = (_TIME > 15.0) & (_TIME < 25.0)
"""When the joint swings; before and after, others move it by less than a step."""


def _true() -> F64:
    """(N,) what the joint does."""
    swing = (
        0.1 * np.sin(2 * np.pi * 2.0 * (_TIME - 15.0)) * np.sin(np.pi * (_TIME - 15.0) / 10) ** 4
    )
    return np.asarray(np.where(_SWINGS, swing, 0.3 * _STEP * np.sin(2 * np.pi * 1.7 * _TIME)))


def _read(step: float) -> Motion:
    seen = _true() + 0.3 * _STEP  # between two counts
    seen = np.round(seen / step) * step if step else seen
    return joint_motion(Recording((JointStream("j", _TIME, seen),), ()))


def _accelerations(positions: F64, motion: Motion) -> F64:
    rate = motion.grid.rate
    taps = low_pass(8.0, rate)
    return np.asarray(second_derivative(filtered(positions, taps), rate))[:, 0]


def test_a_joint_that_stays_shakes_no_link() -> None:
    motion = _read(_STEP)
    positions, _ = without_toggling(motion, low_pass(8.0, motion.grid.rate))
    stays = (motion.grid.time > 3.0) & (motion.grid.time < 12.0)
    toggled = _accelerations(motion.q, motion)[stays].std()
    left = _accelerations(positions, motion)[stays].std()
    assert toggled > 2e-3
    assert left < 0.05 * toggled
    assert np.abs(positions - motion.q).max() < _STEP


def test_a_joint_that_moves_is_as_it_was() -> None:
    motion = _read(_STEP)
    positions, _ = without_toggling(motion, low_pass(8.0, motion.grid.rate))
    swings = (motion.grid.time > 15.5) & (motion.grid.time < 24.5)
    np.testing.assert_allclose(positions[swings], motion.q[swings], rtol=0, atol=1e-12)


def test_encoders_that_do_not_round_are_left_alone() -> None:
    motion = _read(0.0)
    positions, _ = without_toggling(motion, low_pass(8.0, motion.grid.rate))
    np.testing.assert_array_equal(positions, motion.q)
