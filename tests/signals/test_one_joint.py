"""Clocks of SUs that one joint alone moves, by so little that the rest of the log hides it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from random_robots import Joint, robot_of
from simulated import changed_sus

from skin2urdf.recording.records import SuStream
from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.clocks import su_clocks
from skin2urdf.signals.motion import joint_motion
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout

ARM = (
    Joint("elbow", 0, "revolute", (0.05, 0.0, 0.2), (1.5, 0.0, 0.0)),
    Joint("wrist", 1, "revolute", (0.2, 0.05, 0.0), (0.3, 1.2, 0.0)),
    Joint("hand", 2, "revolute", (0.05, 0.1, 0.1), (-1.2, 0.3, 0.0)),
)
FIRST = {
    "rail": Joint("rail", -1, "prismatic", rpy=(1.5, 0.4, 0.0), limits=(-0.2, 0.2)),
    "pan": Joint("pan", -1, "revolute"),
}


@pytest.mark.parametrize("first", FIRST.values(), ids=FIRST.keys())
def test_the_clock_of_an_su_next_to_the_base_is_found(first: Joint, tmp_path: Path) -> None:
    settings = SimulationSettings(
        excite="none", minutes=1.0, seed=3, upright=True, imu_rate=100.0, joint_rate=50.0
    )
    simulation = simulate(robot_of((first, *ARM), tmp_path, SkinLayout(1, 1)), settings)
    joint = {su.name: su.joint for su in simulation.truth.sus}
    recording = retimed(simulation.recording)

    def late(su: SuStream) -> SuStream:
        return replace(su, time=su.time + (0.7 if joint[su.name] < 1 else 0.3))

    recording = changed_sus(recording, late)
    found = {joint[c.su]: c for c in su_clocks(recording.sus, joint_motion(recording))}
    assert found[0].latency == pytest.approx(0.7, abs=max(0.005, 3 * found[0].latency_sd))
    assert found[0].latency_sd < 0.05
    assert -1 not in found  # nothing moves it
