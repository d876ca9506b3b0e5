"""What one log says of the others is asked before anything is attempted."""

from __future__ import annotations

from dataclasses import replace

import pytest
from random_robots import small_arm
from simulated import PATTERNS

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.hypotheses.attempts import Search
from skin2urdf.hypotheses.records import Amendment, Attempt
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.faults import Sound, in_two


def test_a_sense_that_a_jump_imitates_takes_one_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = SimulationSettings(n_poses=4, excite="all", seed=2, imu_rate=250.0, joint_rate=125.0)
    robot = small_arm(3)
    first, second = in_two(Sound(robot, settings, simulate(robot, settings)))
    joints = [replace(j, position=-j.position) if j.name == "j2" else j for j in second.joints]
    attempted: list[tuple[Amendment, ...]] = []
    attempt = Search.attempt

    def counted(
        search: Search, amendments: tuple[Amendment, ...], beside: Attempt | None
    ) -> Attempt:
        attempted.append(amendments)
        return attempt(search, amendments, beside)

    monkeypatch.setattr(Search, "attempt", counted)
    logs = [retimed(first), retimed(replace(second, joints=tuple(joints)))]
    found = calibrate(logs, PATTERNS)
    assert [(fault.kind, fault.subject) for fault in found.faults] == [("encoder sign", "j2")]
    assert len(attempted) == 1
