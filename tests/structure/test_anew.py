"""Joints that gravity does not show are placed once more when all others have a place."""

from __future__ import annotations

import numpy as np
import pytest
from random_robots import Joint, robot_of

from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.sampling import sampled_together
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout
from skin2urdf.structure.accelerations import Along, ChainJoint, along
from skin2urdf.structure.anew import that_slide_elsewhere, with_joints_elsewhere
from skin2urdf.structure.draft import Draft

UPRIGHT = (0.0, 0.0, 1.0)
JOINTS = (
    Joint("a_turns", -1, "revolute"),
    Joint("b_slides", 0, "prismatic", rpy=(np.pi / 2, 0.0, 0.0), limits=(-0.2, 0.2)),
)
TURNS, SLIDES = 0, 1


@pytest.fixture(scope="module")
def mistaken(tmp_path_factory: pytest.TempPathFactory) -> tuple[Along, Draft]:
    """A log, and a draft of it whose slide is a vertical joint before the one that carries it."""
    robot = robot_of(JOINTS, tmp_path_factory.mktemp("robot"), SkinLayout(1, 1))
    settings = SimulationSettings(
        n_poses=12, seed=2, excite="none", upright=True, imu_rate=250.0, joint_rate=125.0
    )
    simulation = simulate(robot, settings)
    logs, names = sampled_together([retimed(simulation.recording)])
    assert logs[0].motion.dof_names == ("a_turns", "b_slides")
    # At position zero: the joint's frame carries over to the SUs beyond it.
    turned = {"a_turns": np.eye(3), "b_slides": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]])}
    sus = {su.name: su for su in simulation.truth.sus}
    R = np.array([turned.get(sus[n].joint, np.eye(3)) @ sus[n].T_joint_su[:3, :3] for n in names])
    on_base = np.array([sus[name].joint not in turned for name in names])
    draft = Draft(
        joints=(ChainJoint(SLIDES, "revolute", UPRIGHT), ChainJoint(TURNS, "revolute", UPRIGHT)),
        parent=(-1, 0),
        su_joint=np.where(on_base, -1, 1),
        R=R,
        sensor=np.zeros((len(names), 9)),
        up=np.array([UPRIGHT]),
    )
    return along(logs), draft


def test_a_joint_that_was_put_in_too_early_is_placed_anew(mistaken: tuple[Along, Draft]) -> None:
    samples, draft = mistaken
    found = with_joints_elsewhere(draft, samples, (TURNS, SLIDES))
    assert [(joint.dof, joint.kind) for joint in found.joints] == [
        (TURNS, "revolute"), (SLIDES, "prismatic"),
    ]  # fmt: skip
    assert found.parent == (-1, 0)
    assert sorted(found.su_joint) == [-1, 0, 1]
    # What is where it belongs stays there.
    assert with_joints_elsewhere(found, samples, (TURNS, SLIDES)) is found


def test_a_vertical_joint_that_slides_elsewhere_is_told(mistaken: tuple[Along, Draft]) -> None:
    samples, draft = mistaken
    assert that_slide_elsewhere(draft, samples) == (SLIDES,)
    placed = with_joints_elsewhere(draft, samples, (TURNS, SLIDES))
    assert that_slide_elsewhere(placed, samples) == ()
