"""What sliding joints alone carry faces one way, although gravity tells nothing of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from random_robots import Joint, robot_of

from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.sampling import sampled_together
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout
from skin2urdf.structure.from_motion import trees_from_motion

RAIL = Joint("rail", -1, "prismatic", rpy=(0.9, 0.4, 0.0), limits=(-0.2, 0.2))
CROSS = Joint("cross", 0, "prismatic", rpy=(0.0, 1.2, 0.7), limits=(-0.2, 0.2))
AS_GRAVITY_SHOWS = 0.1
"""Error of a direction [rad] from which all samples lead to the right one."""


def turning(before: int) -> Joint:
    return Joint("turns", before, "revolute", (0.02, 0.03, 0.25), (0.8, 0.3, 0.0))


ROBOTS = {"rail": (RAIL, turning(0)), "two rails": (RAIL, CROSS, turning(1))}


@pytest.mark.parametrize("joints", ROBOTS.values(), ids=ROBOTS.keys())
def test_sus_on_rails_start_as_they_face(joints: tuple[Joint, ...], tmp_path: Path) -> None:
    settings = SimulationSettings(
        n_poses=8, seed=1, excite="none", upright=True, imu_rate=100.0, joint_rate=50.0
    )
    simulation = simulate(robot_of(joints, tmp_path, SkinLayout(1, 0)), settings)
    logs, names = sampled_together([retimed(simulation.recording)])
    found, *_ = trees_from_motion(logs, names)
    assert found.tree.joint_types == tuple(joint.kind for joint in joints)
    slides = [joint.name for joint in joints if joint.kind == "prismatic"]
    model = pin.buildModelFromXML(simulation.truth.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    rails = [data.oMi[model.getJointId(n)].rotation[:, 2] for n in slides]
    for name, R in zip(found.tree.su_names, found.R_base_su, strict=True):
        true = data.oMf[model.getFrameId(name)].rotation
        # From the frame of each SU: the base's own yaw is a choice.
        for rail, axis in zip(rails, found.axes, strict=False):
            assert np.linalg.norm(R.T @ axis - true.T @ rail) < AS_GRAVITY_SHOWS
