"""SUs of which slow moves do not tell whether they sit on the base or on a vertical joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_robots import Joint, robot_of
from simulated import changed_sus

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.trajectory.vertical import NEAREST, Arm, arms
from skin2urdf.recording.records import Recording, SuStream
from skin2urdf.report.verdict import doubts
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import GivenSu, SkinLayout

JOINTS = (
    Joint("pan", -1, "revolute"),
    Joint("lift", 0, "revolute", rpy=(np.pi / 2, 0.0, 0.0)),
    Joint("roll", 1, "revolute", xyz=(0.2, 0.1, 0.0), rpy=(0.0, np.pi / 2, 0.0)),
)
ARM = 0.05
"""Of the SU on the vertical joint [m]."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Moves of an upright robot."""
    given = (
        GivenSu("base", (0.1, 0.0, 0.0), (0.2, 0.0, 0.1)),
        GivenSu("link_pan", (0.03, 0.04, 0.1), (0.3, 0.2, 0.1)),
        GivenSu("link_lift", (0.1, 0.05, 0.02), (0.0, 0.4, 0.0)),
        GivenSu("link_roll", (0.05, 0.1, 0.0), (0.0, 0.4, 0.7)),
    )
    robot = robot_of(JOINTS, tmp_path_factory.mktemp("robot"), SkinLayout(0, 0, given=given))
    settings = SimulationSettings(excite="none", minutes=1.0, seed=2, upright=True)
    return simulate(robot, settings).recording


def noisy(recording: Recording, noise: float) -> Recording:
    """With more noise in all readings [m/s^2]."""
    rng = np.random.default_rng(1)

    def worse(su: SuStream) -> SuStream:
        more = noise * rng.standard_normal(su.specific_force.shape)
        return replace(su, specific_force=su.specific_force + more)

    return changed_sus(recording, worse)


def told(found: Calibration) -> list[Arm]:
    assert found.along is not None
    return sorted(arms(found.along.problem, found.along.state), key=lambda arm: arm.on_joint)


def test_moves_show_which_sus_a_vertical_joint_carries(log: Recording) -> None:
    base, pan = told(calibrate(log))
    assert (base.on_joint, pan.on_joint) == (False, True)
    assert base.shown
    assert pan.shown
    assert base.reach < 0.005
    assert pan.reach == pytest.approx(ARM, abs=0.01)


def test_where_noise_hides_the_arm_the_place_is_open(log: Recording) -> None:
    found = calibrate(noisy(log, 0.4))
    hidden = [arm for arm in told(found) if not arm.shown]
    assert hidden
    assert all(arm.reach > NEAREST for arm in hidden)
    assert found.quality == "fair"
    (doubt,) = (d for d in doubts(found) if d.kind == "SUs of two places")
    assert set(doubt.names) == {arm.su for arm in hidden}
