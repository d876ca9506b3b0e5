"""Calibration of robots that MuJoCo moved: an independent witness for the whole way through."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from mujoco_robot import (
    Arm,
    excitation,
    random_arm,
    record,
    tracking_errors,
    truth_urdf,
    two_arms,
    upright,
)
from simulated import held_against

from skin2urdf.arrays import F64
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.recording.records import Recording
from skin2urdf.urdf.records import Comparison


@dataclass(frozen=True, eq=False)
class Witness:
    """An arm, what was recorded of it, and what the calibration made of the recording."""

    arm: Arm
    recording: Recording
    tracking: F64
    calibration: Calibration
    comparison: Comparison


def soft(arm: Arm) -> Arm:
    """Drives that sag three times as far and stick."""
    return replace(arm, stiffness=1000.0, friction=1.0)


CASES = {
    "7 joints, one after the other": (random_arm(1, 7), False, 17),
    "6 joints at once": (random_arm(2, 6), True, 17),
    "6 joints upright, soft drives": (soft(upright(random_arm(4, 6))), False, 16),
}


@pytest.fixture(scope="module", params=CASES, ids=str)
def witness(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Witness:
    return witnessed(*CASES[request.param], tmp_path_factory.mktemp("mujoco"))


def witnessed(arm: Arm, at_once: bool, bits: int, folder: Path) -> Witness:
    rng = np.random.default_rng(11)
    path = excitation(arm, 4, at_once, rng)
    sus = [f"skin_{n:02x}" for n in rng.permutation(256)[: arm.n_joints + 1]]
    joints = [f"motor_{n}" for n in rng.permutation(arm.n_joints)]
    recording = record(arm, path, sus, joints, rng, bits=bits)
    calibration = calibrate(recording)
    comparison = held_against(calibration, truth_urdf(arm, sus, joints), folder)
    tracking = tracking_errors(arm, recording, path, joints)
    return Witness(arm, recording, tracking, calibration, comparison)


def test_the_recording_is_no_ideal_one(witness: Witness) -> None:
    """Drives lag, sag and pull each other along, by more than an encoder's step."""
    assert (witness.tracking > 5e-4).all()
    assert witness.tracking.max() > 2e-3
    assert 60.0 < witness.recording.duration < 200.0


def test_the_tree_is_right(witness: Witness) -> None:
    assert witness.comparison.tree_equal, witness.comparison.tree_differences
    assert witness.calibration.model.tree.n_joints == witness.arm.n_joints
    assert witness.calibration.model.tree.n_sus == witness.arm.n_joints + 1


def test_the_model_explains_the_readings(witness: Witness) -> None:
    assert 0.5 < witness.calibration.estimate.cost_per_dof < 3.0


def test_everything_is_where_it_really_is(witness: Witness) -> None:
    c = witness.comparison
    assert c.position.rms < 0.4e-3
    assert c.position.max < 1e-3
    assert np.rad2deg(c.orientation.rms) < 0.05
    assert np.rad2deg(c.axis_angle.rms) < 0.03
    assert c.axis_distance.rms < 0.4e-3


def test_only_the_first_segment_and_the_base_are_not_observable(witness: Witness) -> None:
    tree, seen = witness.calibration.model.tree, witness.calibration.observability
    for joint, verdict in zip(tree.su_joint, seen.su_verdict, strict=True):
        assert verdict == ("determined" if joint > 0 else "not observable")
    assert all(v == "determined" for v in seen.joint_verdict)


def test_a_tree_with_sliding_joints_is_calibrated_as_well(tmp_path: Path) -> None:
    """A waist that lifts and turns, two arms on it, one of them a telescope."""
    robot = two_arms()
    witness = witnessed(robot, False, 17, tmp_path)
    tree, seen = witness.calibration.model.tree, witness.calibration.observability
    assert witness.tracking.max() > 2e-3
    assert witness.comparison.tree_equal, witness.comparison.tree_differences
    assert tree.prismatic.sum() == sum(joint.slides for joint in robot.joints) == 2
    assert 0.5 < witness.calibration.estimate.cost_per_dof < 3.0
    test_everything_is_where_it_really_is(witness)
    # One arm's place along the waist's axis shows in nothing; what lifts alone turns nothing.
    assert seen.joint_verdict.count("not observable") == 1
    beyond = [tree.chain(int(joint)) for joint in tree.su_joint]
    for chain, verdict in zip(beyond, seen.su_verdict, strict=True):
        assert verdict == ("determined" if len(chain) > 2 else "not observable")
