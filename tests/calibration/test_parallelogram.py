"""An encoder that reads the sum of two joints, as that of a forearm on a parallelogram does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf import calibrate
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, load_robot, simulate

SHOULDER, ELBOW = "shoulder_lift_joint", "elbow_joint"


def test_what_carries_sus_along_without_turning_them_is_named() -> None:
    """Gravity is explained, which is most of what they feel, and the tree is wrong all the same."""
    settings = SimulationSettings(
        seed=31, excite="none", minutes=0.8, upright=True, imu_rate=100.0, joint_rate=50.0
    )
    recording = simulate(load_robot("ur5"), settings).recording
    shoulder, elbow = (
        next(joint for joint in recording.joints if joint.name == name)
        for name in (SHOULDER, ELBOW)
    )
    both = elbow.position + np.interp(elbow.time, shoulder.time, shoulder.position)
    joints = tuple(
        replace(joint, position=both) if joint.name == ELBOW else joint
        for joint in recording.joints
    )
    found = calibrate([retimed(replace(recording, joints=joints))])
    assert found.quality == "bad"
    carried = dict(found.carried_along)
    assert set(carried.values()) == {SHOULDER}
    tree = found.model.tree
    beyond = {
        name
        for name, joint in zip(tree.su_names, tree.su_joint, strict=True)
        if tree.joint_names.index(ELBOW) in tree.chain(int(joint))
    }
    assert set(carried) == beyond
