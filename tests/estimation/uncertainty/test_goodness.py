"""Goodness of fit: degrees of freedom that are true, parts that add up, poses really left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from synthetic import random_features, random_state, random_tree, serial_tree

from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.solve.estimate import Estimate, EstimationSettings, estimate
from skin2urdf.estimation.uncertainty.goodness import Goodness, Share, goodness
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.records import Features
from skin2urdf.structure.records import KinematicTree

NOISE = 0.05
TREE = serial_tree(3)
SENSORS = EstimationSettings(
    priors=Priors(bias=0.3, scale=0.02, cross=0.01, gravity=GRAVITY), robust=False
)
PLAIN = EstimationSettings(
    priors=Priors(bias=0.0, scale=0.0, cross=0.0, gravity=GRAVITY), intrinsics=False, robust=False
)


def drawn(seed: int, n_poses: int, tree: KinematicTree = TREE, intrinsics: float = 0.3) -> Features:
    """Features of a random robot at the noise they state."""
    rng = np.random.default_rng(seed)
    state = random_state(rng, tree, intrinsics=intrinsics)
    return random_features(rng, tree, state, n_poses, NOISE)


def without(features: Features, pose: int) -> Features:
    """The features as they are when nothing was recorded in a pose."""
    noise = features.noise.copy()
    noise[pose] = np.inf
    return replace(features, noise=noise)


def turned(features: Features, pose: int, by: float) -> Features:
    """The features with gravity in one pose off by ``by`` [m/s^2] in every SU."""
    coefficients = features.coefficients.copy()
    coefficients[pose, :, 0] += by
    return replace(features, coefficients=coefficients)


def fitted(features: Features, settings: EstimationSettings = SENSORS) -> Estimate:
    return estimate(features, TREE, settings)


def test_parts_add_up() -> None:
    tree = random_tree(np.random.default_rng(3), 4, 7)
    found = estimate(drawn(3, 8, tree), tree, SENSORS)
    got = goodness(found)
    np.testing.assert_allclose(got.by_block.chi2, found.chi2_by_block, rtol=1e-9)
    for part, axis in ((got.by_su, 0), (got.by_pose, 1)):
        np.testing.assert_allclose(part.chi2, got.by_block.chi2.sum(axis=axis), rtol=1e-9)
        np.testing.assert_allclose(part.dof, got.by_block.dof.sum(axis=axis), rtol=1e-9)
    at_rest = got.by_su.dof.sum() - got.by_joint.dof.sum()
    assert 0.5 * 3 * 8 * tree.n_sus < at_rest < 3 * 8 * tree.n_sus


def test_what_is_fitted_is_taken_off() -> None:
    """Without sensors' priors, the degrees of freedom are measurements minus parameters."""
    found = fitted(drawn(1, 5, intrinsics=0.0), PLAIN)
    dof = float(goodness(found).by_su.dof.sum())
    # Where the first SU and the second joint sit along the first axis takes nothing from the data.
    assert dof == pytest.approx(found.degrees_of_freedom + 2, abs=0.01)


def mean_ratios(settings: EstimationSettings, intrinsics: float) -> tuple[float, float, float]:
    """Chi-squared per degree of freedom over 40 short logs, by pose, SU and held-out pose."""
    parts: list[Goodness] = [
        goodness(fitted(drawn(seed, 4, intrinsics=intrinsics), settings)) for seed in range(40)
    ]

    def ratio(name: str) -> float:
        shares = [getattr(part, name) for part in parts]
        return float(sum(s.chi2.sum() for s in shares) / sum(s.dof.sum() for s in shares))

    return ratio("by_pose"), ratio("by_su"), ratio("held_out")


def test_noise_gives_one_even_in_short_logs() -> None:
    """Four poses: a tenth of what is measured goes into the fit, a third of what is at rest."""
    by_pose, by_su, held_out = mean_ratios(PLAIN, 0.0)
    # About 11,000 degrees of freedom: one standard deviation is 1.4 %.
    assert by_pose == pytest.approx(1.0, abs=0.05)
    assert by_su == pytest.approx(1.0, abs=0.05)
    assert held_out == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("off", [0.0, 1.0])
def test_a_held_out_pose_is_one_that_was_left_out(off: float) -> None:
    """Against estimates that never saw the pose, and its covariance written out in full."""
    features = turned(drawn(5, 6), 2, off)
    got = goodness(fitted(features)).held_out
    for pose in (2, 4):
        apart = fitted(without(features, pose))
        n = apart.cost.tree.n_joints * 4
        full = fitted(features)
        here = full.cost.at(apart.state)
        U, rows = TREE.n_sus, here.residual.shape[2] * 3
        joint, su = here.jacobian()
        J = np.zeros((U * rows, n + 15 * U))
        for u in range(U):
            at = slice(pose * rows, (pose + 1) * rows)
            block = J[u * rows : (u + 1) * rows]
            np.add.at(block.T, apart.cost.columns[u], joint[u, at].T)
            block[:, n + 15 * u : n + 15 * u + 15] = su[u, at]
        free = np.concatenate([apart.free.joints.ravel(), apart.free.sus.ravel()])
        covariance = np.zeros((n + 15 * U, n + 15 * U))
        covariance[np.ix_(free, free)] = np.linalg.pinv(dense(apart)[np.ix_(free, free)], 1e-10)
        error = here.residual[pose].ravel()
        spread = np.eye(len(error)) + J @ covariance @ J.T
        chi2 = float(error @ np.linalg.solve(spread, error))
        assert got.chi2[pose] == pytest.approx(chi2, rel=0.03)
    assert (got.per_dof[2] > 5.0) == (off > 0)


def dense(found: Estimate) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """The arrow written out: information of all coordinates, joints first."""
    equations = found.cost.at(found.state).normal_equations()
    J, U = len(equations.joint), len(equations.su)
    H = np.zeros((J + 15 * U, J + 15 * U))
    H[:J, :J] = equations.joint
    for u in range(U):
        at = slice(J + 15 * u, J + 15 * u + 15)
        H[at, at] = equations.su[u]
        np.add.at(H[at, :J].T, equations.columns[u], equations.mixed[u].T)
    H[:J, J:] = H[J:, :J].T
    return H


def test_a_pose_that_counts_little_is_predicted_as_if_it_counted_not_at_all() -> None:
    features = turned(drawn(6, 7), 3, 0.3)
    robust = fitted(features, replace(SENSORS, robust=True))
    assert (robust.weight[3] < 0.1).sum() == 2
    plain = goodness(fitted(features)).held_out
    weighed = goodness(robust).held_out
    assert weighed.chi2[3] == pytest.approx(plain.chi2[3], rel=0.1)
    assert np.argmax(weighed.per_dof) == 3


def test_what_only_one_pose_shows_can_not_be_predicted() -> None:
    """A joint that is excited in a single pose: nothing to hold its axis against."""
    features = drawn(7, 6)
    D = features.n_dofs
    last = features.dof_names.index(TREE.joint_names[-1])
    felt = np.ones((features.n_poses, 1, 1 + 2 * D))
    felt[1:, :, [1 + last, 1 + D + last]] = 0.0
    information = features.information.scaled(felt)
    alone = replace(
        features, information=information, q=np.where(np.arange(D) == last, 0.3, features.q)
    )
    everywhere, once = goodness(fitted(features)), goodness(fitted(alone))
    assert everywhere.held_out.dof[0] == fitted(features).count[0].sum()
    assert once.held_out.dof[0] < fitted(alone).count[0].sum()


def test_the_joint_whose_motion_does_not_fit_stands_out() -> None:
    features = drawn(8, 8)
    coefficients = features.coefficients.copy()
    D = features.n_dofs
    wrong = features.dof_names.index(TREE.joint_names[1])
    rng = np.random.default_rng(8)
    shape = coefficients[:, :, 1 + D + wrong].shape
    coefficients[:, :, 1 + D + wrong] += 0.02 * rng.standard_normal(shape)
    ratio = goodness(fitted(replace(features, coefficients=coefficients))).by_joint.per_dof
    assert np.argmax(ratio) == 1
    assert ratio[1] > 3 * max(ratio[0], ratio[2])


@pytest.mark.parametrize("dof", [3.0, 24.0, 500.0])
def test_z_is_the_normal_variable_of_the_same_probability(dof: float) -> None:
    chi2 = stats.chi2.isf([0.5, 1e-2, 1e-4], dof)
    z = Share(chi2, np.full(3, dof)).z
    np.testing.assert_allclose(z, stats.norm.isf([0.5, 1e-2, 1e-4]), atol=0.1)


def test_half_of_the_measurements_are_predicted_at_least_so_well() -> None:
    """Two small poses that are predicted well, one large one that is not, and one without data."""
    nothing = Share(np.zeros(4), np.zeros(4))
    held_out = Share(np.array([24.0, 12.0, 600.0, 0.0]), np.array([24.0, 24.0, 200.0, 0.0]))
    got = Goodness(nothing, nothing, nothing, nothing, held_out, np.ones(4, bool), scale=2.0)
    assert got.prediction == pytest.approx(1.5)


def test_poses_without_readings_have_no_ratio() -> None:
    got = goodness(fitted(without(drawn(9, 6), 2)))
    assert np.isnan(got.by_pose.per_dof[2])
    assert np.isnan(got.held_out.per_dof[2])
    assert 0.5 < got.prediction < 1.5
