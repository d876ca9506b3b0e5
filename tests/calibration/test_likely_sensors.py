"""An SU on a base that sways, and what its sensor would be on the joint that makes it sway."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from synthetic import random_features, random_state

from skin2urdf import CalibrationSettings
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.rounds import Logs, estimate_robot, find_structure
from skin2urdf.notes import Note
from skin2urdf.structure.records import KinematicTree

SWAY = 0.04
"""Acceleration of the base over that of the joint that slides."""


def test_an_su_on_a_base_that_sways_is_on_no_joint_that_slides() -> None:
    """On that joint it would have to measure next to nothing of an acceleration that is known."""
    rng, clock = np.random.default_rng(6), Clock()
    tree = KinematicTree(
        ("slide", "turn", "swing"), np.array([-1, 0, 1]), ("prismatic", "revolute", "revolute"),
        ("su_base", "su_slide", "su_turn", "su_swing"), np.array([-1, 0, 1, 2]),
    )  # fmt: skip
    state = random_state(rng, tree, intrinsics=0.5)
    T = np.array(state.T_parent_joint)
    T[0, :3, :3] = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    state = replace(state, T_parent_joint=T)  # level: gravity has no part in what slides
    features = random_features(rng, tree, state, 8, noise=0.2, shuffle=False)
    coefficients = np.array(features.coefficients)
    coefficients[:, 0, 1 + tree.n_joints] += SWAY * np.array([0.6, 0.0, 0.8])
    features = replace(features, coefficients=coefficients)
    # These features are exact: they need not be taken again from any samples.
    logs = Logs((), features.su_names, CalibrationSettings(relinearisations=0))
    structure = find_structure(logs, features, clock)
    felt = structure.certain_tree
    assert felt.joint_names[felt.su_joint[felt.su_names.index("su_base")]] == "slide"
    solution = estimate_robot(logs, features, structure, clock)
    assert solution is not None
    found = solution.found.tree
    on = [found.joint_names[j] if j >= 0 else "base" for j in found.su_joint]
    assert dict(zip(found.su_names, on, strict=True)) == {
        "su_base": "base", "su_slide": "slide", "su_turn": "turn", "su_swing": "swing",
    }  # fmt: skip
    assert Note("placed by fit", ("su_base",), ("slide",), "inactive") in found.notes
