"""SUs that a first look hangs on a wrong joint, and all samples on the right one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from random_robots import small_arm
from simulated import simulation_of

from skin2urdf.calibration import at_rest
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.structure.from_motion import MotionTree, trees_of_both_kinds


@pytest.mark.parametrize("farther", [True, False])
def test_an_su_on_a_wrong_joint_is_hung_on_the_right_one(
    farther: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = simulation_of(small_arm(3), excite="none", minutes=0.8)
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
    found = calibrate(made.recording)
    assert found.model.tree.is_like(right[0].tree)
    assert found.quality == "good"
