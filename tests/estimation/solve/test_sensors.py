"""Bias and shape solved for given placements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import random_cost, random_state, random_step, random_tree

from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.problem.state import State, identifiable, moved
from skin2urdf.estimation.solve.gauss_newton import gauss_newton
from skin2urdf.estimation.solve.sensors import sensors_refitted
from skin2urdf.geometry.units import GRAVITY

PRIORS = Priors(bias=0.3, scale=0.02, cross=0.01, gravity=GRAVITY)


def problem(seed: int) -> tuple[Cost, State]:
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, 5, 6)
    truth = random_state(rng, tree)
    return random_cost(rng, tree, truth, 8, noise=0.05, priors=PRIORS), truth


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_gained_by_moving_the_sensors_further(seed: int) -> None:
    cost, truth = problem(seed)
    start = moved(truth, random_step(np.random.default_rng(seed), cost, 0.1))
    free = identifiable(cost.tree, 1)
    found, here = sensors_refitted(cost, start, free)
    before, after = (e.gradient().sus[:, 6:] for e in (cost.at(start), here))
    assert here.chi2 < cost.at(start).chi2
    assert np.abs(after).max() < 1e-6 * np.abs(before).max()
    np.testing.assert_array_equal(found.T_joint_su, start.T_joint_su)


def test_sensors_that_are_not_free_stay() -> None:
    cost, truth = problem(0)
    free = identifiable(cost.tree, 1)
    bias_only = replace(free, sus=free.sus & (np.arange(15) < 9))
    found, _ = sensors_refitted(cost, truth, bias_only)
    np.testing.assert_array_equal(found.shape, truth.shape)
    assert np.abs(found.bias - truth.bias).max() > 0
    none, here = sensors_refitted(cost, truth, identifiable(cost.tree, 1, intrinsics=False))
    assert none is truth
    assert here.chi2 == cost.at(truth).chi2


def test_no_step_turns_a_sensor_inside_out() -> None:
    """From an SU turned over, the nearest way down would be through a mirror image."""
    cost, truth = problem(1)
    free = identifiable(cost.tree, 1)
    T = truth.T_joint_su.copy()
    T[1, :3, :3] = T[1, :3, :3] @ np.diag([-1.0, -1.0, 1.0])
    found, _ = gauss_newton(cost, replace(truth, T_joint_su=T), free, 40)
    assert np.abs(found.shape).max() < 0.5
