"""Arms with parallel axes: gravity tells little of them, and sensors could stand for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_robots import Joint, robot_of
from simulated import held_against

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.defects import WarmUp
from skin2urdf.simulation.robots import SkinLayout

COAXIAL = (
    Joint("below", -1, "revolute", (0.1, 0.0, 0.2)),
    Joint("above", 0, "revolute", (0.0, 0.0, 0.07)),
)
PLANAR = (
    Joint("first", -1, "revolute", (0.11, 0.0, 0.13)),
    Joint("second", 0, "revolute", (0.12, -0.06, 0.07)),
)
ABOUT = {"excite": "all", "n_poses": 3, "imu_rate": 100.0, "joint_rate": 125.0}


@pytest.fixture(scope="module")
def coaxial(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    folder = tmp_path_factory.mktemp("coaxial")
    settings = SimulationSettings(seed=1, upright=True, **ABOUT)  # type: ignore[arg-type]
    made = simulate(robot_of(COAXIAL, folder, SkinLayout(1, 1)), settings)
    return calibrate(retimed(made.recording))


def test_joints_on_one_vertical_axis_turn_the_right_way(coaxial: Calibration) -> None:
    """Patterns tell as well of the mirror image, in which no SU would feel how fast it turns."""
    assert np.abs(coaxial.estimate.state.shape).max() < 0.02
    assert coaxial.quality != "bad"


def test_a_robot_of_which_no_su_is_placed_is_not_good(coaxial: Calibration) -> None:
    """No other recording would tell where SUs are along axes that are all parallel."""
    assert "determined" not in coaxial.observability.su_verdict
    assert coaxial.mostly_open
    assert coaxial.quality == "fair"


def test_what_no_sensor_is_makes_a_result_bad(coaxial: Calibration) -> None:
    """Also where no recording could place any SU."""
    state, tree = coaxial.estimate.state, coaxial.model.tree
    for sus, quality in ((tree.su_joint >= 0, "bad"), (tree.su_joint < 0, "fair")):
        shape = np.where(sus[:, None], 0.9, state.shape)
        found = replace(coaxial.estimate, state=replace(state, shape=shape))
        assert replace(coaxial, estimate=found).quality == quality


def test_biases_that_drift_bend_no_sensors_of_a_planar_arm(tmp_path: Path) -> None:
    """Rests that drift apart look like sensors that are bent, and those like a base that tilts."""
    settings = SimulationSettings(
        seed=4, base_rpy=(1.1, 0.2, 0.0), defects=(WarmUp(0.03, 30.0),), **ABOUT
    )  # type: ignore[arg-type]
    made = simulate(robot_of(PLANAR, tmp_path, SkinLayout(1, 0)), settings)
    found = calibrate(retimed(made.recording))
    assert found.along is not None
    assert found.along.causes == ("drift",)
    assert np.abs(found.along.state.shape).max() < 0.02
    compared = held_against(found, made.truth.urdf, tmp_path)
    assert all(su.position is None or su.position.rms < 3e-3 for su in compared.sus)


def test_a_scara_is_found_although_nothing_is_known_of_levers_and_clocks(tmp_path: Path) -> None:
    """Where an SU sits on its axis nothing changes, so that no lag seems to change anything."""
    arm = (
        Joint("first", -1, "revolute", (0.0, 0.0, 0.1), rpy=(0.002, 0.001, 0.0)),
        Joint("second", 0, "revolute", (0.3, 0.0, 0.1)),
        Joint("slide", 1, "prismatic", (0.3, 0.0, 0.1)),
        Joint("hand", 2, "revolute", (0.0, 0.0, 0.1)),
    )
    settings = SimulationSettings(
        seed=8, upright=True, excite="none", minutes=1.0, imu_rate=100.0, joint_rate=125.0, lag=0.03
    )
    made = simulate(robot_of(arm, tmp_path, SkinLayout(1, 1)), settings)
    found = calibrate(retimed(made.recording))
    assert found.quality != "bad"
    compared = held_against(found, made.truth.urdf, tmp_path)
    assert compared.tree_equal
    assert all(su.position is None or su.position.rms < 4e-3 for su in compared.sus)
