"""Gears that yield on a robot that never rests, whose noise has in it what they leave."""

from __future__ import annotations

from skin2urdf import calibrate
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.simulation.defects import ElasticGears
from skin2urdf.simulation.motion_settings import MotionSettings


def test_springs_are_found_where_no_more_than_noise_is_left() -> None:
    """Means over seconds leave nothing of what goes with all joints moving on and on."""
    settings = SimulationSettings(
        seed=77, excite="series", minutes=0.45, upright=True, imu_rate=100.0, joint_rate=50.0,
        motion=MotionSettings(series_band=(0.1, 0.7)), defects=(ElasticGears(28e3, 14e3),),
    )  # fmt: skip
    found = calibrate([retimed(simulate(load_robot("z1"), settings).recording)])
    assert found.along is not None
    assert found.along.misfit < 1
    assert "elastic" in found.along.causes
    assert not found.carried_along
