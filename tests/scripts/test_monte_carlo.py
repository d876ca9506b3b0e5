"""Monte Carlo of stated uncertainties: the truth in the chart, figures, the script."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from batch.records import Failure, Record
from monte_carlo import main
from montecarlo.chart import TrueRobot, as_felt, displacement, true_robot
from montecarlo.normalised import normalised, summed, without_open
from montecarlo.records import BLOCKS, Block, Case, Run
from montecarlo.table import nees, report
from simulated import PATTERNS, simulation, true_features

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.problem.state import State, Step, moved
from skin2urdf.simulation import Simulation


def recorded() -> Simulation:
    return simulation("so101", grade="bma150", excite="all", imu_rate=250.0)


@cache
def calibration() -> Calibration:
    return calibrate(recorded().recording, PATTERNS)


def truth_of(found: Calibration) -> tuple[State, object]:
    """The estimate moved onto the truth, and the truth as the chart takes it."""
    estimate = found.estimate
    true = true_robot(recorded().truth, estimate.tree)
    return moved(estimate.state, displacement(estimate.state, estimate.tree, true)), true


def test_the_truth_in_the_chart_feels_what_the_true_robot_feels() -> None:
    found = calibration()
    state, _ = truth_of(found)
    estimate, tree, features = found.estimate, found.estimate.tree, found.features
    predicted = estimate.cost.at(state).kin.features()
    truth = recorded().truth
    true = true_features(truth.urdf, truth.gravity_base, features)
    L, D = estimate.cost.blocks.chains.joint.shape[1], features.n_dofs
    for u, name in enumerate(tree.su_names):
        chain = tree.chain(int(tree.su_joint[u]))
        dof = np.array([features.dof_names.index(tree.joint_names[j]) for j in chain], dtype=int)
        n = len(chain)
        rows = true[:, features.su_names.index(name)]
        own = predicted[:, u]
        np.testing.assert_allclose(own[:, 0], rows[:, 0], atol=1e-9)
        np.testing.assert_allclose(own[:, 1 : 1 + n], rows[:, 1 + dof], atol=1e-9)
        np.testing.assert_allclose(own[:, 1 + L : 1 + L + n], rows[:, 1 + D + dof], atol=1e-9)


def test_frames_as_they_are_felt_leave_sensors_nothing_but_symmetric_errors() -> None:
    true = true_robot(recorded().truth, calibration().estimate.tree)
    felt = as_felt(true)
    for T, turned, M in zip(true.T_base_su, felt.T_base_su, true.sensor_matrix, strict=True):
        left = M @ T[:3, :3].T @ turned[:3, :3]
        np.testing.assert_allclose(left, left.T, atol=1e-12)
        np.testing.assert_allclose(turned[:3, 3], T[:3, 3])
        assert 1e-4 < np.abs(turned[:3, :3] - T[:3, :3]).max() < 0.02


def test_from_the_truth_a_displacement_gives_back_itself() -> None:
    found = calibration()
    state, true = truth_of(found)
    assert isinstance(true, TrueRobot)
    tree, free = found.estimate.tree, found.estimate.free
    none = displacement(state, tree, true)
    np.testing.assert_allclose(none.flat(), 0.0, atol=1e-9)

    rng = np.random.default_rng(0)
    joints = 1e-6 * rng.standard_normal(free.joints.shape) * free.joints
    joints[tree.parent < 0] = 0.0  # their yaw, and so their turn, is the base's
    sus = 1e-6 * rng.standard_normal(free.sus.shape) * free.sus
    on_base = tree.su_joint < 0
    sus[on_base, :6] = 0.0
    back = displacement(moved(state, Step(joints, np.zeros((0, 2)), sus)), tree, true)
    np.testing.assert_allclose(back.joints, -joints, atol=1e-10)
    np.testing.assert_allclose(back.sus, -sus, atol=1e-10)


def test_a_wrong_tree_is_no_error_figure() -> None:
    found = calibration()
    tree = found.estimate.tree
    onto = np.where(tree.su_joint < 0, 0, tree.su_joint)
    wrong = replace(tree, su_joint=onto)
    truth = recorded().truth
    with pytest.raises(ValueError):
        true_robot(truth, wrong)


def test_true_covariances_give_one_and_others_do_not() -> None:
    rng = np.random.default_rng(1)
    A = rng.standard_normal((4, 3)) * [[1e-6], [1.0], [1e-3], [1e-4]]
    covariance = A @ A.T  # of rank 3
    errors = rng.standard_normal((4000, 3)) @ A.T
    whole = summed(normalised(e, covariance) for e in errors)
    assert whole.dimensions == 3 * 4000
    assert whole.squared / whole.dimensions == pytest.approx(1.0, abs=0.04)
    assert whole.inside / whole.coordinates == pytest.approx(0.954, abs=0.01)
    half = summed(normalised(e, covariance / 4) for e in errors)
    assert half.squared == pytest.approx(4 * whole.squared)


def test_open_directions_do_not_count() -> None:
    v = np.array([0.6, 0.0, 0.8])
    covariance = np.eye(3) - np.outer(v, v)
    error = without_open(np.array([1.0, 1.0, 0.0]) + 7.0 * v, covariance)
    block = normalised(error, covariance)
    assert block.dimensions == 2
    assert block.squared == pytest.approx(1.0 + 0.64)


def test_recordings_and_not_coordinates_make_the_standard_error() -> None:
    mean, error = nees([Block(20.0, 10, 10, 10), Block(0.0, 10, 10, 10)])
    assert mean == pytest.approx(1.0)
    assert error == pytest.approx(np.sqrt(2.0) * 10 / 20)


def test_the_script_shows_all_blocks_of_parameters(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "recordings.jsonl"
    arguments = ["--robots", "so101", "--poses", "4", "--jobs", "0", "--output", str(path)]
    assert main([*arguments, "--recordings", "1"]) == 0
    shown = capsys.readouterr().out
    assert all(block in shown for block in BLOCKS)
    assert main(["--robots", "nobody", "--output", str(path)]) == 2


def test_a_failure_counts_in_no_figure() -> None:
    case = Case("panda", "mems", "all", 6, 3)
    failed: Run = Record(case, Failure("ValueError", "no tree"))
    assert f"{case.key}: {failed.failure}" in report([failed])
