"""Joints that gravity does not show are put into a draft of a tree as what they may be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from random_robots import Joint, robot_of

from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.sampling import sampled_together
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout
from skin2urdf.structure.accelerations import Along, along
from skin2urdf.structure.draft import Draft
from skin2urdf.structure.hidden_joints import with_unseen_joints

TURNS = Joint("turns", -1, "revolute")


def of_a_vertical_joint(folder: Path, gyro: str | None = None) -> tuple[Along, Draft]:
    """A log of one joint, and the draft that gravity shows of it: SUs as if on the base."""
    settings = SimulationSettings(
        n_poses=12, seed=1, excite="none", upright=True, imu_rate=250.0, joint_rate=125.0, gyro=gyro
    )
    simulation = simulate(robot_of((TURNS,), folder, SkinLayout(1, 1)), settings)
    logs, names = sampled_together([retimed(simulation.recording)])
    true = {su.name: su.T_joint_su[:3, :3] for su in simulation.truth.sus}
    n_sus = len(names)
    draft = Draft(
        joints=(),
        parent=(),
        su_joint=np.full(n_sus, -1),
        R=np.array([true[name] for name in names]),
        sensor=np.zeros((n_sus, 9)),
        up=np.array([[0.0, 0.0, 1.0]]),
    )
    return along(logs), draft


def test_a_joint_known_to_slide_is_never_put_in_as_turning(tmp_path: Path) -> None:
    """It would be found to slide, and put in again as turning, for ever."""
    samples, draft = of_a_vertical_joint(tmp_path)
    turning, _ = with_unseen_joints(draft, samples, [0])
    assert [joint.kind for joint in turning.joints] == ["revolute"]
    sliding, others = with_unseen_joints(draft, samples, [0], sliding=[0])
    assert not any(j.kind == "revolute" for d in (sliding, *others) for j in d.joints)


def test_a_base_that_sways_with_its_first_joint_does_not_turn_with_it(tmp_path: Path) -> None:
    """An SU on it feels what a lever arm on the joint would make; its gyroscope reads nothing."""
    samples, draft = of_a_vertical_joint(tmp_path, gyro="mems")
    turning, _ = with_unseen_joints(draft, samples, [0])
    (on_base,) = np.flatnonzero(turning.su_joint < 0)
    sways = 0.05 * samples.qdd * draft.R[on_base].T[:, 0]
    readings = samples.readings.copy()
    readings[:, on_base] += sways
    found, _ = with_unseen_joints(draft, replace(samples, readings=readings), [0])
    assert [joint.kind for joint in found.joints] == ["revolute"]
    np.testing.assert_array_equal(found.su_joint, turning.su_joint)
