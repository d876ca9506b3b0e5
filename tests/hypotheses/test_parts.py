"""Where a log is parted to see what changes in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from synthetic import random_features, random_state, serial_tree

from skin2urdf.hypotheses.parts import middle


def test_a_log_is_parted_where_its_halves_are_most_alike() -> None:
    """As with a pattern in the second pose that is spoilt: the pose that holds the middle is early.

    Three poses with patterns are left after it. Two of them leave more than one robot.
    """
    rng = np.random.default_rng(0)
    length = np.array([*(0.9,) * 13, 14.1, 1.4, 0.8, 14.0, 14.1, 14.2, 13.8])
    end = np.cumsum(length + 2.0)
    tree = serial_tree(3)
    features = random_features(rng, tree, random_state(rng, tree), len(length), 0.05, False)
    poses = replace(features, span=np.stack([end - length, end], axis=1))
    assert length[:17].sum() < length.sum() / 2 < length[:18].sum()
    assert middle(poses) == end[16]
    assert middle(poses.of_poses(np.array([0]))) == end[0]
