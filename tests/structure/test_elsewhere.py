"""SUs sit where accelerations say, in whatever order joints that gravity hides came in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from random_robots import Joint, robot_of
from simulated import changed_sus

from skin2urdf.recording.records import SuStream
from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.sampling import sampled_together
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout
from skin2urdf.structure.accelerations import ChainJoint, along
from skin2urdf.structure.draft import Draft
from skin2urdf.structure.elsewhere import with_sus_elsewhere
from skin2urdf.structure.from_motion import trees_from_motion

SCARA = (
    Joint("shoulder", -1, "revolute"),
    Joint("elbow", 0, "revolute", (0.25, 0.0, 0.1)),
    Joint("wrist", 1, "revolute", (0.22, 0.02, 0.0)),
    Joint("lift", 2, "prismatic", (0.03, 0.05, 0.0), limits=(-0.1, 0.1)),
)


def test_a_scara_is_found_from_moves_alone(tmp_path: Path) -> None:
    """The wrist explains some of what the elbow does to an SU, as long as that is not known."""
    settings = SimulationSettings(
        n_poses=10, seed=1, excite="none", upright=True, imu_rate=100.0, joint_rate=50.0
    )
    simulation = simulate(robot_of(SCARA, tmp_path, SkinLayout(1, 0)), settings)
    logs, names = sampled_together([retimed(simulation.recording)])
    found, *_ = trees_from_motion(logs, names)
    assert found.tree.joint_names == simulation.truth.joint_names
    assert found.tree.joint_types == tuple(joint.kind for joint in SCARA)
    assert found.tree.parent.tolist() == [-1, 0, 1, 2]
    joint = {su.name: su.joint for su in simulation.truth.sus}
    assert found.tree.su_joint.tolist() == [joint[name] for name in found.tree.su_names]


def test_an_su_that_no_slide_pushes_sits_before_it(tmp_path: Path) -> None:
    """Any push suits it, none at all as well: the lift was put before the wrist that carries it."""
    settings = SimulationSettings(
        minutes=0.4, seed=6, excite="series", upright=True, imu_rate=100.0, joint_rate=50.0
    )
    simulation = simulate(robot_of(SCARA, tmp_path, SkinLayout(1, 1)), settings)
    logs, names = sampled_together([retimed(simulation.recording)], must_rest=False)
    found, *_ = trees_from_motion(logs, names)
    assert found.tree.joint_names == simulation.truth.joint_names
    joint = {su.name: su.joint for su in simulation.truth.sus}
    assert found.tree.su_joint.tolist() == [joint[name] for name in found.tree.su_names]


COAXIAL = (
    Joint("turntable", -1, "revolute", (0.0, 0.0, 0.2)),
    Joint("waist", 0, "revolute", (0.0, 0.0, 0.05)),
    Joint("shoulder", 1, "revolute", (0.2, 0.0, 0.05), (-np.pi / 2, 0.0, 0.0)),
)
TURNTABLE = (
    Joint("turntable", -1, "revolute", (0.25, 0.0, 0.25)),
    Joint("slide", 0, "prismatic", (0.35, 0.0, 0.1), (np.pi / 2, 0.0, 0.0), limits=(-0.15, 0.15)),
    Joint("wrist", 1, "revolute", (0.25, 0.0, 0.28), (np.pi / 2, 0.0, 0.0)),
)
ON_A_SLIDE = (
    Joint("shoulder", -1, "revolute"),
    Joint("elbow", 0, "revolute", (0.25, 0.0, 0.05)),
    Joint("slide", 1, "prismatic", (0.2, 0.0, 0.0), limits=(-0.1, 0.1)),
    Joint("wrist", 2, "revolute", (0.0, 0.0, -0.1)),
)


@pytest.mark.parametrize(
    ("joints", "seed"), [(COAXIAL, 10), (COAXIAL, 11), (ON_A_SLIDE, 10), (ON_A_SLIDE, 14)]
)
def test_what_two_hidden_joints_move_is_found_beyond_both(
    joints: tuple[Joint, ...], seed: int, tmp_path: Path
) -> None:
    """All joints move at once: either of two that gravity does not show explains next to nothing.

    An SU on a slide is turned by the vertical joint before it.
    """
    settings = SimulationSettings(
        excite="none", minutes=0.8, seed=seed, upright=True, imu_rate=100.0, joint_rate=50.0
    )
    simulation = simulate(robot_of(joints, tmp_path, SkinLayout(1, 1)), settings)
    logs, names = sampled_together([retimed(simulation.recording)], must_rest=False)
    found, *_ = trees_from_motion(logs, names)
    assert found.tree.joint_types == tuple(joint.kind for joint in joints)
    assert found.tree.parent.tolist() == [joint.parent for joint in joints]
    joint = {su.name: su.joint for su in simulation.truth.sus}
    assert found.tree.su_joint.tolist() == [joint[name] for name in found.tree.su_names]


@pytest.mark.parametrize(("excite", "seed"), [("none", 1), ("all", 1), ("all", 3)])
def test_an_su_on_the_base_that_warms_up_is_not_carried(
    excite: Literal["none", "all"], seed: int, tmp_path: Path
) -> None:
    """Where a joint stays for a while, what its position makes of gravity foretells a drift."""
    settings = SimulationSettings(
        n_poses=9, excite=excite, seed=seed, upright=True, imu_rate=100.0, joint_rate=50.0
    )
    simulation = simulate(robot_of(TURNTABLE, tmp_path, SkinLayout(1, 1)), settings)
    joint = {su.name: su.joint for su in simulation.truth.sus}
    rng = np.random.default_rng(seed)

    def warms_up(su: SuStream) -> SuStream:
        warmth = 1 - np.exp(-(su.time - su.time[0]) / 60)
        drift = 0.05 * rng.uniform(-1, 1, 3) * warmth[:, None]
        return replace(su, specific_force=su.specific_force + drift)

    logs, names = sampled_together([changed_sus(retimed(simulation.recording), warms_up)])
    found = trees_from_motion(logs, names)[0]
    assert found.tree.joint_types == tuple(each.kind for each in TURNTABLE)
    on_base = [u for u, name in enumerate(names) if joint[name] < 0]
    order = [found.tree.su_names.index(name) for name in names]
    dofs = [logs[0].motion.dof_names.index(name) for name in found.tree.joint_names]
    su_joint = found.tree.su_joint[order]
    su_joint[on_base] = 0
    draft = Draft(
        joints=tuple(
            ChainJoint(dof, kind, (float(x), float(y), float(z)))
            for dof, kind, (x, y, z) in zip(dofs, found.tree.joint_types, found.axes, strict=True)
        ),
        parent=tuple(found.tree.parent.tolist()),
        su_joint=su_joint,
        R=found.R_base_su[order],
        sensor=np.hstack([found.bias, found.shape])[order],
        up=found.up,
    )
    settled = with_sus_elsewhere(draft, along(logs))
    assert settled.su_joint.tolist() == [joint[name] for name in names]


def test_an_su_on_a_base_that_a_rail_shakes_stays_on_the_base(tmp_path: Path) -> None:
    """It feels a tenth of what the rail does to those that it carries."""
    joints = (
        Joint("rail", -1, "prismatic", rpy=(1.5, 0.4, 0.0), limits=(-0.2, 0.2)),
        Joint("elbow", 0, "revolute", (0.05, 0.0, 0.2), (1.5, 0.0, 0.0)),
    )
    settings = SimulationSettings(
        n_poses=10, seed=1, excite="none", upright=True, imu_rate=100.0, joint_rate=50.0
    )
    simulation = simulate(robot_of(joints, tmp_path, SkinLayout(1, 1)), settings)
    joint = {su.name: su.joint for su in simulation.truth.sus}
    recording = retimed(simulation.recording)
    carried = next(su for su in recording.sus if joint[su.name] == 0)

    def sways(su: SuStream) -> SuStream:
        if joint[su.name] >= 0:
            return su
        felt = 0.1 * (carried.specific_force - np.median(carried.specific_force, axis=0))
        more = np.stack([np.interp(su.time, carried.time, f) for f in felt.T], axis=1)
        return replace(su, specific_force=su.specific_force + more)

    logs, names = sampled_together([changed_sus(recording, sways)])
    found, *_ = trees_from_motion(logs, names)
    at = dict(zip(found.tree.su_names, found.tree.su_joint.tolist(), strict=True))
    assert at == joint
