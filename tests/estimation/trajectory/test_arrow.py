"""Normal equations of which some directions show nothing still have a step."""

from __future__ import annotations

import numpy as np

from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse, newton_step
from skin2urdf.estimation.trajectory.fit import step_length
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


def test_what_many_sus_move_beside_their_link_counts_as_that_of_a_few() -> None:
    """Steps of a thousand SUs would never be as short as those of ten."""

    def length(n_sus: int, own: float) -> float:
        su, mixed = np.tile(2 * np.eye(2), (n_sus, 1, 1)), np.full((n_sus, 2, 1), 1 / n_sus)
        equations = Equations(3 * np.eye(1), su, mixed, np.zeros(1), np.zeros((n_sus, 2)))
        free = np.ones(1, dtype=bool), np.ones((n_sus, 2), dtype=bool)
        # SUs that stay relative to their link follow the joint.
        joint, follow = 2.0, -1.0 / n_sus
        return step_length(equations, np.array([joint]), np.full((n_sus, 2), follow + own), free)

    np.testing.assert_allclose(length(1000, 0.1) ** 2 - length(1000, 0.0) ** 2, 0.4, rtol=1e-6)
    np.testing.assert_allclose(length(10, 0.1) ** 2 - length(10, 0.0) ** 2, 0.4, rtol=1e-6)
    # What the joint itself moves by counts in full.
    np.testing.assert_allclose(length(1000, 0.0) ** 2, 12.0, rtol=1e-2)


def test_an_inverse_over_some_coordinates_has_nothing_of_the_others() -> None:
    """A matrix may hold what it is coupled with, as slack whose size is asked for."""
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((20, 5)) * [1.0, 10.0, 1e3, 1.0, 1e4]
    H, free = rows.T @ rows, np.array([True, True, False, True, False])
    here = np.ix_(free, free)
    np.testing.assert_allclose(joint_inverse(H, free)[here], np.linalg.inv(H[here]), rtol=1e-6)
