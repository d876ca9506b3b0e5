"""The numeric core: feature blocks, the cost and its derivatives, Gauss-Newton."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import (
    random_cost,
    random_features,
    random_state,
    random_step,
    random_tree,
    serial_tree,
)

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem import residuals
from skin2urdf.estimation.problem.blocks import FeatureBlocks, feature_blocks
from skin2urdf.estimation.problem.cost import Cost, NormalEquations, Priors
from skin2urdf.estimation.problem.state import Free, State, Step, identifiable, moved
from skin2urdf.estimation.solve.arrow import factor
from skin2urdf.estimation.solve.gauss_newton import gauss_newton
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features, StaticMoves
from skin2urdf.structure.records import KinematicTree

PRIORS = Priors(gravity=GRAVITY, position=0.02)


@pytest.fixture(scope="module")
def problem() -> tuple[Cost, State]:
    """A branching tree with prismatic joints and an SU on the base, in three logs."""
    rng = np.random.default_rng(3)
    tree = random_tree(rng, 6, 7, prismatic=0.4)
    assert tree.prismatic.any()
    assert not tree.prismatic.all()
    state = random_state(rng, tree, n_logs=3)
    cost = random_cost(rng, tree, state, 5, noise=0.05, priors=PRIORS)
    return cost, moved(state, random_step(rng, cost))


def directions(cost: Cost, n: int) -> list[Step]:
    rng = np.random.default_rng(1)
    return [random_step(rng, cost, 1.0) for _ in range(n)]


def scaled(step: Step, k: float) -> Step:
    return step.like(k * step.flat())


@pytest.mark.parametrize("displaced", [False, True])
def test_the_gradient_is_that_of_differences(problem: tuple[Cost, State], displaced: bool) -> None:
    cost, state = problem
    base = random_step(np.random.default_rng(2), cost) if displaced else cost.zero_step()
    gradient = cost.at(state, base).gradient().flat()
    h = 1e-5
    for i in range(gradient.size):
        e = h * np.eye(1, gradient.size, i)[0]
        ends = [cost.at(state, base.like(base.flat() + s * e)).chi2 / 2 for s in (1, -1)]
        difference = (ends[0] - ends[1]) / (2 * h)
        assert gradient[i] == pytest.approx(difference, rel=1e-5, abs=1e-4 * abs(gradient).max())


def test_moving_and_stepping_are_the_same(problem: tuple[Cost, State]) -> None:
    cost, state = problem
    step = random_step(np.random.default_rng(3), cost, 0.3)
    assert cost.at(moved(state, step)).chi2 == pytest.approx(cost.at(state, step).chi2, rel=1e-12)


def jacobian_along(cost: Cost, state: State, base: Step, step: Step) -> tuple[F64, F64]:
    """Derivatives of residuals (U, N) and SUs' priors (U, 12) along a step, from the Jacobian."""
    joint, su = cost.at(state, base).jacobian()
    columns = cost.at(state).normal_equations().columns
    xj = np.concatenate([step.joints.ravel(), step.logs.ravel()])
    along = (su @ step.sus[..., None])[..., 0]
    n = joint.shape[1]
    return (joint @ xj[columns][..., None])[..., 0] + along[:, :n], along[:, n:]


def test_the_jacobian_is_that_of_differences(problem: tuple[Cost, State]) -> None:
    cost, state = problem
    base, h = random_step(np.random.default_rng(4), cost), 1e-6
    for step in directions(cost, 4):
        residual, prior = jacobian_along(cost, state, base, step)
        plus, minus = (
            cost.at(state, base.like(base.flat() + s * h * step.flat())) for s in (1, -1)
        )
        expected = np.swapaxes(plus.residual - minus.residual, 0, 1).reshape(residual.shape)
        scale = abs(residual).max()
        np.testing.assert_allclose(residual, expected / (2 * h), atol=1e-6 * scale)
        ends = [np.concatenate([e.prior, e.offsets[1]], axis=1) for e in (plus, minus)]
        np.testing.assert_allclose(prior, (ends[0] - ends[1]) / (2 * h), atol=1e-5)


def form(equations: NormalEquations, step: Step) -> float:
    """The quadratic form of the arrow system along a step."""
    xj = np.concatenate([step.joints.ravel(), step.logs.ravel()])
    xs = step.sus
    value = xj @ equations.joint @ xj + np.einsum("ui,uij,uj->", xs, equations.su, xs)
    return float(value + 2 * np.einsum("ui,uij,uj->", xs, equations.mixed, xj[equations.columns]))


def test_normal_equations_are_the_squares_of_the_jacobian(problem: tuple[Cost, State]) -> None:
    cost, state = problem
    here = cost.at(state)
    equations = here.normal_equations()
    for step in directions(cost, 4):
        residual, prior = jacobian_along(cost, state, cost.zero_step(), step)
        square = float(np.vdot(residual, residual) + np.vdot(prior, prior))
        square += float(np.sum((step.joints[:, :2] / PRIORS.position) ** 2))
        assert form(equations, step) == pytest.approx(square, rel=1e-10)


def test_groups_of_sus_add_up_to_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chains of length 0 to 5, cut into groups of one to three SUs with arrays of their own."""
    rng = np.random.default_rng(11)
    tree = random_tree(rng, 7, 9)
    state = random_state(rng, tree, n_logs=3)
    together = random_cost(rng, tree, state, 5, noise=0.05, priors=PRIORS)
    monkeypatch.setattr(residuals, "BLOCKS_AT_ONCE", 12)
    apart = Cost(tree, together.blocks, PRIORS)
    one, other = together.at(state), apart.at(state)
    assert len(one.groups) == 1
    assert len({each.group.W.shape[-1] for each in other.groups}) > 2
    np.testing.assert_allclose(other.chi2_by_block(), one.chi2_by_block(), rtol=1e-9)
    gradients = one.gradient().flat(), other.gradient().flat()
    np.testing.assert_allclose(*gradients, atol=1e-9 * abs(gradients[0]).max())
    step = random_step(rng, together, 1.0)
    forms = (form(here.normal_equations(), step) for here in (one, other))
    assert next(forms) == pytest.approx(next(forms), rel=1e-10)
    for mine, others in zip(one.jacobian(), other.jacobian(), strict=True):
        np.testing.assert_allclose(mine, others, atol=1e-12 * abs(mine).max())


def test_the_step_solves_the_system_over_the_free_coordinates() -> None:
    rng = np.random.default_rng(5)
    tree = serial_tree(4, prismatic=(2,))
    state = random_state(rng, tree, n_logs=2)
    cost = random_cost(rng, tree, state, 6, noise=0.05)
    free = identifiable(tree, 2)
    free = replace(free, sus=free.sus & (rng.random(free.sus.shape) < 0.8))
    here = cost.at(state)
    equations, gradient = here.normal_equations(), here.gradient()
    damping = 1e-3
    step = factor(equations, free, damping).newton_step(gradient)
    mask = np.concatenate([free.joints.ravel(), free.logs.ravel(), free.sus.ravel()])
    assert not step.flat()[~mask].any()
    # The dense system, column by column of the quadratic form.
    unit = np.eye(mask.size)[mask]
    H = np.array([[polar(equations, step.like(a), step.like(b)) for b in unit] for a in unit])
    diagonal = H.diagonal()
    H = H + np.diag((damping + 1e-9) * diagonal)
    expected = -np.linalg.solve(H, gradient.flat()[mask])
    np.testing.assert_allclose(step.flat()[mask], expected, rtol=1e-5, atol=1e-8)
    stated = factor(equations, free, damping).su_variance()[free.sus]
    dense = np.linalg.inv(H).diagonal()[-free.sus.sum() :]
    np.testing.assert_allclose(stated, dense, rtol=1e-5)


def polar(equations: NormalEquations, a: Step, b: Step) -> float:
    both, less = a.like(a.flat() + b.flat()), a.like(a.flat() - b.flat())
    return (form(equations, both) - form(equations, less)) / 4


def test_priors_weigh_sensors_and_offsets() -> None:
    rng = np.random.default_rng(6)
    tree = serial_tree(2)
    state = random_state(rng, tree)
    cost = random_cost(rng, tree, state, 3, priors=Priors(0.5, 0.03, 0.01, 0.2, GRAVITY))
    parts = [
        state.bias / 0.5,
        state.shape / ([0.03] * 3 + [0.01] * 3),
        state.T_parent_joint[:, :3, 3] / 0.2,
        state.T_joint_su[:, :3, 3] / 0.2,
    ]
    expected = sum(float(np.sum(part**2)) for part in parts)
    assert cost.at(state).chi2 == pytest.approx(expected, rel=1e-9)


def test_the_truth_explains_the_features_as_well_as_noise_allows() -> None:
    rng = np.random.default_rng(7)
    tree = random_tree(rng, 5, 6)
    state = random_state(rng, tree, n_logs=2, intrinsics=0.0)
    cost = random_cost(rng, tree, state, 8, noise=0.05)
    # A chi-squared of n terms has standard deviation sqrt(2 n).
    assert abs(cost.at(state).chi2 - cost.n_data) < 5 * np.sqrt(2 * cost.n_data)
    assert cost.at(state).chi2_by_block().sum() == pytest.approx(cost.at(state).chi2)


def test_reweighting_scales_the_blocks(problem: tuple[Cost, State]) -> None:
    cost, state = problem
    weight = np.random.default_rng(8).uniform(0, 2, cost.blocks.noise.shape[:2])
    reweighted = Cost(cost.tree, cost.blocks.reweighted(weight), cost.priors)
    np.testing.assert_allclose(
        reweighted.at(state).chi2_by_block(), weight * cost.at(state).chi2_by_block()
    )


def regression_features(X: F64, Y: F64, names: tuple[str, ...]) -> Features:
    """Features of one SU in one pose, from a regression of Y (N, 3) on X (N, 1 + 2 D)."""
    D = len(names)
    return Features(
        ("su",), names, np.zeros((1, D)), np.zeros(1),
        np.linalg.lstsq(X, Y, rcond=None)[0][None, None], Information.of((X.T @ X)[None, None]),
        np.full((1, 1, 3), 0.1), np.zeros(1), np.zeros(1),
        StaticMoves(np.zeros(0), np.zeros(0), np.zeros((0, 1, 3))),
    )  # fmt: skip


def chain_tree(chain: tuple[str, ...]) -> KinematicTree:
    n = len(chain)
    return KinematicTree(chain, np.arange(-1, n - 1), ("revolute",) * n, ("su",), np.array([n - 1]))


@settings(deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.permutations(["a", "b", "c", "d"]).flatmap(
        lambda names: st.integers(1, 4).map(lambda n: tuple(names[:n]))
    ),
)
def test_restricting_is_regressing_without_the_columns(seed: int, chain: tuple[str, ...]) -> None:
    rng = np.random.default_rng(seed)
    names = ("a", "b", "c", "d")
    X, Y = (
        rng.standard_normal((40, 9)) * 10.0 ** rng.uniform(-2, 2, 9),
        rng.standard_normal((40, 3)),
    )
    blocks = feature_blocks(regression_features(X, Y, names), chain_tree(chain))
    own = np.array([names.index(n) for n in chain])
    kept = X[:, np.r_[0, 1 + own, 5 + own]]
    expected = np.linalg.lstsq(kept, Y, rcond=None)[0]
    size = 1 / np.linalg.norm(kept, axis=0)[:, None]
    np.testing.assert_allclose(blocks.coefficients[0, 0] / size, expected / size, atol=1e-9)
    variance = np.diagonal(np.linalg.inv(kept.T @ kept))
    np.testing.assert_allclose(blocks.variance[0, 0], variance, rtol=1e-6)
    assert blocks.count[0, 0] == 3 * kept.shape[1]
    # Any other coefficients are as much worse as they are in the regression itself.
    other = expected + size * rng.standard_normal(expected.shape)
    rise = ((blocks.W[0, 0] @ other - blocks.target[0, 0]) ** 2).sum()
    assert rise == pytest.approx(((kept @ (other - expected)) ** 2).sum(), rel=1e-6)


def excited(X: F64, rng: np.random.Generator) -> FeatureBlocks:
    features = regression_features(X, rng.standard_normal((len(X), 3)), ("a", "b"))
    return feature_blocks(features, chain_tree(("a", "b")))


def test_what_was_not_excited_has_no_information() -> None:
    rng = np.random.default_rng(9)
    X = rng.standard_normal((30, 5))
    X[:, 2] = 0.0
    blocks = excited(X, rng)
    assert np.isinf(blocks.variance[0, 0]).tolist() == [False, False, True, False, False]
    assert not blocks.W[0, 0, :, 2].any()
    assert blocks.count[0, 0] == 12


def test_columns_that_were_only_excited_together_are_not_told_apart() -> None:
    rng = np.random.default_rng(10)
    X = rng.standard_normal((30, 5))
    X[:, 2] = 3 * X[:, 1]
    blocks = excited(X, rng)
    assert np.isinf(blocks.variance[0, 0]).tolist() == [False, True, True, False, False]
    W = blocks.W[0, 0]
    np.testing.assert_allclose(W @ [0, 3, -1, 0, 0], 0.0, atol=1e-6)
    assert np.linalg.norm(W @ [0, 3, 1, 0, 0]) > 1
    assert blocks.count[0, 0] == 12


def test_an_su_without_data_says_nothing() -> None:
    rng = np.random.default_rng(11)
    tree = random_tree(rng, 4, 5)
    state = random_state(rng, tree)
    features = random_features(rng, tree, state, 4, 0.05)
    lost = features.su_names.index("su2")
    noise = np.array(features.noise)
    noise[:, lost] = np.inf
    cost = Cost(tree, feature_blocks(replace(features, noise=noise), tree), PRIORS)
    assert not cost.blocks.count[:, 2].any()
    assert not cost.at(state).chi2_by_block()[:, 2].any()
    assert np.isinf(cost.blocks.variance[:, 2]).all()
    equations = cost.at(state).normal_equations()
    assert not equations.mixed[2].any()
    known = np.r_[[PRIORS.position] * 3, [np.inf] * 3, PRIORS.deviations]
    np.testing.assert_allclose(equations.su[2], np.diag(1 / known**2), atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_gauss_newton_finds_the_truth_of_a_branching_tree(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parent = np.array([-1, 0, 1, 1, 3, 0])
    kinds = ("revolute", "revolute", "prismatic", "revolute", "revolute", "revolute")
    tree = KinematicTree(
        tuple("abcdef"), parent, kinds, tuple("stuvwxy"), np.array([-1, 0, 1, 2, 3, 4, 5])
    )
    truth = random_state(rng, tree, n_logs=2, intrinsics=0.0)
    cost = random_cost(rng, tree, truth, 12)
    assert cost.at(truth).chi2 < 1e-15
    free = identifiable(tree, 2)
    start = moved(truth, random_step(rng, cost, 0.05))
    assert cost.at(start).chi2 > 1e4
    found, chi2 = gauss_newton(cost, start, free, 30, 1e-12)
    assert chi2 < 1e-8
    assert cost.at(found).chi2 == pytest.approx(chi2)


def test_gauss_newton_leaves_fixed_coordinates_alone() -> None:
    rng = np.random.default_rng(12)
    tree = serial_tree(3)
    truth = random_state(rng, tree)
    cost = random_cost(rng, tree, truth, 6, 0.05)
    start = moved(truth, random_step(rng, cost, 0.02))
    free = Free(np.zeros((3, 4), bool), np.zeros((0, 2), bool), np.zeros((3, 15), bool))
    free.sus[1] = True
    found, chi2 = gauss_newton(cost, start, free)
    assert chi2 < cost.at(start).chi2
    np.testing.assert_array_equal(found.T_parent_joint, start.T_parent_joint)
    np.testing.assert_array_equal(found.T_joint_su[[0, 2]], start.T_joint_su[[0, 2]])
    assert not np.allclose(found.T_joint_su[1], start.T_joint_su[1], atol=1e-4)
