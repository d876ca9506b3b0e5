"""Where patterns show no start, rests and moves do."""

from __future__ import annotations

from dataclasses import replace

from simulated import simulation

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.calibration.rounds import estimate_robot, find_structure, sample_logs, take_features
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.recording.records import Recording


def of_a_few_patterns() -> Recording:
    """A recording whose patterns lead all starts astray that a bare segment leaves."""
    return simulation("panda", n_poses=6, excite="all", seed=70007).recording


def test_patterns_of_all_joints_with_a_bare_segment() -> None:
    recording = of_a_few_patterns()
    bare = replace(recording, sus=tuple(su for su in recording.sus if su.name != "su_af84"))
    clock = Clock(None)
    logs = sample_logs([bare], CalibrationSettings(), clock)
    features = take_features(logs, clock)
    found = estimate_robot(logs, features, find_structure(logs, features, clock), clock)
    assert found is not None
    assert set(range(7)) > set(found.found.tree.su_joint.tolist()) - {-1}
    assert found.found.cost_per_dof < GOOD_FIT
