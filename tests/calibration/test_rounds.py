"""Rounds of features and estimates that improve each other."""

from __future__ import annotations

from dataclasses import replace

import pytest
from random_robots import small_arm
from simulated import SHORT, simulation_of

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.rounds import find_structure, relinearise, sample_logs, take_features
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation.motion_settings import MotionSettings


def test_costs_of_two_rounds_are_compared_in_one_unit() -> None:
    """Features with much noise cost little, whatever they leave; those that follow have less."""
    wide = MotionSettings(frequency_band=(0.7, 2.5))
    recording = simulation_of(small_arm(3), **{**SHORT, "excite": "all", "motion": wide}).recording
    settings, clock = CalibrationSettings(), Clock()
    logs = sample_logs([retimed(recording)], settings, clock)
    first = take_features(logs, clock)
    tree = find_structure(logs, first, clock).certain_tree
    settled, _ = relinearise(logs, tree, first, clock)
    once = replace(logs, settings=replace(settings, relinearisations=1))
    found, second = relinearise(once, tree, first, clock)
    assert found.cost_per_dof > 4 * settled.cost_per_dof
    # As if what lies beyond first order had passed for noise in these.
    noisy = replace(second, noise=2.5 * second.noise)
    again, _ = relinearise(logs, tree, noisy, clock, start=found.state)
    assert again.cost_per_dof == pytest.approx(settled.cost_per_dof, rel=0.01)
