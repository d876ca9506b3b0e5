"""Vibration that all SUs feel whenever the robot stops is no hit, and hides none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from random_robots import small_arm
from simulated import SHORT, simulation_of

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.recording.records import Recording, SuStream
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import Simulation, SimulationSettings
from skin2urdf.simulation.faults import Sound
from skin2urdf.simulation.joint_faults import contact
from skin2urdf.simulation.simulate import Truth

OPTIONS = {"n_poses": 2, "seed": 2, "imu_rate": 100.0}


@cache
def sound() -> Simulation:
    return simulation_of(small_arm(3), **OPTIONS)


def ringing(recording: Recording, truth: Truth) -> Recording:
    """A recording with a vibration of 10 Hz and 0.4 m/s^2 after every motion."""
    ends = np.array([phase.end for phase in truth.phases if phase.kind != "rest"]) - truth.start
    ends += recording.sus[0].time[0]
    rng = np.random.default_rng(1)

    def rung(su: SuStream) -> SuStream:
        since = su.time[:, None] - ends
        wave = np.exp(-since.clip(min=0.0) / 0.3) * np.sin(20 * np.pi * since) * (since >= 0)
        direction = rng.normal(size=3)
        shaken = 0.4 * wave.sum(axis=1)[:, None] * direction / np.linalg.norm(direction)
        return replace(su, specific_force=su.specific_force + shaken)

    return replace(recording, sus=tuple(map(rung, recording.sus)))


def test_rests_that_ring_are_not_hit() -> None:
    found = calibrate(retimed(ringing(sound().recording, sound().truth)))
    assert not found.faults
    assert found.quality == "good"


def test_a_hit_is_named_although_rests_ring() -> None:
    settings = SimulationSettings(**{**SHORT, **OPTIONS})
    fault = contact(Sound(small_arm(3), settings, sound()), np.random.default_rng(4))
    found = calibrate(retimed(ringing(fault.recordings[0], sound().truth)))
    assert [(f.kind, f.subject) for f in found.faults] == [("contact", fault.subjects[0])]
