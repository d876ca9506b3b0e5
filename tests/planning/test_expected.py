"""What is foreseen of a calibration from a plan alone."""

from __future__ import annotations

import numpy as np

from skin2urdf.model.records import KinematicModel
from skin2urdf.planning.expected import expected, sensors_of
from skin2urdf.planning.records import Plan
from skin2urdf.simulation import GRADES


def test_what_is_known_of_gravity_is_no_matter_of_noise(plan: Plan, model: KinematicModel) -> None:
    foreseen = [
        expected(plan.trajectory, model, sensors_of(GRADES["mems"]), seed=seed) for seed in (0, 2)
    ]
    position = np.array([each.position for each in foreseen])
    known = np.isfinite(position).all(axis=0)
    assert known.any()
    ratio = position[0, known] / position[1, known]
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
    # Where gravity is not told, lengths are as uncertain as it is: forty times more.
    elsewhere = foreseen[0].position_elsewhere[known]
    assert (position[0, known] < 0.1 * elsewhere).all()
