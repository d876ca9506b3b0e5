"""Robots and skins that make it hard: small ranges, many turns, special axes, bare segments."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_robots import Joint, chain, robot_of
from simulated import PATTERNS, changed_joints, held_against

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.notes import of_kind
from skin2urdf.output import render
from skin2urdf.simulation import RobotSpec, Simulation, SimulationSettings, simulate
from skin2urdf.simulation.robots import GivenSu, SkinLayout
from skin2urdf.simulation.settings import MotionSettings
from skin2urdf.urdf.records import Comparison

AXES = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))


def wrist(n: int, *axes: tuple[float, ...]) -> tuple[Joint, ...]:
    """Joints without turns between them, their axes along the given directions in turn."""
    plain = chain(n)
    return tuple(
        replace(joint, rpy=(0.0, 0.0, 0.0), axis=axes[d % len(axes)])
        for d, joint in enumerate(plain)
    )


def skin(*links: int, at: tuple[float, float, float] = (0.05, 0.02, 0.07)) -> SkinLayout:
    """An SU on each of some links and nowhere else."""
    given = (GivenSu(f"link_j{d}", at, (0.3 * d, 0.2, 1.0)) for d in links)
    return SkinLayout(sus_per_segment=0, sus_on_base=0, given=tuple(given))


def found(
    robot: RobotSpec, folder: Path, along: bool = True, **options: object
) -> tuple[Calibration, Comparison]:
    """Calibration of a short recording, with all samples or by its patterns; how it compares."""
    sim = recorded(robot, **options)
    calibration = calibrate(sim.recording, None if along else PATTERNS)
    return calibration, held_against(calibration, sim.truth.urdf, folder)


def recorded(robot: RobotSpec, **options: object) -> Simulation:
    settings = {"n_poses": 4, "imu_rate": 250.0, "joint_rate": 125.0, "excite": "all", "seed": 2}
    return simulate(robot, SimulationSettings(**{**settings, **options}))  # type: ignore[arg-type]


def check(
    calibration: Calibration, comparison: Comparison, millimetres: float, degrees: float = 0.1
) -> None:
    assert comparison.tree_equal, comparison.tree_differences
    assert calibration.estimate.cost_per_dof < 2.0
    assert comparison.position.rms < 1e-3 * millimetres
    assert np.rad2deg(comparison.orientation.rms) < degrees


@pytest.mark.parametrize(("limits", "upright"), [((-0.175, 0.175), True), ((0.9, 1.25), False)])
def test_twenty_degrees_of_range_do(
    limits: tuple[float, float], upright: bool, tmp_path: Path
) -> None:
    """One and the same range for all joints, around zero or far from it.

    A sensor that hardly turns can hardly tell its bias of 5 mg (0.3 deg) from its tilt.
    """
    robot = robot_of(chain(4, turns=1.4, limits=limits), tmp_path)
    calibration, comparison = found(robot, tmp_path, along=upright, upright=upright)
    check(calibration, comparison, 0.5, 0.3)
    assert (np.ptp(calibration.limits, axis=1) < 0.36).all()


def test_many_turns_wrapped_or_not(tmp_path: Path) -> None:
    """Positions of up to 35 rad; drivers publish them as they are or inside (-pi, pi]."""
    joints = chain(3, turns=1.4)
    joints = tuple(replace(j, kind="continuous") if d % 2 else j for d, j in enumerate(joints))
    motion = MotionSettings(half_range=35.0, angular_speed=6.0)
    sim = recorded(replace(robot_of(joints, tmp_path), motion=motion))
    assert max(np.abs(j.position).max() for j in sim.recording.joints) > 20.0
    wrapped = changed_joints(
        sim.recording,
        lambda j: replace(j, position=(j.position + np.pi) % (2 * np.pi) - np.pi),
    )
    for recording, settings in ((sim.recording, None), (wrapped, PATTERNS)):
        calibration = calibrate(recording, settings)
        check(calibration, held_against(calibration, sim.truth.urdf, tmp_path), 0.5)
        endless = dict(zip(calibration.model.tree.joint_names, calibration.continuous, strict=True))
        assert endless == {"j0": False, "j1": True, "j2": False}
        text, document = render(calibration, "robot")
        assert text.count('type="continuous"') == 1
        assert document["joints"]["j1"]["type"] == "continuous"
        assert document["joints"]["j0"]["type"] == "revolute"


@pytest.mark.parametrize("upright", [False, True])
def test_every_su_on_the_axis_of_its_joint(upright: bool, tmp_path: Path) -> None:
    """No lever arm within a segment. On a vertical axis such an SU feels no more than the base."""
    robot = robot_of(wrist(4, *AXES), tmp_path, skin(0, 1, 2, 3, at=(0.0, 0.0, 0.0)))
    calibration, comparison = found(robot, tmp_path, along=not upright, upright=upright)
    if not upright:
        check(calibration, comparison, 0.5)
        return
    first, *_ = (su.name for su in recorded(robot).truth.sus if su.link == "link_j0")
    (difference,) = comparison.tree_differences
    assert (difference.name, difference.found, difference.right) == (first, (), ("j0",))
    tree = calibration.model.tree
    assert tree.su_joint[tree.su_names.index(first)] < 0
    assert comparison.position.rms < 0.5e-3
    assert calibration.estimate.cost_per_dof < 2.0


@pytest.mark.parametrize("links", [(1, 3), (3,), (0, 1, 2)])
def test_segments_without_sus(links: tuple[int, ...], tmp_path: Path) -> None:
    """At the root, in between, all but the tip; a joint beyond the last SU is left out and said."""
    robot = robot_of(wrist(4, *AXES), tmp_path, skin(*links))
    calibration, comparison = found(robot, tmp_path, along=links == (3,))
    if 3 in links:
        check(calibration, comparison, 0.5)
        assert comparison.joints_left_out == ()
    else:
        assert "j3" not in calibration.model.tree.joint_names
        left = of_kind(calibration.notes, "joint left out")
        assert [note.joints for note in left] == [("j3",)]
    assert (calibration.model.tree.su_joint >= 0).all()


@pytest.mark.parametrize("upright", [False, True])
def test_parallel_axes(upright: bool, tmp_path: Path) -> None:
    """Three parallel axes in a row, like shoulder, elbow and wrist of a planar arm."""
    robot = robot_of(wrist(5, AXES[0], AXES[1], AXES[1], AXES[1], AXES[2]), tmp_path)
    check(*found(robot, tmp_path, along=upright, upright=upright), 0.5)


def test_several_sus_on_a_segment(tmp_path: Path) -> None:
    robot = robot_of(chain(3, turns=1.4), tmp_path, SkinLayout(sus_per_segment=3, sus_on_base=2))
    calibration, comparison = found(robot, tmp_path)
    check(calibration, comparison, 0.5)
    assert np.bincount(calibration.model.tree.su_joint + 1).tolist() == [2, 3, 3, 3]


@pytest.mark.parametrize("apart", [True, False])
def test_of_motions_that_depend_on_each_other_no_place_is_promised(
    apart: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Four joints at once: eight tones between 1 and 4 Hz need more than 0.6 s to be told apart."""
    if not apart:
        monkeypatch.setattr("skin2urdf.simulation.motion.distinct_time", lambda *_: 0.0)
    briefly = MotionSettings(pattern_time_all=0.6, ramp=0.3)
    sim = recorded(robot_of(chain(4, turns=1.4), tmp_path), n_poses=5, motion=briefly)
    found = calibrate(sim.recording, CalibrationSettings(motion="patterns"))
    assert found.quality == ("good" if apart else "fair")
    assert ("determined" in found.observability.su_verdict) == apart
