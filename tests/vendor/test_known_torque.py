"""Joints that yield under the loads that a vendor's model knows: their stiffness, and SUs in place.

The simulation integrates masses on springs; the estimator has the inverse dynamics of the model.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from vendor.model_robot import URDF, model, recorded

from skin2urdf.geometry.se3 import inverse, log
from skin2urdf.report.model_document import as_document
from skin2urdf.simulation.defects import ElasticGears
from skin2urdf.vendor.calibrate import calibrate_with_model
from skin2urdf.vendor.description import describe
from skin2urdf.vendor.inertials import inertials
from skin2urdf.vendor.matching import match


def test_stiffness_is_found_and_sus_are_where_they_are(tmp_path: Path) -> None:
    near, far = 3000.0, 500.0
    gears = recorded(tmp_path, minutes=0.25, defects=(ElasticGears(near, far),))
    found = calibrate_with_model(gears.recording, model())
    # What yields is no deviation of the model's geometry.
    assert not found.deviates
    compliance, deviation = found.compliance
    stiff = dict(zip(found.tree.joint_names, zip(compliance, deviation, strict=True), strict=True))
    # The load of the vertical axis is its inertia alone, and says less.
    for name, true in (("lift", near), ("roll", far)):
        c, sd = stiff[name]
        assert abs(c - 1 / true) < 4 * sd
        assert sd < 0.1 / true
    for u, name in enumerate(found.tree.su_names):
        if found.observability.su_verdict[u] == "determined":
            off = log(inverse(gears.T_link_su[name]) @ found.T_link_su[u])
            assert off @ np.linalg.solve(found.observability.su_covariance[u], off) < 25
    told = as_document(found)["model"]["joints"]["lift"]
    assert (told["compliance"], told["compliance_sd"]) == stiff["lift"]


def test_a_joint_carries_what_is_fixed_to_its_link_in_its_own_frame() -> None:
    import pinocchio as pin

    chassis = match(describe(model()), ["turn", "lift", "roll"])
    found = inertials(chassis)
    assert found is not None
    whole = pin.buildModelFromXML(URDF)
    # Pinocchio counts what a fixed joint carries, and the finger that the log does not move.
    still = pin.buildReducedModel(whole, [whole.getJointId("grip")], pin.neutral(whole))
    for j, name in enumerate(("turn", "lift", "roll")):
        body = still.inertias[still.getJointId(name)]
        R = chassis.R_link_joint[j].T
        turned = pin.SE3(R, np.zeros(3)).act(body)
        assert np.allclose(found[10 * j : 10 * (j + 1)], turned.toDynamicParameters(), atol=1e-12)


def test_a_file_without_masses_knows_no_loads() -> None:
    import re

    bare = re.sub(r"<inertial>.*?</inertial>", "", URDF, flags=re.DOTALL)
    assert inertials(match(describe(model(bare)), ["turn", "lift", "roll"])) is None
