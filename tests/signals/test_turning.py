"""Gyroscopes' readings on the grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.notes import Note, of_kind
from skin2urdf.recording.records import Recording, SuStream
from skin2urdf.signals.sampling import Sampled, sampled_together
from skin2urdf.signals.turning import Turning
from skin2urdf.simulation import SimulationSettings, load_robot, simulate


@pytest.fixture(scope="module")
def log() -> Recording:
    settings = SimulationSettings(n_poses=2, excite="all", seed=4, gyro="mems", imu_rate=250.0)
    return simulate(load_robot("ur3"), settings).recording


def _turning(recording: Recording) -> tuple[Sampled, Turning]:
    (sampled,), _ = sampled_together([recording])
    assert sampled.turning is not None
    return sampled, sampled.turning


def _changed(recording: Recording, name: str, rates: F64) -> Recording:
    def new(su: SuStream) -> SuStream:
        return replace(su, angular_velocity=rates) if su.name == name else su

    return replace(recording, sus=tuple(map(new, recording.sus)))


def _liveliest(recording: Recording) -> SuStream:
    """The SU that turns most."""

    def size(su: SuStream) -> float:
        return 0.0 if su.angular_velocity is None else float(su.angular_velocity.std())

    return max(recording.sus, key=size)


def test_rates_are_those_of_the_joints(log: Recording) -> None:
    sampled, turning = _turning(log)
    assert turning.valid.mean() > 0.95
    # An SU turns no faster than all joints together.
    speed = np.linalg.norm(turning.rates - np.median(turning.rates, axis=0), axis=2)
    largest = np.abs(sampled.motion.qd).sum(axis=1)
    assert np.quantile(speed / (largest[:, None] + 0.02), 0.99) < 1.1


def test_degrees_are_converted_and_told(log: Recording) -> None:
    _, plain = _turning(log)
    su = _liveliest(log)
    assert su.angular_velocity is not None
    sampled, odd = _turning(_changed(log, su.name, np.rad2deg(su.angular_velocity)))
    np.testing.assert_allclose(odd.rates, plain.rates, atol=1e-12)
    assert of_kind(sampled.notes, "unit deg/s") == [Note("unit deg/s", (su.name,))]


def test_spikes_and_missing_rates_do_no_harm(log: Recording) -> None:
    _, plain = _turning(log)
    names = [su.name for su in log.sus]
    su = _liveliest(log)
    rates = np.array(su.angular_velocity)
    rates[700::900] += 8.0
    rates[300::700] = np.nan
    _, odd = _turning(_changed(log, su.name, rates))
    u = names.index(su.name)
    both = plain.valid[:, u] & odd.valid[:, u]
    assert both.mean() > 0.9
    apart = np.abs(odd.rates[both, u] - plain.rates[both, u])
    # Noise of 0.1 deg/s, of which a sample that is left out takes its share.
    assert apart.max() < 0.02


def test_a_log_without_gyroscopes_has_no_rates(log: Recording) -> None:
    plain = replace(log, sus=tuple(replace(su, angular_velocity=None) for su in log.sus))
    (sampled,), _ = sampled_together([plain])
    assert sampled.turning is None
