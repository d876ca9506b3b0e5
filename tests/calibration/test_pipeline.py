"""calibrate(): from a log to a robot, and from a bad log to one clear sentence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_robots import small_arm
from simulated import (
    PATTERNS,
    changed_joints,
    changed_sus,
    held_against,
    simulation,
    simulation_of,
)

import skin2urdf
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import BAD_MISFIT, Calibration
from skin2urdf.calibration.rounds import (
    estimate_robot,
    find_structure,
    sample_logs,
    take_features,
)
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import (
    BadFitError,
    InsufficientDataError,
    Skin2UrdfError,
    StructureError,
    UnreadableInputError,
)
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.solve.estimate import EstimationSettings
from skin2urdf.notes import of_kind
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.retiming import retimed
from skin2urdf.recording.writing import write
from skin2urdf.report.findings import findings
from skin2urdf.simulation import Simulation

MEMS: dict[str, Any] = {"n_poses": 4, "imu_rate": 250.0}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "panda": ("panda", MEMS),
    "panda, all at once": ("panda", {**MEMS, "excite": "all"}),
    "ur5, upright": ("ur5", {**MEMS, "upright": True, "excite": "all"}),
    "so101": ("so101", MEMS),
}


@cache
def calibrated(case: str) -> tuple[Simulation, Calibration]:
    robot, options = CASES[case]
    sim = simulation(robot, **options)
    return sim, calibrate(sim.recording)


@pytest.mark.parametrize("case", CASES)
def test_a_robot_is_found_without_the_truth(case: str, tmp_path: Path) -> None:
    """The targets for mems noise: 0.5 mm and 0.05 deg."""
    sim, found = calibrated(case)
    comparison = held_against(found, sim.truth.urdf, tmp_path)
    assert comparison.tree_equal, comparison.tree_differences
    assert comparison.position.rms < 0.5e-3
    assert np.rad2deg(comparison.orientation.rms) < 0.05
    assert np.rad2deg(comparison.axis_angle.rms) < 0.05
    assert comparison.axis_distance.rms < 0.5e-3
    assert 0.6 < found.estimate.cost_per_dof < 2.0
    assert found.quality == "good"


def test_a_cheap_sensor_is_good_enough(tmp_path: Path) -> None:
    """The targets for bma150: 1.5 mm, axes 0.1 deg, SUs 0.6 deg."""
    sim = simulation("so101", **{**MEMS, "n_poses": 6, "grade": "bma150", "imu_rate": 500.0})
    found = calibrate(sim.recording)
    comparison = held_against(found, sim.truth.urdf, tmp_path)
    assert comparison.tree_equal
    assert comparison.position.rms < 2e-3
    assert np.rad2deg(comparison.axis_angle.rms) < 0.15
    assert np.rad2deg(comparison.orientation.rms) < 0.8


def test_everything_a_urdf_needs_is_in_the_result() -> None:
    sim, found = calibrated("panda")
    tree = found.model.tree
    assert set(tree.joint_names) == set(sim.truth.joint_names)
    position = {j.name: j.position for j in sim.recording.joints}
    for name, (low, high) in zip(tree.joint_names, found.limits, strict=True):
        assert low == pytest.approx(position[name].min(), abs=0.01)
        assert high == pytest.approx(position[name].max(), abs=0.01)
    assert (found.velocity > 0.3).all()
    assert [s.path for s in found.sources] == [sim.recording.source]
    assert found.sources[0].duration == pytest.approx(sim.recording.duration)
    assert {"reading", "sampling", "features", "estimation", "observability"} <= set(found.seconds)
    assert found.features.n_sus == tree.n_sus == 8


def test_the_second_look_is_better_than_the_first() -> None:
    """With several joints moving at once, what lies beyond first order has to be predicted."""
    sim, found = calibrated("panda, all at once")
    settings, clock = replace(PATTERNS, relinearisations=0), Clock()
    # Its features are not searched for what is wrong with them.
    logs = sample_logs([retimed(sim.recording)], settings, clock)
    first = take_features(logs, clock)
    once = estimate_robot(logs, first, find_structure(logs, first, clock), clock)
    assert once is not None
    assert found.features.noise[np.isfinite(found.features.noise)].mean() < 0.5 * (
        once.features.noise[np.isfinite(once.features.noise)].mean()
    )


def test_a_file_says_the_same_as_memory(tmp_path: Path) -> None:
    sim, direct = calibrated("so101")
    log = tmp_path / "log.mcap"
    write(sim.recording, log, joint_order=sim.joint_order)
    found = calibrate(log)
    assert found.sources[0].digest
    assert Path(found.sources[0].path).name == "log.mcap"
    assert found.model.tree.joint_names == direct.model.tree.joint_names
    assert found.model.tree.su_names == direct.model.tree.su_names
    assert found.features.n_poses == direct.features.n_poses
    comparison = held_against(found, sim.truth.urdf, tmp_path)
    assert comparison.tree_equal
    assert comparison.position.rms < 0.5e-3


def test_upright_and_tilted_logs_together_show_what_neither_shows_alone(tmp_path: Path) -> None:
    """Axis 1 vertical in one log only: the yaw of the first segment's SU becomes known."""
    upright, alone = calibrated("ur5, upright")
    tilted = simulation("ur5", **MEMS, excite="all")
    both = calibrate([upright.recording, tilted.recording], PATTERNS)
    assert len(both.sources) == 2
    tree = both.model.tree
    first = int(np.flatnonzero(tree.su_joint == 0)[0])
    u = alone.model.tree.su_names.index(tree.su_names[first])
    # Besides slide and yaw, its tilt is no better known than the sensor's bias.
    assert len(alone.observability.su_unobservable[u]) >= 2
    assert len(both.observability.su_unobservable[first]) == 1
    comparison = held_against(both, upright.truth.urdf, tmp_path)
    assert comparison.tree_equal
    assert comparison.position.rms < 0.5e-3
    assert np.rad2deg(comparison.orientation.rms) < 0.05


def test_the_order_of_streams_and_their_names_mean_nothing() -> None:
    sim, found = calibrated("so101")
    rng = np.random.default_rng(0)

    def mixed(names: tuple[str, ...]) -> dict[str, str]:
        return dict(zip(names, (f"n{i:02d}" for i in rng.permutation(len(names))), strict=True))

    joints = mixed(tuple(j.name for j in sim.recording.joints))
    sus = mixed(tuple(s.name for s in sim.recording.sus))
    renamed = replace(
        sim.recording,
        joints=tuple(replace(j, name=joints[j.name]) for j in sim.recording.joints[::-1]),
        sus=tuple(replace(s, name=sus[s.name]) for s in sim.recording.sus[::-1]),
    )
    again = calibrate(renamed)
    assert [joints[n] for n in found.model.tree.joint_names] == list(again.model.tree.joint_names)
    order = [again.model.tree.su_names.index(sus[n]) for n in found.model.tree.su_names]
    assert again.estimate.chi2 == pytest.approx(found.estimate.chi2, rel=1e-3)
    here, there = (each.model.T_parent_joint[1:, :3, 3] for each in (again, found))
    # How far along the first axis the second one is, no motion shows.
    np.testing.assert_allclose(here[:, :2], there[:, :2], atol=1e-4)
    np.testing.assert_allclose(here[1:, 2], there[1:, 2], atol=1e-4)
    np.testing.assert_array_equal(again.model.tree.su_joint[order], found.model.tree.su_joint)


def test_settings_reach_the_estimation() -> None:
    sim, found = calibrated("so101")
    priors = Priors(scale=0.0, cross=0.0)
    settings = replace(PATTERNS, estimation=EstimationSettings(priors=priors))
    plain = calibrate(sim.recording, settings)
    assert plain.settings is settings
    assert not plain.estimate.state.shape.any()
    assert plain.estimate.state.bias.any()
    assert found.estimate.state.shape.any()


def test_biases_that_are_denied_make_a_bad_fit() -> None:
    """Five mg is fifty standard deviations of gravity in a pose."""
    made = simulation_of(small_arm(2), **{**MEMS, "n_poses": 3}, excite="all")
    settings = CalibrationSettings(estimation=EstimationSettings(intrinsics=False))
    with pytest.raises(BadFitError):
        calibrate(made.recording, settings)


def test_the_package_offers_it_by_its_name() -> None:
    assert skin2urdf.calibrate is calibrate


# Bad logs: one clear sentence with the next step, never a traceback of another kind.


def plain() -> Recording:
    return simulation("panda", n_poses=4, imu_rate=250.0).recording


def on_base() -> str:
    sim = simulation("panda", n_poses=4, imu_rate=250.0)
    return next(su.name for su in sim.truth.sus if su.joint < 0)


def still(joint: JointStream) -> JointStream:
    return replace(joint, position=np.full_like(joint.position, 0.3))


def noise(su: SuStream, size: float, rng: np.random.Generator) -> SuStream:
    return replace(su, specific_force=size * rng.standard_normal(su.specific_force.shape))


def cut(recording: Recording, seconds: float) -> Recording:
    def joint(j: JointStream) -> JointStream:
        keep = j.time < seconds
        return replace(j, time=j.time[keep], position=j.position[keep])

    def su(s: SuStream) -> SuStream:
        keep = s.time < seconds
        return replace(s, time=s.time[keep], specific_force=s.specific_force[keep])

    return changed_sus(changed_joints(recording, joint), su)


def only_base(su: SuStream) -> SuStream | None:
    return su if su.name == on_base() else None


def in_degrees(joint: JointStream) -> JointStream:
    return replace(joint, position=np.rad2deg(joint.position))


def resting(recording: Recording) -> Recording:
    """Nothing moves: constant joints, readings of gravity and noise."""
    rng = np.random.default_rng(0)

    def su(s: SuStream) -> SuStream:
        mean = s.specific_force[:50].mean(axis=0)
        return replace(s, specific_force=mean + noise(s, 0.01, rng).specific_force)

    return changed_sus(changed_joints(recording, still), su)


BAD: dict[str, tuple[Callable[[], Recording], type[Skin2UrdfError], str]] = {
    "joints that never move": (
        lambda: changed_joints(plain(), still), StructureError, "",
    ),
    "nothing moves": (lambda: resting(plain()), StructureError, ""),
    "one SU, on the base": (
        lambda: changed_sus(plain(), only_base), StructureError, "",
    ),
    "one second": (lambda: cut(plain(), 1.0), InsufficientDataError, "overlap"),
    "no joints": (lambda: replace(plain(), joints=()), InsufficientDataError, "joints"),
    "noise instead of readings": (
        lambda: changed_sus(plain(), partial(noise, size=5.0, rng=np.random.default_rng(1))),
        InsufficientDataError, "poses",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_log_gives_one_clear_sentence(case: str) -> None:
    make, kind, lacks = BAD[case]
    with pytest.raises(kind) as caught:
        calibrate(make())
    assert type(caught.value) is kind
    assert getattr(caught.value, "lacks", "") == lacks
    assert caught.value.remedy
    assert "\n" not in str(caught.value)
    assert caught.value.exit_status == 1


def test_a_log_without_sus_is_an_error_in_words() -> None:
    with pytest.raises(Skin2UrdfError) as caught:
        calibrate(replace(plain(), sus=()))
    assert caught.value.remedy


def test_a_log_that_ends_after_one_move_shows_that_joint_alone() -> None:
    found = calibrate(cut(plain(), 3.0))
    assert found.model.tree.joint_names == (plain().joints[0].name,)
    assert found.quality == "fair"
    assert "determined" not in found.observability.su_verdict


def test_what_a_log_of_a_few_moves_leaves_open_is_said() -> None:
    """Moves of two joints show these, and where some SUs are beyond them only weakly."""
    found = calibrate(cut(plain(), 9.0))
    assert found.quality == "fair"
    assert "weak" in found.observability.su_verdict
    assert found.model.tree.joint_names == tuple(joint.name for joint in plain().joints[:2])
    left = [note.joints for note in of_kind(found.notes, "joint left out")]
    assert (plain().joints[-1].name,) in left


def test_positions_in_degrees_give_no_robot() -> None:
    with pytest.raises(Skin2UrdfError) as caught:
        calibrate(changed_joints(plain(), in_degrees))
    assert caught.value.remedy


def test_a_joint_that_is_not_linear_is_followed(tmp_path: Path) -> None:
    made = simulation_of(small_arm(3), **MEMS)
    name = made.recording.joints[1].name

    def bent(joint: JointStream) -> JointStream:
        position = joint.position + 0.2 * np.sin(3 * joint.position)
        return replace(joint, position=position) if joint.name == name else joint

    found = calibrate(changed_joints(made.recording, bent))
    assert found.along is not None
    assert found.along.causes == ("harmonics",)
    assert found.along.deflections[1] == pytest.approx(0.2, abs=0.02)
    assert found.quality == "fair"
    stated = findings(found).su_position_sd[-1]
    assert held_against(found, made.truth.urdf, tmp_path).position.rms < 2 * stated


def test_a_joint_that_goes_with_another_is_a_bad_fit() -> None:
    log = simulation_of(small_arm(3), **MEMS).recording
    other, name = log.joints[0], log.joints[1].name

    def bent(joint: JointStream) -> JointStream:
        position = joint.position + 0.2 * np.sin(3 * other.position)
        return replace(joint, position=position) if joint.name == name else joint

    with pytest.raises(BadFitError) as caught:
        calibrate(changed_joints(log, bent))
    assert caught.value.cost_per_dof > BAD_MISFIT


def test_a_reversed_joint_is_a_robot_with_a_reversed_axis() -> None:
    """A sign is a convention of the log: axis and joint turn the other way together."""
    name = plain().joints[2].name

    def reversed_(joint: JointStream) -> JointStream:
        return replace(joint, position=-joint.position) if joint.name == name else joint

    found = calibrate(changed_joints(plain(), reversed_), PATTERNS)
    assert found.quality == "good"


def test_rests_in_which_joints_still_settle_fit_like_the_others() -> None:
    """After a fast move a joint creeps on for a moment, too little to be fitted as motion."""
    made = simulation("kinova", upright=True, excite="all", n_poses=4, seed=100)
    fit = calibrate(made.recording, PATTERNS).goodness
    assert (fit.by_pose.per_dof < 4.0).all()
    assert (fit.held_out.per_dof < 4.0).all()


def test_rests_that_differ_by_a_milliradian_are_one_pose_with_exact_encoders_too() -> None:
    """As large numbers that cancel, slopes from such rests would spoil what gravity reads."""
    made = simulation(
        "kinova", upright=True, n_poses=5, seed=1007, grade="bma150", encoder_bits=None
    )
    assert (calibrate(made.recording, PATTERNS).goodness.by_pose.per_dof < 4.0).all()


def test_no_log_and_a_missing_one_are_errors_in_words(tmp_path: Path) -> None:
    with pytest.raises(InsufficientDataError) as lacking:
        calibrate([])
    assert lacking.value.lacks == "logs"
    with pytest.raises(UnreadableInputError) as caught:
        calibrate(tmp_path / "missing.mcap")
    assert caught.value.exit_status == 2
