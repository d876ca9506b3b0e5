from __future__ import annotations

from math import radians

import numpy as np
import pytest

from skin2urdf.arrays import Bool
from skin2urdf.paper.exploration import explore, or_combination, static_activity
from skin2urdf.signals.features import extract_features
from skin2urdf.signals.sampling import sample_recording, static_moves
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.simulation.mechanism import load_mechanism
from skin2urdf.structure.activity import activity
from skin2urdf.structure.tree import nested

BASES = tuple((radians(roll), radians(15.0), 0.0) for roll in (25.0, 115.0))
SHORT = {"excite": "all", "imu_rate": 100, "joint_rate": 100, "seed": 1}


def true_activity(name: str, su_joints: list[int]) -> Bool:
    robot = load_robot(name)
    parent = load_mechanism(robot, robot.base_rpy).parent
    active = np.zeros((len(su_joints), len(parent)), dtype=bool)
    for u, joint in enumerate(su_joints):
        while joint >= 0:
            active[u, joint] = True
            joint = int(parent[joint])
    return active


@pytest.mark.parametrize(("name", "segments", "limbs"), [("icub", 14, 5), ("panda", 8, 1)])
def test_a_recorded_robot_is_explored_exactly(name: str, segments: int, limbs: int) -> None:
    logs = []
    for base in BASES:
        settings = SimulationSettings(n_poses=2, base_rpy=base, **SHORT)
        simulation = simulate(load_robot(name), settings)
        sus = [su.name for su in simulation.truth.sus]
        dofs = simulation.truth.joint_names
        logs.append(sample_recording(simulation.recording, dofs, sus))
    expected = true_activity(name, [su.joint for su in simulation.truth.sus])
    static = or_combination([static_activity(static_moves([log]), len(dofs)) for log in logs])
    np.testing.assert_array_equal(static, expected)
    evidence = activity(extract_features(logs[:1], sus)).evidence
    np.testing.assert_array_equal(nested(evidence, sus, dofs)[0], expected)
    found = explore(static, sus, dofs)
    assert not found.violations
    assert (found.n_segments, len(found.limbs)) == (segments, limbs)


@pytest.mark.parametrize(
    ("name", "dofs", "three_dof_joints", "true_ends", "false_ends"),
    [
        ("talos", 28, 4, 5, 0),
        ("romeo", 30, 7, 5, 0),
        ("icub", 29, 5, 5, 0),
        ("simple_humanoid", 26, 6, 4, 0),
        ("g1", 40, 6, 8, 2),
    ],
)
def test_the_humanoids_are_the_papers_test_case(
    name: str, dofs: int, three_dof_joints: int, true_ends: int, false_ends: int
) -> None:
    robot = load_robot(name)
    mechanism = load_mechanism(robot, robot.base_rpy)
    assert mechanism.n_joints == dofs
    links = {link: d for d, link in enumerate(mechanism.link_names)}
    body = [mechanism.model.getBodyId(su.link) for su in robot.skin.given]
    joints = [mechanism.model.frames[b].parentJoint - 1 for b in body] + [-1, -1]
    assert set(joints) - {-1} <= set(links.values())
    found = explore(
        true_activity(name, joints), [str(u) for u in range(len(joints))], mechanism.joint_names
    )
    assert not found.violations
    assert sum(len(group) >= 3 for group in found.joints) == three_dof_joints
    assert len(found.true_end_effectors) == true_ends
    assert len(found.false_end_effectors) == false_ends
    assert len(found.segments[0]) == 3  # the trunk is static, and one of its SUs is on the chest
    assert max(len(group) for group in found.segments[1:]) == 2
