"""CasADi's cost is the numeric one; the refinement reaches its minimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from synthetic import (
    random_cost,
    random_features,
    random_state,
    random_step,
    random_tree,
    serial_tree,
)

from skin2urdf.errors import BadFitError
from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.problem.state import Free, State, Step, identifiable, moved, screwed
from skin2urdf.estimation.solve.casadi_refinement import refine
from skin2urdf.estimation.solve.gauss_newton import gauss_newton
from skin2urdf.estimation.solve.symbolic_cost import SymbolicCost
from skin2urdf.geometry.so3 import skew
from skin2urdf.geometry.units import GRAVITY

PRIORS = Priors(gravity=GRAVITY, position=0.02)


@pytest.fixture(scope="module")
def problem() -> tuple[Cost, State]:
    """A branching tree with prismatic joints, an SU on the base and one that is dead, two logs."""
    rng = np.random.default_rng(3)
    tree = random_tree(rng, 5, 6, prismatic=0.4)
    assert tree.prismatic.any()
    state = random_state(rng, tree, n_logs=2)
    features = random_features(rng, tree, state, 5, 0.05)
    noise = np.array(features.noise)
    noise[:, 3] = noise[2, 4] = np.inf
    cost = Cost(tree, feature_blocks(replace(features, noise=noise), tree), PRIORS)
    return cost, state


def upright(state: State) -> State:
    """The state with its first axis along gravity."""
    T = np.array(state.T_parent_joint)
    T[0, :3, :3] = np.eye(3)
    return replace(state, T_parent_joint=T)


@pytest.mark.parametrize("seed", range(6))
def test_value_and_derivatives_are_those_of_the_cost(
    problem: tuple[Cost, State], seed: int
) -> None:
    cost, state = problem
    point = moved(state, random_step(np.random.default_rng(seed), cost, 0.3))
    here, model = cost.at(point), SymbolicCost(cost).linearised(point)
    assert SymbolicCost(cost).chi2(point) == pytest.approx(here.chi2, rel=1e-9)
    gradient = here.gradient().flat()
    np.testing.assert_allclose(
        model.gradient.flat(), gradient, rtol=1e-9, atol=1e-9 * abs(gradient).max()
    )
    equations = here.normal_equations()
    for name in ("joint", "su"):
        expected = getattr(equations, name)
        found = getattr(model.equations, name)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * abs(expected).max())
    n = cost.tree.n_joints * 4 + 2
    for u in range(cost.tree.n_sus):
        dense = [np.zeros((15, n)), np.zeros((15, n))]
        for out, system in zip(dense, (model.equations, equations), strict=True):
            np.add.at(out.T, system.columns[u], system.mixed[u].T)
        np.testing.assert_allclose(*dense, rtol=1e-9, atol=1e-9 * abs(equations.mixed).max())


@pytest.mark.parametrize("seed", range(3))
def test_bending_is_the_second_derivative_screwed(problem: tuple[Cost, State], seed: int) -> None:
    cost, state = problem
    step = random_step(np.random.default_rng(seed), cost, 0.5)
    here = cost.at(state)
    h = 1e-3
    plus, minus = (cost.at(screwed(state, step.like(s * h * step.flat()))) for s in (1, -1))
    second = (plus.residual - 2 * here.residual + minus.residual) / h**2
    ends = [e.offsets for e in (plus, here, minus)]
    offsets = tuple((p - 2 * o + m) / h**2 for p, o, m in zip(*ends, strict=True))
    groups = (replace(here.whole, residual=second),)
    bent = replace(here, groups=groups, prior=np.zeros_like(here.prior), offsets=offsets)
    expected = bent.gradient().flat()
    found = SymbolicCost(cost).linearised(state).bending(step)
    np.testing.assert_allclose(found.flat(), expected, atol=1e-5 * abs(expected).max())
    # What bends where there is no data is the prior of the offset.
    dead = bent.gradient().sus[3]
    assert dead[:3].any()
    np.testing.assert_allclose(found.sus[3], dead, atol=1e-3 * abs(dead).max())


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-7, 0))
def test_screws_are_exponentials_and_agree_with_steps_to_first_order(
    seed: int, exponent: float
) -> None:
    rng = np.random.default_rng(seed)
    tree = serial_tree(2)
    state = random_state(rng, tree, n_logs=2)
    step = Step(*(rng.standard_normal(shape) for shape in ((2, 4), (1, 2), (2, 15))))
    small = step.like(10.0**exponent * step.flat())
    turned, stepped = screwed(state, small), moved(state, small)
    for u, x in enumerate(small.sus):
        twist = np.zeros((4, 4))
        twist[:3, :3], twist[:3, 3] = skew(x[3:6]), x[:3]
        np.testing.assert_allclose(
            turned.T_joint_su[u], state.T_joint_su[u] @ expm(twist), atol=1e-12
        )
    tolerance = 1e-12 + 30 * np.max(small.flat() ** 2)
    for name in ("T_parent_joint", "T_joint_su", "up", "bias", "shape"):
        np.testing.assert_allclose(getattr(turned, name), getattr(stepped, name), atol=tolerance)


@pytest.mark.parametrize("seed", range(3))
def test_it_finds_the_truth_where_there_is_no_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, 5, 6)
    truth = random_state(rng, tree, n_logs=2, intrinsics=0.0)
    cost = random_cost(rng, tree, truth, 12)
    start = moved(truth, random_step(rng, cost, 0.05))
    found, chi2 = refine(cost, start, identifiable(tree, 2))
    assert cost.at(start).chi2 > 1e4
    assert chi2 < 1e-6
    assert cost.at(found).chi2 == chi2


def test_it_reaches_the_minimum_in_noise() -> None:
    rng = np.random.default_rng(1)
    tree = serial_tree(5, prismatic=(3,))
    truth = random_state(rng, tree)
    cost = random_cost(rng, tree, truth, 10, 0.05)
    free = identifiable(tree, 1)
    _, chi2 = refine(cost, moved(truth, random_step(rng, cost, 0.1)), free)
    _, least = gauss_newton(cost, truth, free, 50, 1e-14)
    assert chi2 == pytest.approx(least, abs=1e-3)
    assert chi2 < cost.at(truth).chi2


@pytest.mark.parametrize("seed", [3, 4])
def test_an_upright_first_axis_does_not_hold_it_up(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = serial_tree(7)
    truth = upright(random_state(rng, tree))
    cost = random_cost(rng, tree, truth, 6, 0.05)
    start = moved(truth, random_step(rng, cost, 0.3))
    _, chi2 = refine(cost, start, identifiable(tree, 1))
    assert chi2 < cost.at(truth).chi2


def test_it_leaves_fixed_coordinates_alone(problem: tuple[Cost, State]) -> None:
    cost, state = problem
    start = moved(state, random_step(np.random.default_rng(2), cost, 0.05))
    D, U = cost.tree.n_joints, cost.tree.n_sus
    free = Free(np.zeros((D, 4), bool), np.zeros((1, 2), bool), np.zeros((U, 15), bool))
    same, chi2 = refine(cost, start, free)
    assert chi2 == cost.at(start).chi2
    np.testing.assert_allclose(same.T_joint_su, start.T_joint_su, atol=1e-15)
    free.logs[:] = True
    free.sus[1, 6:9] = True
    found, chi2 = refine(cost, start, free)
    assert chi2 < cost.at(start).chi2
    np.testing.assert_array_equal(found.up[0], start.up[0])
    assert not np.allclose(found.up[1], start.up[1], atol=1e-6)
    assert not np.allclose(found.bias[1], start.bias[1], atol=1e-6)
    np.testing.assert_allclose(found.T_parent_joint, start.T_parent_joint, atol=1e-15)
    np.testing.assert_array_equal(np.delete(found.bias, 1, 0), np.delete(start.bias, 1, 0))
    np.testing.assert_array_equal(found.shape, start.shape)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**32 - 1), st.floats(-2, 1))
def test_it_never_makes_worse(problem: tuple[Cost, State], seed: int, exponent: float) -> None:
    cost, state = problem
    rng = np.random.default_rng(seed)
    start = moved(state, random_step(rng, cost, 10.0**exponent))
    # Even the coordinates nothing determines are free.
    zero = cost.zero_step()
    everything = Free(*(np.ones(x.shape, bool) for x in (zero.joints, zero.logs, zero.sus)))
    found, chi2 = refine(cost, start, everything, max_iterations=3)
    assert chi2 <= cost.at(start).chi2
    assert chi2 == cost.at(found).chi2
    rotations = found.T_joint_su[:, :3, :3]
    eye = np.broadcast_to(np.eye(3), rotations.shape)
    np.testing.assert_allclose(rotations @ np.swapaxes(rotations, 1, 2), eye, atol=1e-9)


def test_no_iterations_return_the_start(problem: tuple[Cost, State]) -> None:
    cost, state = problem
    found, chi2 = refine(cost, state, identifiable(cost.tree, 2), max_iterations=0)
    assert found is state
    assert chi2 == cost.at(state).chi2


def test_it_is_silent(problem: tuple[Cost, State], capfd: pytest.CaptureFixture[str]) -> None:
    cost, state = problem
    refine(cost, state, identifiable(cost.tree, 2), max_iterations=2)
    assert capfd.readouterr() == ("", "")


def test_a_start_that_is_not_finite_is_refused(problem: tuple[Cost, State]) -> None:
    cost, state = problem
    broken = replace(state, bias=np.full_like(state.bias, np.nan))
    with pytest.raises(BadFitError, match="nan") as caught:
        refine(cost, broken, identifiable(cost.tree, 2))
    assert caught.value.remedy
