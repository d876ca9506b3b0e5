"""A log through a lower low-pass still has motion and readings that belong together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from synthetic import RATE, sampled_trajectory

from skin2urdf.signals.filters import filtered
from skin2urdf.signals.trajectory import Trajectory

_SLOW, _FAST = 2 * np.pi * np.array([0.6, 4.5])


def _log() -> Trajectory:
    """A joint that swings slowly and fast, and an SU that reads its acceleration."""
    t = np.arange(3000) / RATE
    q = np.sin(_SLOW * t) + 0.1 * np.sin(_FAST * t)
    read = -(_SLOW**2) * np.sin(_SLOW * t) - 0.1 * _FAST**2 * np.sin(_FAST * t)
    return sampled_trajectory(q[:, None], np.repeat(read[:, None, None], 3, axis=2))


def test_what_is_slow_stays_and_belongs_together() -> None:
    slow = _log().slower(3)
    at = slow.kept
    felt = filtered(slow.qdd, slow.taps)[at]
    np.testing.assert_allclose(slow.readings[at, 0], np.tile(felt, 3), atol=1e-3)
    t = at / RATE
    np.testing.assert_allclose(slow.q[at, 0], np.sin(_SLOW * t), atol=1e-2)
    # Samples are as far from each other as what is left of the motion allows.
    assert np.diff(at).min() == 3 * np.diff(_log().kept).min()
    assert len(slow.taps) // 2 <= at[0] < at[-1] < len(slow.q) - len(slow.taps) // 2


def test_nothing_is_compared_near_what_was_not_whole() -> None:
    log = _log()
    broken = np.array(log.valid)
    broken[200] = False
    slow = replace(log, valid=broken).slower(3)
    near = np.abs(slow.kept - log.kept[200]) < len(slow.taps) - len(log.taps)
    assert near.any()
    assert not slow.valid[near].any()
    assert slow.valid[~near].any()


def test_the_first_seconds_can_be_left_out() -> None:
    log = _log()
    later = log.without_first(4.0)
    assert log.kept[0] < 4.0 * RATE <= later.kept[0]
    np.testing.assert_array_equal(later.kept, log.kept[-len(later.kept) :])
    assert len(later.valid) == len(later.moving) == len(later.kept)
