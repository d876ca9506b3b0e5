"""SUs that a first look hangs on a wrong joint, and all samples on the right one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_robots import Joint, robot_of, small_arm
from simulated import simulation_of

from skin2urdf.calibration import at_rest
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout
from skin2urdf.structure.from_motion import MotionTree, trees_of_both_kinds


@pytest.mark.parametrize(("farther", "restless"), [(True, False), (False, False), (True, True)])
def test_an_su_on_a_wrong_joint_is_hung_on_the_right_one(
    farther: bool, restless: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the bias of another SU wanders, of which much is left whatever the tree is."""
    made = simulation_of(small_arm(3), excite="none", minutes=0.8)
    recording = made.recording
    if restless:
        *others, last = recording.sus
        wander = 0.15 * np.sin(2 * np.pi * 0.1 * last.time)[:, None] * [1.0, -0.5, 0.7]
        last = replace(last, specific_force=last.specific_force + wander)
        recording = replace(recording, sus=(*others, last))
    right: list[MotionTree] = []

    def wrong(*args: Any, **more: Any) -> list[tuple[MotionTree, ...]]:
        found = trees_of_both_kinds(*args, **more)[0][0]
        right.append(found)
        tree, su_joint = found.tree, found.tree.su_joint.copy()
        joint = 1
        u = int(np.flatnonzero(su_joint == joint)[0])
        su_joint[u] = joint + 1 if farther else joint - 1
        return [(replace(found, tree=replace(tree, su_joint=su_joint)),)]

    monkeypatch.setattr(at_rest, "trees_of_both_kinds", wrong)
    found = calibrate(recording)
    assert found.model.tree.is_like(right[0].tree)
    assert found.quality == ("fair" if restless else "good")


ON_A_RAIL = (
    Joint("rail", -1, "prismatic", (0.0, 0.0, 0.3), (0.0, np.pi / 2, 0.0), limits=(-0.4, 0.4)),
    Joint("shoulder", 0, "revolute", (0.1, 0.0, 0.05), (0.3, 0.0, 0.0)),
    Joint("elbow", 1, "revolute", (0.3, 0.0, 0.0), (np.pi / 2, 0.0, 0.4)),
)


def test_a_branch_beside_a_slide_is_hung_behind_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gravity turns alike in all of the arm whether it stands on the rail or beside it."""
    settings = SimulationSettings(
        n_poses=6, seed=2, excite="none", minutes=0.4, joint_rate=50.0, imu_rate=50.0
    )
    made = simulate(robot_of(ON_A_RAIL, tmp_path, SkinLayout(1, 0)), settings)
    right: list[MotionTree] = []

    def beside(*args: Any, **more: Any) -> list[tuple[MotionTree, ...]]:
        found = trees_of_both_kinds(*args, **more)[0][0]
        right.append(found)
        parent = found.tree.parent.copy()
        parent[found.tree.joint_names.index("shoulder")] = -1
        return [(replace(found, tree=replace(found.tree, parent=parent)),)]

    monkeypatch.setattr(at_rest, "trees_of_both_kinds", beside)
    found = calibrate(made.recording)
    assert found.model.tree.is_like(right[0].tree)
