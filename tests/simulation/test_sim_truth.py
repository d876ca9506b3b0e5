from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skin2urdf.arrays import F64
from skin2urdf.simulation import Simulation, SimulationSettings, load_robot, simulate
from skin2urdf.simulation.mechanism import load_mechanism
from skin2urdf.simulation.truth_urdf import origin_element, origin_placement

SHORT = SimulationSettings(n_poses=1, imu_rate=50.0, joint_rate=50.0)


def frames(model: pin.Model, q: F64) -> dict[str, F64]:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return {f.name: data.oMf[i].homogeneous for i, f in enumerate(model.frames)}


@pytest.mark.parametrize("name", ["panda", "kinova", "z1", "so101"])
def test_truth_urdf_is_the_original_robot(name: str) -> None:
    robot = load_robot(name)
    truth = simulate(robot, SHORT).truth
    original = load_mechanism(robot, robot.base_rpy)
    model = pin.buildModelFromXML(truth.urdf)
    assert tuple(model.names)[1:] == original.joint_names == truth.joint_names
    np.testing.assert_allclose(model.lowerPositionLimit, original.model.lowerPositionLimit)
    np.testing.assert_allclose(model.upperPositionLimit, original.model.upperPositionLimit)

    position = np.random.default_rng(0).uniform(-1, 1, (5, original.n_joints))
    for q in original.configuration(position):
        ours, theirs = frames(model, q), frames(original.model, q)
        for frame in set(ours) & set(theirs):
            np.testing.assert_allclose(ours[frame], theirs[frame], atol=1e-12)
        data = original.model.createData()
        pin.forwardKinematics(original.model, data, q)
        for su in truth.sus:
            expected = data.oMi[su.joint + 1].homogeneous @ su.T_joint_su
            np.testing.assert_allclose(ours[su.name], expected, atol=1e-12)


def test_locked_joints_are_baked_in(gantry: Path) -> None:
    locked = {"slide": 0.25, "grip_left": 0.03, "grip_right": -0.7}
    robot = replace(load_robot(gantry), locked=locked)
    truth = simulate(robot, SHORT).truth
    model = pin.buildModelFromXML(truth.urdf)
    assert list(model.names)[1:] == ["swing"]
    full = pin.buildModelFromUrdf(str(gantry))
    q = pin.neutral(full)
    for name, value in locked.items():
        q[full.joints[full.getJointId(name)].idx_q] = value
    ours, theirs = frames(model, pin.neutral(model)), frames(full, q)
    for link in ("carriage", "arm", "left", "right"):
        np.testing.assert_allclose(ours[link], theirs[link], atol=1e-12)
    assert "mimic" not in truth.urdf


def test_truth_urdf_needs_no_other_file() -> None:
    xml = ET.fromstring(simulate(load_robot("panda"), SHORT).truth.urdf)  # noqa: S314
    assert {child.tag for child in xml} == {"link", "joint"}
    assert not list(xml.iter("mesh"))
    assert not list(xml.iter("visual"))


@given(st.tuples(*[st.floats(-3.2, 3.2)] * 3), st.booleans())
def test_rotations_survive_as_rpy(rpy: tuple[float, float, float], locked_up: bool) -> None:
    if locked_up:
        rpy = (rpy[0], np.pi / 2, rpy[2])
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(*rpy)
    T[:3, 3] = 0.1, 1 / 3, -2e-7
    again = origin_placement(origin_element(T))
    np.testing.assert_allclose(again, T, atol=1e-14)


def test_gravity_is_that_of_the_tilted_base(panda_one: Simulation) -> None:
    roll, pitch = np.radians([25.0, 15.0])
    up = pin.rpy.rpyToMatrix(roll, pitch, 0.0).T @ [0, 0, 1]
    np.testing.assert_allclose(panda_one.truth.gravity_base, -9.81 * up, atol=1e-12)
    upright = simulate(load_robot("panda"), replace(SHORT, upright=True)).truth
    np.testing.assert_allclose(upright.gravity_base, [0, 0, -9.81], atol=1e-12)
