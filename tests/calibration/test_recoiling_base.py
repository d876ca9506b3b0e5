"""A base that recoils under its robot: an SU on it tells, and lengths are as they are.

MuJoCo moves an arm on a slab that slides on springs. What the arm pushes the slab by goes with the
arm's own motion, as longer or shorter links would: without the SU on the base nothing tells.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from joint_paths import JointPath
from mujoco_robot import random_arm, record, truth_urdf, upright
from simulated import held_against

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.report.document import as_document
from skin2urdf.report.verdict import doubts


def test_what_a_base_recoils_by_makes_no_lengths(tmp_path: Path) -> None:
    arm = replace(upright(random_arm(2, 4)), slab=(150.0, 1.5))
    rng = np.random.default_rng(3)
    path = JointPath([0.0] * arm.n_joints).rest(1.0)
    for pose in rng.uniform(-1.2, 1.2, (16, arm.n_joints)):
        path.move(pose, 1.3).rest(0.7)
    sus = [f"skin_{n}" for n in range(arm.n_joints + 1)]
    joints = [f"motor_{n}" for n in range(arm.n_joints)]
    found = calibrate(record(arm, path, sus, joints, rng))
    compared = held_against(found, truth_urdf(arm, sus, joints), tmp_path)
    assert compared.tree_equal
    assert found.along is not None
    base = found.along.moving_base
    assert base is not None
    assert base.names == (sus[0],)
    assert as_document(found)["samples"]["base_felt"][sus[0]] > 0.01
    assert "moving base" not in [doubt.kind for doubt in doubts(found)]
    share = np.random.default_rng(0).uniform(size=(60, arm.n_joints))
    q = found.limits[:, 0] + share * (found.limits[:, 1] - found.limits[:, 0])
    stated, _ = aligned_deviations(found.estimate, found.observability, q)
    assert compared.position.rms < 2.0 * float(np.sqrt(np.nanmean(stated**2)))
    assert compared.position.rms < 0.3e-3
