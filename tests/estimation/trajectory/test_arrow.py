"""Normal equations of which some directions show nothing still have a step."""

from __future__ import annotations

import numpy as np

from skin2urdf.estimation.trajectory.arrow import eliminated, newton_step
from skin2urdf.estimation.trajectory.records import Equations


def test_coordinates_that_are_one_and_the_same_but_for_rounding_have_a_step() -> None:
    """What rounding leaves of two such coordinates may be a singular matrix."""
    alike = 1.0 + 1e-9
    su = np.array([[[1.0, alike], [alike, 1.0]]])
    equations = Equations(np.eye(1), su, np.zeros((1, 2, 1)), np.ones(1), np.ones((1, 2)))
    free = np.ones(1, dtype=bool), np.ones((1, 2), dtype=bool)
    joint, own = newton_step(eliminated(equations, *free), free[0])
    np.testing.assert_allclose(joint, 1.0, rtol=1e-6)
    np.testing.assert_allclose(own, 0.5, rtol=1e-6)
