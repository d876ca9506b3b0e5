"""Joints that gravity does not show are placed once more when all others have a place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_robots import Joint, robot_of
from scipy.spatial.transform import Rotation

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
TWO_SLIDES = (*JOINTS, Joint("c_slides", 1, "prismatic", rpy=(0.7, 0.4, 0.0), limits=(-0.2, 0.2)))
TURNS, SLIDES, LAST = 0, 1, 2


def recorded(
    joints: tuple[Joint, ...], folder: Path, drafted: tuple[ChainJoint, ...], until: int
) -> tuple[Along, Draft]:
    """A log of a chain with an SU on each segment, and a draft of other joints.

    Args:
        joints: of the robot.
        folder: to keep it in.
        drafted: a chain that is taken for it.
        until: joint from which on all SUs are taken to sit at its end.
    """
    settings = SimulationSettings(
        n_poses=12, seed=2, excite="none", upright=True, imu_rate=250.0, joint_rate=125.0
    )
    simulation = simulate(robot_of(joints, folder, SkinLayout(1, 1)), settings)
    logs, names = sampled_together([retimed(simulation.recording)])
    assert logs[0].motion.dof_names == tuple(joint.name for joint in joints)
    # At position zero: the joints' frames carry over to the SUs beyond them.
    turned = [np.eye(3)]
    for joint in joints:
        turned.append(turned[-1] @ Rotation.from_euler("xyz", joint.rpy).as_matrix())
    sus = {su.name: su for su in simulation.truth.sus}
    at = np.array([sus[name].joint for name in names])
    R = np.array([turned[sus[n].joint + 1] @ sus[n].T_joint_su[:3, :3] for n in names])
    draft = Draft(
        joints=drafted,
        parent=tuple(range(-1, len(drafted) - 1)),
        su_joint=np.where(at < until, at, len(drafted) - 1),
        R=R,
        sensor=np.zeros((len(names), 9)),
        up=np.array([UPRIGHT]),
    )
    return along(logs), draft


@pytest.fixture(scope="module")
def mistaken(tmp_path_factory: pytest.TempPathFactory) -> tuple[Along, Draft]:
    """A log, and a draft of it whose slide is a vertical joint before the one that carries it."""
    vertical = ChainJoint(SLIDES, "revolute", UPRIGHT), ChainJoint(TURNS, "revolute", UPRIGHT)
    return recorded(JOINTS, tmp_path_factory.mktemp("robot"), vertical, until=0)


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


def test_no_su_is_left_beyond_a_slide_that_does_not_push_it(tmp_path: Path) -> None:
    """What the slide's weight does to elastic gears before both goes with its acceleration."""
    chain = (
        ChainJoint(TURNS, "revolute", UPRIGHT),
        ChainJoint(LAST, "prismatic", UPRIGHT),
        ChainJoint(SLIDES, "prismatic", UPRIGHT),
    )
    samples, draft = recorded(TWO_SLIDES, tmp_path, chain, until=1)
    readings = samples.readings.copy()
    readings += 0.03 * samples.qdd[:, [LAST], None] * draft.R[:, 0]
    samples = replace(samples, readings=readings)
    found = with_joints_elsewhere(draft, samples, (SLIDES, LAST))
    chains = [[found.joints[j].dof for j in found.path(int(at))] for at in found.su_joint]
    assert sorted(chains, key=len) == [[], [TURNS], [TURNS, SLIDES], [TURNS, SLIDES, LAST]]


def test_a_vertical_joint_that_slides_elsewhere_is_told(mistaken: tuple[Along, Draft]) -> None:
    samples, draft = mistaken
    assert that_slide_elsewhere(draft, samples) == (SLIDES,)
    placed = with_joints_elsewhere(draft, samples, (TURNS, SLIDES))
    assert that_slide_elsewhere(placed, samples) == ()
