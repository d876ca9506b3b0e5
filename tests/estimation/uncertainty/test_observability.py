"""What can not be known is said to be unknown, and nothing else is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic import random_features, random_state, random_tree, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.solve.estimate import Estimate, EstimationSettings, estimate
from skin2urdf.estimation.uncertainty.observability import (
    ARM,
    WEAK,
    Observability,
    aligned_deviations,
    observability,
)
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.canonical import canonical
from skin2urdf.structure.records import KinematicTree
from skin2urdf.urdf.compare import compare
from skin2urdf.urdf.emit import emit

PLAIN = EstimationSettings(
    priors=Priors(bias=0.0, scale=0.0, cross=0.0, gravity=GRAVITY), intrinsics=False
)
SENSORS = EstimationSettings(priors=Priors(bias=0.05, scale=0.01, cross=0.0, gravity=GRAVITY))
NOISE = 0.02


def tree_with_base(n: int) -> KinematicTree:
    """A chain with an SU on every segment and one on the base."""
    tree = serial_tree(n)
    return replace(
        tree, su_names=("base", *tree.su_names), su_joint=np.concatenate([[-1], tree.su_joint])
    )


TREE = tree_with_base(5)


def robot(seed: int, tilt: float, tree: KinematicTree = TREE) -> State:
    """A random arm whose first axis is tilted by so much against gravity."""
    state = random_state(np.random.default_rng(seed), tree, intrinsics=0.0)
    joints = state.T_parent_joint.copy()
    c, s = np.cos(tilt), np.sin(tilt)
    joints[0] = np.eye(4)
    joints[0, :3, :3] = [[1, 0, 0], [0, c, -s], [0, s, c]]
    return replace(state, T_parent_joint=joints)


def found(
    state: State,
    seed: int = 0,
    setting: EstimationSettings = PLAIN,
    tree: KinematicTree = TREE,
    n_poses: int = 12,
    noise: float = NOISE,
) -> tuple[Estimate, Observability]:
    rng = np.random.default_rng(1000 + seed)
    features = random_features(rng, tree, state, n_poses, noise=noise, shuffle=False)
    estimated = estimate(features, tree, setting)
    return estimated, observability(estimated)


def along_axis_1(estimated: Estimate, su: int) -> tuple[F64, F64]:
    """Unit directions (6,) of a slide along axis 1 and of a turn about it, of SU on link 1."""
    T = estimated.state.T_joint_su[su]
    z = T[2, :3]
    slide = np.concatenate([z, np.zeros(3)])
    turn = np.concatenate([np.cross(z, T[:3, :3].T @ -T[:3, 3]) * -1, ARM * z])
    return slide, turn / np.linalg.norm(turn)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("setting", [PLAIN, SENSORS], ids=["placements", "sensors"])
def test_the_first_segment_of_a_tilted_arm_may_slide_along_its_axis(
    seed: int, setting: EstimationSettings
) -> None:
    estimated, seen = found(robot(seed, 0.6), seed, setting)
    slide, _ = along_axis_1(estimated, 1)
    directions = seen.su_unobservable[1]
    assert directions.shape == (1, 6)
    assert abs(directions[0] @ slide) == pytest.approx(1.0, abs=1e-3)
    assert seen.su_verdict[1] == "not observable"
    for u in range(2, TREE.n_sus):
        assert seen.su_unobservable[u].shape == (0, 6)
        assert seen.su_verdict[u] == "determined"
    assert seen.joint_verdict == ("determined",) * 5
    assert seen.n_open == 0


@pytest.mark.parametrize("seed", range(5))
def test_upright_its_yaw_is_open_as_well(seed: int) -> None:
    estimated, seen = found(robot(seed, 0.0), seed)
    directions = seen.su_unobservable[1]
    assert directions.shape == (2, 6)
    slide, turn = along_axis_1(estimated, 1)
    for direction in (slide, turn):
        assert np.linalg.norm(directions @ direction) == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(directions @ directions.T, np.eye(2), atol=1e-9)
    assert all(v == "determined" for v in seen.su_verdict[2:])


@pytest.mark.parametrize(("setting", "n_open"), [(PLAIN, 4), (SENSORS, 4)])
def test_an_su_on_the_base_shows_gravity_and_no_more(
    setting: EstimationSettings, n_open: int
) -> None:
    estimated, seen = found(robot(0, 0.6), 0, setting)
    assert seen.su_verdict[0] == "not observable"
    assert seen.su_unobservable[0].shape == (n_open, 6)
    # Its tilt is known.
    up = estimated.state.T_joint_su[0, :3, :3].T @ [0.0, 0.0, 1.0]
    turns = np.concatenate([np.zeros((2, 3)), np.linalg.svd(up[None])[2][1:]], axis=1)
    assert np.linalg.norm(seen.su_unobservable[0] @ turns.T) < 1e-6


def test_an_sus_offset_along_axis_1_takes_the_shortest_way() -> None:
    estimated, _ = found(robot(1, 0.6), 1)
    # The truth is 0.1 m off; a weak prior pulls to the nearest place, until that gains no more.
    assert abs(estimated.state.T_joint_su[1, 2, 3]) < 0.03


def test_what_cross_axis_errors_hide_is_stated_and_no_lack_of_the_recording() -> None:
    """No recording tells it: else verdicts would hang on how well other SUs tell its size."""
    known = replace(SENSORS, priors=replace(SENSORS.priors, cross=0.01))
    state = robot(2, 0.6)
    shape = np.zeros_like(state.shape)
    shape[:, 3:] = 0.01 * np.random.default_rng(3).standard_normal((len(shape), 3))
    seen = found(replace(state, shape=shape), setting=known, noise=1e-3)[1]
    assert seen.hidden_rotation > WEAK
    turn = np.einsum("uii->ui", seen.su_covariance)[:, 3:]
    assert (turn >= seen.hidden_rotation**2).all()
    assert seen.su_verdict[-1] == "determined"


@pytest.mark.parametrize("bias", [0.3, 0.4])
def test_a_tilt_that_biases_hide_is_stated_whether_it_counts_as_open_or_not(bias: float) -> None:
    """The base's SU feels gravity alone: its bias hides a tilt, and nothing tells its azimuth."""
    setting = EstimationSettings(priors=Priors(bias=bias, scale=0.0, cross=0.0, gravity=GRAVITY))
    state = robot(2, 0.6)
    of_sensors = bias * np.random.default_rng(1).standard_normal(state.bias.shape)
    of, seen = found(replace(state, bias=of_sensors), setting=setting, noise=1e-3, n_poses=24)
    stated = np.hypot(np.sqrt(np.trace(seen.su_covariance[0, 3:, 3:])), seen.su_hidden_turn[0])
    assert stated == pytest.approx(np.sqrt(2) * of.cost.priors.bias / GRAVITY, rel=0.1)
    assert (seen.su_hidden_turn[1:] == 0.0).all()


def test_little_data_is_weak_or_unknown_and_said_so() -> None:
    state = robot(2, 0.6)
    rng = np.random.default_rng(0)
    features = random_features(rng, TREE, state, 12, noise=1.0, shuffle=False)
    seen = observability(estimate(features, TREE, PLAIN))
    assert "weak" in (*seen.su_verdict, *seen.joint_verdict)
    assert seen.su_verdict.count("determined") <= 2
    sharp = found(state, 0)[1]
    wide, narrow = (np.diag(each.covariance.joint)[4:20] for each in (seen, sharp))
    grown = np.sqrt(wide / narrow)
    assert np.median(grown) == pytest.approx(1.0 / NOISE, rel=0.2)


def test_a_bad_fit_widens_the_covariance() -> None:
    state = robot(3, 0.6)
    rng = np.random.default_rng(0)
    features = random_features(rng, TREE, state, 12, noise=NOISE, shuffle=False)
    estimated = estimate(features, TREE, PLAIN)
    optimistic = replace(features, noise=features.noise / 3)
    surprised = estimate(optimistic, TREE, PLAIN)
    assert surprised.cost_per_dof == pytest.approx(9 * estimated.cost_per_dof, rel=0.05)
    np.testing.assert_allclose(
        np.diag(observability(surprised).su_covariance[3]),
        np.diag(observability(estimated).su_covariance[3]),
        rtol=0.15,
    )


def test_covariances_are_symmetric_and_never_negative() -> None:
    _, seen = found(robot(4, 0.6), 4, SENSORS)
    covariance = seen.covariance.dense()
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-15)
    size = np.abs(covariance).max()
    assert np.linalg.eigvalsh(covariance).min() > -1e-9 * size
    for u, directions in enumerate(seen.su_unobservable):
        n = len(directions)
        values = np.linalg.eigvalsh(seen.su_covariance[u])
        assert (values > -1e-9 * size).all(), (u, n)


def test_the_arrow_form_is_the_inverse_of_the_whole_information() -> None:
    """Every SU on its own, and yet ``H C H = H`` for all coordinates together."""
    rng = np.random.default_rng(0)
    tree = random_tree(rng, 6, 9)
    features = random_features(rng, tree, random_state(rng, tree, 2, 0.0), 12, noise=NOISE)
    estimated = estimate(features, tree, PLAIN)
    equations = estimated.cost.at(estimated.state).normal_equations()
    J, n = len(equations.joint), len(equations.joint) + 15 * tree.n_sus
    H = np.zeros((n, n))
    H[:J, :J] = equations.joint
    for u in range(tree.n_sus):
        at = slice(J + 15 * u, J + 15 * u + 15)
        H[at, at] = equations.su[u]
        np.add.at(H[at, :J].T, equations.columns[u], equations.mixed[u].T)
        H[:J, at] = H[at, :J].T
    free = np.concatenate([v.ravel() for v in (estimated.free.joints, estimated.free.logs)])
    free = np.concatenate([free, estimated.free.sus.ravel()])
    H *= free[:, None] * free
    C = observability(estimated).covariance.dense() / max(1.0, estimated.cost_per_dof)
    # Directions that count as open have no covariance: up to 1 / UNKNOWN^2 of information is lost.
    size = np.sqrt(np.maximum(np.diag(H), 1.0))
    np.testing.assert_allclose((H @ C @ H - H) / size[:, None] / size, 0.0, atol=0.01)


@pytest.mark.parametrize("tilt", [0.6, 0.0], ids=["tilted", "upright"])
def test_bounds_agree_with_the_errors_of_many_runs(tmp_path: Path, tilt: float) -> None:
    """The stated deviations against what the comparison with the truth measures."""
    state, runs = robot(5, tilt), 24
    limits = np.tile([-1.5, 1.5], (TREE.n_joints, 1))
    truth = tmp_path / "truth.urdf"
    truth.write_text(emit(canonical(state.model(TREE)), name="truth", limits=limits))
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (60, TREE.n_joints))
    square = {name: np.zeros(2) for name in TREE.su_names[1:]}
    stated = np.zeros((2, TREE.n_sus))
    for seed in range(runs):
        estimated, seen = found(state, seed)
        stated += np.array(aligned_deviations(estimated, seen, q)) ** 2 / runs
        path = tmp_path / "estimate.urdf"
        path.write_text(emit(canonical(estimated.state.model(TREE)), name="e", limits=limits))
        open_ = dict(zip(TREE.su_names, seen.su_unobservable, strict=True))
        rng = np.random.default_rng(seed)
        c = compare(path, truth, unobservable=open_, n_configurations=60, rng=rng)
        for su in c.sus:
            if su.name in square and su.position and su.orientation:
                square[su.name] += np.array([su.position.rms, su.orientation.rms]) ** 2 / runs
    measured = np.sqrt([square[n] for n in TREE.su_names[1:]])
    expected = np.sqrt(stated[:, 1:].T)
    overall = np.sqrt((measured**2).mean(axis=0)) / np.sqrt((expected**2).mean(axis=0))
    np.testing.assert_allclose(overall, 1.0, atol=0.2)
    np.testing.assert_allclose(measured / expected, 1.0, atol=0.35)


@pytest.mark.parametrize("seed", range(8))
def test_what_the_bias_of_an_su_at_rest_explains_leaves_nothing_but_rounding(seed: int) -> None:
    """It cancels from numbers of 1e12, and what is left is no knowledge."""
    setting = EstimationSettings(priors=replace(SENSORS.priors, cross=0.01))
    _, seen = found(robot(seed, 0.6), seed, setting, noise=1e-6, n_poses=24)
    base = seen.covariance.own[0]
    assert len(seen.su_unobservable[0]) > 3
    assert set(seen.joint_verdict) == {"determined"}
    assert not seen.open_directions
    assert base[:3, :3].max() == 0.0
    assert np.linalg.eigvalsh(seen.covariance.joint).min() >= -1e-12
