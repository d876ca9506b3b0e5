"""Gravity of another size is no wrong encoder of a joint that slides."""

from __future__ import annotations

from pathlib import Path

import pytest
from random_robots import Joint, robot_of

from skin2urdf import calibrate
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.defects import LocalGravity
from skin2urdf.simulation.robots import SkinLayout

_SIZE = 9.775


def test_a_slide_tells_the_size_of_gravity(tmp_path: Path) -> None:
    joints = (
        Joint("slides", -1, "prismatic", rpy=(0.4, 0.2, 0.0), limits=(-0.2, 0.2)),
        Joint("turns", 0, "revolute", rpy=(1.2, 0.0, 0.0)),
        Joint("bends", 1, "revolute", rpy=(0.3, 1.0, 0.0)),
    )
    settings = SimulationSettings(
        n_poses=4, seed=3, excite="all", imu_rate=200.0, joint_rate=125.0, encoder_bits=None,
        defects=(LocalGravity(_SIZE),),
    )  # fmt: skip
    robot = robot_of(joints, tmp_path, SkinLayout(1, 0))
    found = calibrate(retimed(simulate(robot, settings).recording))
    assert found.faults == ()
    # Features take gravity as given: of the wrong size it leaves three times their noise and more.
    assert found.estimate.cost_per_dof < 1.5
    assert found.along is not None
    assert found.along.fitted.state.gravity == pytest.approx(_SIZE, abs=5e-3)
