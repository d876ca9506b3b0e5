"""Robots that are in no repository, from their recording to their URDF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from random_robots import Joint, random_joints, robot_of
from simulated import features_of, held_against, tree_of

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import Simulation, SimulationSettings, simulate
from skin2urdf.simulation.settings import Excitation


def recorded(
    seed: int, sizes: tuple[int, int], excite: Excitation, n_poses: int, folder: Path
) -> tuple[tuple[Joint, ...], Simulation]:
    """A random robot and a short recording of it."""
    rng = np.random.default_rng(seed)
    joints = random_joints(rng, int(rng.integers(*sizes)))
    settings = SimulationSettings(
        n_poses=n_poses, seed=seed, excite=excite, imu_rate=250.0, joint_rate=125.0
    )
    return joints, simulate(robot_of(joints, folder), settings)


@pytest.mark.parametrize("seed", [3, 15, 17, 41, 46, 57])
def test_the_first_look_tells_what_slides_and_what_turns(seed: int, tmp_path: Path) -> None:
    """Four poses with all joints moving at once: other joints' motion spoils slopes and pushes."""
    joints, sim = recorded(seed, (3, 7), "all", 4, tmp_path)
    tree = tree_of(features_of(retimed(sim.recording)))
    slides = {joint.name for joint in joints if joint.kind == "prismatic"}
    assert slides
    found = zip(tree.joint_names, tree.joint_types, strict=True)
    assert {name for name, kind in found if kind == "prismatic"} == slides
    truth = {su.name: su.joint for su in sim.truth.sus}
    for su, joint in zip(tree.su_names, tree.su_joint, strict=True):
        carrier = tree.joint_names[joint] if joint >= 0 else None
        assert carrier == (sim.truth.joint_names[truth[su]] if truth[su] >= 0 else None)


@pytest.mark.parametrize("seed", [1009, 1011, 1018])
def test_a_random_robot_is_found(seed: int, tmp_path: Path) -> None:
    joints, sim = recorded(seed, (2, 9), "all" if seed % 2 else "one", 4, tmp_path)
    found = calibrate(retimed(sim.recording))
    assert found.model.tree.n_joints == len(joints)
    assert found.quality == "good"
    comparison = held_against(found, sim.truth.urdf, tmp_path)
    assert comparison.tree_equal, comparison.tree_differences
    whole = [su for su in comparison.sus if not su.n_unobservable and su.position is not None]
    assert whole
    assert all(su.position.rms < 1e-3 for su in whole if su.position)
    kinds = dict(zip(found.model.tree.joint_names, found.model.tree.joint_types, strict=True))
    for joint in joints:
        assert (kinds[joint.name] == "prismatic") == (joint.kind == "prismatic")
