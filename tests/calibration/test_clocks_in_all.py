"""Clocks are told as all samples leave them, not as they were first found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrated import calibration, simulation
from random_robots import small_arm

from skin2urdf.calibration.late import clocks_in_all
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.records import SuClock
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.defects import UnsteadyClock


def test_what_the_fit_finds_is_added() -> None:
    along = calibration().along
    assert along is not None
    tree = along.problem.tree
    u = int(np.argmax(tree.su_joint))
    rough = SuClock(tree.su_names[u], 0.1, 5e-3, 1e-4, 1e-4, 60.0)
    stranger = SuClock("not in the tree", 0.1, 5e-3, 1e-4, 1e-4, 60.0)
    ((found, same),) = clocks_in_all([[rough, stranger]], along)
    late, fast = along.fitted.state.clock[0, u]
    assert (found.latency, found.drift) == pytest.approx((0.1 + late, 1e-4 + fast))
    assert found.latency_sd < 1e-4
    assert same == stranger
    base = replace(rough, su=tree.su_names[int(np.argmin(tree.su_joint))], latency_sd=1e-5)
    assert clocks_in_all([[base]], along) == ((base,),)


def test_a_clock_that_is_late_is_told_to_a_tenth_of_a_millisecond() -> None:
    recording = simulation().recording
    u, su = 4, recording.sus[4]
    late = replace(su, time=np.asarray(su.time + 0.4))
    sus = (*recording.sus[:u], late, *recording.sus[u + 1 :])
    result = calibrate(replace(recording, sus=sus), CalibrationSettings(gravity_deviation=0.0))
    (clock,) = (c for c in result.clocks[0] if c.su == su.name)
    assert clock.latency == pytest.approx(0.4, abs=5 * clock.latency_sd + 1e-5)
    assert clock.latency_sd < 1e-4


def test_what_a_clock_that_wanders_does_to_patterns_is_no_hit() -> None:
    """Features see a hit, and without its moment all that is left is noise and a clock."""
    settings = SimulationSettings(
        n_poses=4, seed=2, imu_rate=250.0, joint_rate=125.0, defects=(UnsteadyClock(0.01, 30.0),)
    )
    found = calibrate(retimed(simulate(small_arm(3), settings).recording))
    assert found.faults == ()
    assert found.along is not None
    assert found.along.causes == ("clock",)
    assert found.along.wandering[0] > 0.015
