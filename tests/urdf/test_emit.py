"""The URDF says exactly what the model says, to every reader."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from hypothesis import example, given, settings
from hypothesis import strategies as st

from skin2urdf.errors import BadFitError, UsageError
from skin2urdf.model.records import KinematicModel
from skin2urdf.structure.records import KinematicTree
from skin2urdf.urdf.check import check_urdf
from skin2urdf.urdf.emit import NOMINAL_MASS, SU_MASS, emit
from skin2urdf.urdf.limits import wide_limits
from skin2urdf.urdf.names import urdf_names
from skin2urdf.urdf.records import Remarks
from skin2urdf.urdf.rpy import rpy_of_rotation

Robots = Callable[..., KinematicModel]
Poses = Callable[[KinematicModel, np.ndarray], np.ndarray]

ANGLE = st.floats(-np.pi, np.pi)
FROM_LOCK = st.one_of(
    st.just(0.0),
    st.integers(-16, -1).map(lambda exponent: 10.0**exponent),
    st.floats(-np.pi, np.pi),
)


def limits_of(model: KinematicModel) -> np.ndarray:
    return np.tile([-1.5, 2.0], (model.tree.n_joints, 1))


def text_of(model: KinematicModel, *, visuals: bool = True) -> str:
    return emit(model, name="robot", limits=limits_of(model), visuals=visuals)


def configurations(model: KinematicModel, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.5, 2.0, (5, model.tree.n_joints))


@given(ANGLE, FROM_LOCK, ANGLE, st.sampled_from([-1, 1]))
@example(0.3, 1e-12, -2.0, 1)
def test_rpy_is_exact_at_and_near_gimbal_lock(
    roll: float, from_lock: float, yaw: float, side: int
) -> None:
    R = pin.rpy.rpyToMatrix(roll, side * (np.pi / 2 - from_lock), yaw)
    assert np.abs(pin.rpy.rpyToMatrix(rpy_of_rotation(R)) - R).max() < 1e-14


@settings(max_examples=50, deadline=None)
@given(ANGLE, FROM_LOCK, ANGLE, st.lists(st.floats(-2, 2), min_size=3, max_size=3))
def test_placements_survive_pinocchio(
    roll: float, from_lock: float, yaw: float, xyz: list[float]
) -> None:
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(roll, np.pi / 2 - from_lock, yaw)
    T[:3, 3] = xyz
    tree = KinematicTree(("j",), np.array([-1]), ("revolute",), ("su",), np.array([0]))
    text = text_of(KinematicModel(tree, T[None], T[None]), visuals=False)
    model = pin.buildModelFromXML(text)
    np.testing.assert_allclose(model.jointPlacements[1].homogeneous, T, rtol=0, atol=1e-13)
    frame = model.frames[model.getFrameId("su")]
    np.testing.assert_allclose(frame.placement.homogeneous, T, rtol=0, atol=1e-13)


def test_pinocchio_reads_the_same_robot(random_robot: Robots, su_poses: Poses) -> None:
    model = random_robot(np.random.default_rng(1))
    read = pin.buildModelFromXML(text_of(model))
    assert set(read.names) == {"universe", *model.tree.joint_names}
    data = read.createData()
    for q in configurations(model):
        q_read = np.empty(read.nq)
        for name, value in zip(model.tree.joint_names, q, strict=True):
            q_read[read.joints[read.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(read, data, q_read)
        got = [data.oMf[read.getFrameId(name)].homogeneous for name in model.tree.su_names]
        np.testing.assert_allclose(got, su_poses(model, q), atol=1e-12)
    np.testing.assert_array_equal(read.lowerPositionLimit, -1.5)
    np.testing.assert_array_equal(read.upperPositionLimit, 2.0)


def test_pinocchio_reads_the_visuals(random_robot: Robots, tmp_path: Path) -> None:
    model = random_robot(np.random.default_rng(2))
    path = tmp_path / "robot.urdf"
    path.write_text(text_of(model))
    read = pin.buildModelFromUrdf(str(path))
    shapes = pin.buildGeomFromUrdf(read, str(path), pin.GeometryType.VISUAL)
    tree = model.tree
    # A drum per joint, a rod to every joint and SU, three boxes per SU.
    assert shapes.ngeoms == 2 * tree.n_joints + 4 * tree.n_sus


def test_mujoco_reads_the_same_robot(random_robot: Robots, su_poses: Poses) -> None:
    model = random_robot(np.random.default_rng(3))
    read = mujoco.MjModel.from_xml_string(text_of(model))
    data = mujoco.MjData(read)
    for q in configurations(model):
        for name, value in zip(model.tree.joint_names, q, strict=True):
            data.qpos[read.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(read, data)
        got = np.tile(np.eye(4), (model.tree.n_sus, 1, 1))
        for u, name in enumerate(model.tree.su_names):
            got[u, :3, :3] = data.body(name).xmat.reshape(3, 3)
            got[u, :3, 3] = data.body(name).xpos
        np.testing.assert_allclose(got, su_poses(model, q), atol=1e-9)
    mujoco.mj_step(read, data)
    assert np.isfinite(data.qacc).all()
    assert read.ngeom > 0
    assert not read.geom_contype.any()


def test_mujoco_reads_it_without_visuals(random_robot: Robots) -> None:
    model = random_robot(np.random.default_rng(4))
    read = mujoco.MjModel.from_xml_string(text_of(model, visuals=False))
    assert read.ngeom == 0
    assert read.nv == model.tree.n_joints
    np.testing.assert_allclose(
        read.body_mass.sum(), NOMINAL_MASS * model.tree.n_joints + SU_MASS * model.tree.n_sus
    )


def test_yourdfpy_reads_the_same_robot(random_robot: Robots, su_poses: Poses) -> None:
    model = random_robot(np.random.default_rng(5))
    read = yourdfpy.URDF.load(io.BytesIO(text_of(model).encode()))
    assert read.validate()
    assert read.base_link == "base_link"
    for q in configurations(model):
        read.update_cfg(dict(zip(model.tree.joint_names, q, strict=True)))
        got = [read.get_transform(name) for name in model.tree.su_names]
        np.testing.assert_allclose(got, su_poses(model, q), atol=1e-9)


def test_limits_velocities_and_types_are_written(random_robot: Robots) -> None:
    model = random_robot(np.random.default_rng(6))
    n = model.tree.n_joints
    limits = np.stack([-np.arange(1, n + 1) / 3, np.arange(1, n + 1) / 7], axis=1)
    text = emit(model, name="a <robot> & co", limits=limits, velocity=np.arange(1, n + 1) / 9)
    root = ET.fromstring(text)  # noqa: S314  (our own text)
    assert root.get("name") == "a <robot> & co"
    for j, name in enumerate(model.tree.joint_names):
        joint = root.find(f"joint[@name='{name}']")
        assert joint is not None
        assert joint.get("type") == model.tree.joint_types[j]
        limit, axis = joint.find("limit"), joint.find("axis")
        assert limit is not None
        assert axis is not None
        assert [float(limit.get(k, "nan")) for k in ("lower", "upper")] == limits[j].tolist()
        assert float(limit.get("velocity", "nan")) == (j + 1) / 9
        assert float(limit.get("effort", "nan")) > 0
        assert axis.get("xyz") == "0 0 1"


def test_names_of_the_log_are_kept_and_clashes_resolved() -> None:
    tree = KinematicTree(
        ("base_link", "a", "b"),
        np.array([-1, 0, 1]),
        ("revolute",) * 3,
        ("base_link", "a", "b_link", "x & <y>"),
        np.array([-1, 0, 1, 2]),
    )
    names = urdf_names(tree)
    links = ["base_link", *names.joint_links, *names.su_links]
    joints = [*tree.joint_names, *names.su_joints]
    assert len({*links}) == len(links)
    assert len({*joints}) == len(joints)
    assert names.su_links == ("base_link_su", "a_su", "b_link", "x & <y>")
    model = KinematicModel(tree, np.tile(np.eye(4), (3, 1, 1)), np.tile(np.eye(4), (4, 1, 1)))
    read = pin.buildModelFromXML(text_of(model))
    assert list(read.names)[1:] == ["base_link", "a", "b"]
    assert read.existFrame("x & <y>")


def test_a_robot_without_joints_is_one_link_and_its_sus() -> None:
    tree = KinematicTree((), np.zeros(0), (), ("su",), np.array([-1]))
    text = text_of(KinematicModel(tree, np.zeros((0, 4, 4)), np.eye(4)[None]))
    assert pin.buildModelFromXML(text).existFrame("su")


@pytest.mark.parametrize("limits", [[1.0, 1.0], [2.0, -2.0], [np.nan, 1.0], [-np.inf, 1.0]])
def test_impossible_limits_are_refused(random_robot: Robots, limits: list[float]) -> None:
    model = random_robot(np.random.default_rng(7))
    bad = limits_of(model)
    bad[1] = limits
    with pytest.raises(UsageError, match="joint_1") as caught:
        emit(model, name="robot", limits=bad)
    assert caught.value.remedy


def test_placements_that_are_no_numbers_are_refused(random_robot: Robots) -> None:
    model = random_robot(np.random.default_rng(8))
    T = model.T_joint_su.copy()
    T[2, 0, 3] = np.nan
    with pytest.raises(BadFitError, match="su_2"):
        text_of(replace(model, T_joint_su=T))


@pytest.mark.parametrize("name", ["", "  ", "bell\x07", "\ud800"])
def test_names_that_xml_can_not_hold_are_refused(random_robot: Robots, name: str) -> None:
    model = random_robot(np.random.default_rng(9))
    tree = replace(model.tree, joint_names=(name, *model.tree.joint_names[1:]))
    with pytest.raises(UsageError) as caught:
        text_of(replace(model, tree=tree))
    assert repr(name) in str(caught.value)


def test_two_joints_of_one_name_are_refused(random_robot: Robots) -> None:
    model = random_robot(np.random.default_rng(10))
    tree = replace(model.tree, joint_names=("same", "same", *model.tree.joint_names[2:]))
    with pytest.raises(UsageError, match="'same'"):
        text_of(replace(model, tree=tree))


def test_a_joint_without_end_is_continuous(random_robot: Robots) -> None:
    """Pinocchio and yourdfpy still find every SU where the model has it."""
    model = random_robot(np.random.default_rng(6))
    tree = model.tree
    endless = ~tree.prismatic
    assert endless.any()
    text = emit(model, name="robot", limits=limits_of(model), continuous=endless)
    root = ET.fromstring(text)  # noqa: S314  (our own text)
    for j, name in enumerate(tree.joint_names):
        joint, limit = (root.find(f"joint[@name='{name}']{tail}") for tail in ("", "/limit"))
        assert joint is not None
        assert limit is not None
        assert joint.get("type") == ("continuous" if endless[j] else "prismatic")
        assert ("lower" in limit.attrib, "upper" in limit.attrib) == (not endless[j],) * 2
    check_urdf(text, model)


def test_placeholders_and_remarks_are_comments(random_robot: Robots) -> None:
    model = random_robot(np.random.default_rng(11))
    remarks = Remarks(("a -- b--", "bell\x07"), {"joint_1": ("weak",)}, {"su_2": ("open",)})
    text = emit(model, name="robot", limits=limits_of(model), remarks=remarks)
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))  # noqa: S314
    root = ET.fromstring(text, parser)  # noqa: S314  (our own text)

    def said(element: ET.Element | None) -> list[str]:
        assert element is not None
        return [(c.text or "").strip() for c in element if c.tag is ET.Comment]

    assert said(root) == ["a - - b- -", "bell?"]
    assert said(root.find("joint[@name='joint_1']")) == ["weak"]
    assert said(root.find("joint[@name='su_2_mount']")) == ["open"]
    assert all(said(inertial) for inertial in root.iter("inertial"))
    check_urdf(text, model)


def test_soft_limits_stand_beside_wide_ones(random_robot: Robots) -> None:
    model = random_robot(np.random.default_rng(12))
    seen = limits_of(model)
    wide = wide_limits(seen, np.ones(len(seen)), model.tree.prismatic, soft=True)
    text = emit(model, name="robot", limits=wide)
    root = ET.fromstring(text)  # noqa: S314  (our own text)
    for j, name in enumerate(model.tree.joint_names):
        limit, soft = (
            root.find(f"joint[@name='{name}']/{tag}") for tag in ("limit", "safety_controller")
        )
        assert limit is not None
        assert soft is not None
        ends = [float(limit.get(key, "nan")) for key in ("lower", "upper")]
        assert ends == wide.position[j].tolist()
        kept = [float(soft.get(f"soft_{key}_limit", "nan")) for key in ("lower", "upper")]
        assert kept == seen[j].tolist()
    read = pin.buildModelFromXML(text)
    assert (read.lowerPositionLimit <= 0).all()
    check_urdf(text, model)


def test_shapes_collide_where_asked_to(random_robot: Robots) -> None:
    model = random_robot(np.random.default_rng(13))
    text = emit(model, name="robot", limits=limits_of(model), visuals=False, collision=True)
    assert "<visual" not in text
    read = mujoco.MjModel.from_xml_string(text)
    assert read.ngeom > model.tree.n_sus
    assert read.geom_contype.all()
