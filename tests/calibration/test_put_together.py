"""Slips that features told: what all samples do not need is none, and what they do stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_robots import small_arm

from skin2urdf.calibration.beginning import begin
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.pipeline import recordings_of
from skin2urdf.calibration.rounds import relinearise, take_features
from skin2urdf.calibration.samples import fit_samples
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.calibration.taken_apart import with_sus_together
from skin2urdf.faults import Fault
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.hypotheses.slip import Moment, Slipped
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.faults import Sound, recorded_after


@pytest.mark.parametrize("degrees", [0.0, 0.5])
def test_all_samples_have_the_last_word_about_a_slip(degrees: float) -> None:
    robot = small_arm(2)
    settings = SimulationSettings(
        n_poses=4, excite="all", seed=5, imu_rate=250.0, joint_rate=125.0, gyro="mems"
    )
    sound = Sound(robot, settings, simulate(robot, settings))
    recording = sound.simulation.recording
    su = max(sound.simulation.moved.sus, key=lambda su: su.joint)
    turned = np.eye(4)
    turned[:3, :3] = rotation_exp(np.deg2rad(degrees) * np.array([0.6, 0.0, 0.8]))
    later = recorded_after(sound, su.name, turned).specific_force
    (at,) = (i for i, s in enumerate(recording.sus) if s.name == su.name)
    stream = recording.sus[at]
    middle = len(stream.time) // 2
    force = np.concatenate([stream.specific_force[:middle], later[middle:]])
    sus = list(recording.sus)
    sus[at] = replace(stream, specific_force=force)
    clock = Clock(None)
    recordings = recordings_of(replace(recording, sus=tuple(sus)), lambda _: None)
    begun = begin(recordings, CalibrationSettings(), clock)
    assert begun.first is not None
    earlier, when = f"{su.name}_before", float(stream.time[middle])
    slip = Slipped(su.name, earlier, Moment((0, when), (0, when)))
    logs, tree = slip.of_placements(begun.logs, begun.first.found.tree)
    features = take_features(logs, clock)
    found, features = relinearise(logs, tree, features, clock)
    fault = Fault("loose", su.name, sus=(su.name, earlier))
    apart = replace(begun.first, logs=logs, found=found, features=features, faults=(fault,))
    along = fit_samples(apart, lambda _: None)
    assert along is not None
    solution, fitted = with_sus_together(apart, along, clock)
    if degrees:
        assert (solution, fitted) == (apart, along)
        return
    assert solution.faults == ()
    assert fitted.problem.tree.su_names == begun.first.found.tree.su_names
    assert solution.logs.su_names == begun.logs.su_names
    u = solution.logs.su_names.index(su.name)
    (mended,), (whole,) = solution.logs.sampled, begun.logs.sampled
    np.testing.assert_array_equal(mended.valid[:, u], whole.valid[:, u])
    assert mended.turning is not None
    assert whole.turning is not None
    np.testing.assert_array_equal(mended.turning.valid, whole.turning.valid)
