"""The benchmark's features are those of the robot it names, as its estimate shows."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from benchmark_estimation import skin_of, synthesised

from skin2urdf.estimation.solve.estimate import estimate
from skin2urdf.simulation import load_robot
from skin2urdf.simulation.mechanism import load_mechanism


@pytest.mark.parametrize("count", [8, 13, 40])
def test_sus_are_spread_over_all_segments(count: int) -> None:
    robot = load_robot("panda")
    mechanism = load_mechanism(robot, robot.base_rpy)
    sus = skin_of(mechanism, count, np.random.default_rng(0))
    assert len({su.name for su in sus}) == count
    by_segment = Counter(su.joint for su in sus)
    assert len(by_segment) == mechanism.n_joints + 1
    assert max(by_segment.values()) <= -(-count // len(by_segment))


def test_the_features_are_explained_down_to_their_noise() -> None:
    features, tree = synthesised(load_robot("panda"), 10, 8, np.random.default_rng(1))
    found = estimate(features, tree)
    assert found.cost_per_dof == pytest.approx(1.0, abs=0.15)
