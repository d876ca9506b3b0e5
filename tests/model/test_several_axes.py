"""SUs that a recording could place are those that turn about axes which are not parallel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import random_state, serial_tree

from skin2urdf.geometry.se3 import screw
from skin2urdf.model.several_axes import turned_about_several_axes


@pytest.mark.parametrize("bend", [0.0, 0.5])
def test_only_axes_that_are_not_parallel_place_an_su(bend: float) -> None:
    """Turns, slides, turns about a parallel axis or another one, slides, and turns askew."""
    tree = serial_tree(5, prismatic=(1, 3))
    slide = screw("x", 0.7, 0.1)
    placements = np.stack(
        [
            screw("y", 0.3, 0.2),
            slide,
            np.linalg.inv(slide) @ screw("x", bend, 0.3) @ screw("z", 0.4, 0.0),
            screw("y", 1.2, 0.1),
            screw("x", 0.9, 0.2),
        ]
    )
    model = random_state(np.random.default_rng(0), tree).model(tree)
    placed = turned_about_several_axes(replace(model, T_parent_joint=placements), 0.1)
    assert placed.tolist() == [False, False, bend > 0, bend > 0, True]
