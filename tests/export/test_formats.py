"""Exports read back the way their users read them."""

from __future__ import annotations

import ast
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml
from calibrated import calibration

from skin2urdf.cli.main import main
from skin2urdf.errors import UsageError
from skin2urdf.export.imu import to_imu
from skin2urdf.export.kinematics import Style, to_kinematics
from skin2urdf.export.launch import to_launch
from skin2urdf.export.mjcf import to_mjcf
from skin2urdf.export.source import Source, load_source, rotation_of_rpy
from skin2urdf.export.xacro import to_xacro
from skin2urdf.geometry.se3 import inverse
from skin2urdf.model.poses import su_poses
from skin2urdf.simulation import load_robot

NUMBERS = ["x", "y", "z", "roll", "pitch", "yaw"]


def placed_by_name() -> dict[str, np.ndarray]:
    """T_joint_su of the SUs that are not on the base."""
    model = calibration().model
    return {
        name: T
        for name, T, joint in zip(
            model.tree.su_names, model.T_joint_su, model.tree.su_joint, strict=True
        )
        if joint >= 0
    }


def test_xacro_puts_every_su_onto_a_link_of_another_description(
    source: Source, tmp_path: Path
) -> None:
    xacro = pytest.importorskip("xacro", reason="needs xacro")
    (tmp_path / "skin.xacro").write_text(to_xacro(source))
    links = {su.joint.parent: f"vendor_{n}" for n, su in enumerate(source.placed_sus())}
    macros = ET.fromstring(to_xacro(source))  # noqa: S314 - our own text
    names = [m.get("name", "") for m in macros if m.tag.endswith("macro")]
    calls = {
        m.get("name", ""): m.get("params", "").split("parent:=")[-1].split()[0]
        for m in macros
        if m.get("name") != "skin"
    }
    assert names[-1] == "skin"
    (tmp_path / "robot.xacro").write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        f'<xacro:include filename="{tmp_path}/skin.xacro"/>'
        + "".join(f'<link name="{link}"/>' for link in links.values())
        + "".join(
            f'<xacro:{macro} parent="{links[link]}" prefix="left_"/>'
            for macro, link in calls.items()
        )
        + "</robot>"
    )
    text = xacro.process_file(str(tmp_path / "robot.xacro")).toxml()
    root = ET.fromstring(text)  # noqa: S314 - our own text
    for name, T in placed_by_name().items():
        joint = next(
            j for j in root.findall("joint") if j.find("child").get("link") == f"left_{name}"
        )
        assert joint.get("type") == "fixed"
        assert joint.find("parent").get("link", "").startswith("vendor_")
        xyz, rpy = (
            np.array([float(x) for x in joint.find("origin").get(key, "").split()])
            for key in ("xyz", "rpy")
        )
        np.testing.assert_array_equal(xyz, T[:3, 3] + 0.0)
        np.testing.assert_allclose(rotation_of_rpy(rpy), T[:3, :3], atol=1e-14)
    assert "calibration>" not in text


def test_xacro_leaves_out_what_is_nowhere(source: Source) -> None:
    root = ET.fromstring(to_xacro(source))  # noqa: S314 - our own text
    links = [link.get("name", "").removeprefix("${prefix}") for link in root.iter("link")]
    assert sorted(links) == sorted(placed_by_name())
    whole = next(m for m in root if m.get("name") == "skin")
    assert len(whole) == len({su.joint.parent for su in source.placed_sus()})


def test_names_with_dollars_and_odd_letters_are_no_xacro(source: Source) -> None:
    first, *rest = source.placed_sus()
    odd = replace(first, joint=replace(first.joint, parent="a link-${evil}"))
    root = ET.fromstring(to_xacro(replace(source, sus=(odd, *rest))))  # noqa: S314
    macro = root.find("{http://www.ros.org/wiki/xacro}macro")
    assert macro is not None
    assert macro.get("name", "").replace("_", "").isalnum()
    assert "$${evil}" in macro.get("params", "")


class Recorded:
    """Stands for an action or a substitution of a launch file."""

    def __init__(self, *words: Any, **named: Any) -> None:
        self.words, self.named = words, named


def launched(text: str, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Arguments of the static transform publishers that a launch file starts."""
    for module, name in (
        ("launch", "LaunchDescription"),
        ("launch.actions", "DeclareLaunchArgument"),
        ("launch.substitutions", "LaunchConfiguration"),
        ("launch_ros", ""),
        ("launch_ros.actions", "Node"),
    ):
        stub = ModuleType(module)
        if name:
            setattr(stub, name, Recorded)
        monkeypatch.setitem(sys.modules, module, stub)
    space: dict[str, Any] = {}
    exec(compile(ast.parse(text), "skin.launch.py", "exec"), space)  # noqa: S102 - our own text
    found = []
    for action in space["generate_launch_description"]().words[0]:
        if action.named.get("executable") != "static_transform_publisher":
            continue
        words = action.named["arguments"]
        found.append(dict(zip(words[::2], words[1::2], strict=True)))
    return found


def test_the_launch_file_gives_every_frame_one_parent(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = launched(to_launch(source), monkeypatch)
    children = [each["--child-frame-id"][-1] for each in found]
    assert sorted(children) == sorted(placed_by_name())
    parents = {su.name: su.joint.parent for su in source.sus}
    for each in found:
        child = each["--child-frame-id"][-1]
        assert each["--frame-id"][-1] == parents[child]
        T = placed_by_name()[child]
        xyz = [float(each[f"--{key}"]) for key in "xyz"]
        x, y, z, w = (float(each[f"--q{key}"]) for key in "xyzw")
        np.testing.assert_array_equal(xyz, T[:3, 3])
        np.testing.assert_allclose(pin.Quaternion(w, x, y, z).matrix(), T[:3, :3], atol=1e-12)


def check_placements(entries: list[dict[str, float]]) -> None:
    model = calibration().model
    assert len(entries) == model.tree.n_joints
    for entry, T in zip(entries, model.T_parent_joint, strict=True):
        assert list(entry) == NUMBERS
        values = np.array([entry[key] for key in NUMBERS])
        np.testing.assert_array_equal(values[:3], T[:3, 3])
        np.testing.assert_allclose(rotation_of_rpy(values[3:]), T[:3, :3], atol=1e-14)


def test_kinematics_have_the_keys_of_universal_robots(source: Source) -> None:
    table = yaml.safe_load(to_kinematics(source))
    assert list(table) == ["kinematics"]
    hash_ = table["kinematics"].pop("hash")
    assert isinstance(hash_, str)
    assert list(table["kinematics"]) == [
        "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3",
    ]  # fmt: skip
    check_placements(list(table["kinematics"].values()))


def test_kinematics_have_the_keys_of_franka(source: Source) -> None:
    table = yaml.safe_load(to_kinematics(source, "franka"))
    assert list(table) == [f"joint{n}" for n in range(1, 7)]
    assert all(list(entry) == ["kinematic"] for entry in table.values())
    check_placements([entry["kinematic"] for entry in table.values()])


def test_kinematics_have_the_keys_of_flexiv(source: Source) -> None:
    table = yaml.safe_load(to_kinematics(source, "flexiv"))
    assert list(table) == ["kinematics"]
    assert list(table["kinematics"]) == [f"joint{n}" for n in range(1, 7)]
    assert all(list(entry) == NUMBERS for entry in table["kinematics"].values())


def axes_in(robot: pin.Model, q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Places (3,) and directions (3,) of the axes of a robot's joints."""
    data = robot.createData()
    turning = pin.computeJointJacobians(robot, data, q)[3:].T
    return [(data.oMi[n + 1].translation, way) for n, way in enumerate(turning)]


@pytest.mark.parametrize(
    ("style", "axes"),
    [
        # As the descriptions have them: ur_macro.xacro, franka_arm.xacro, rizon_arm.xacro.
        ("ur", ["z"] * 6),
        ("franka", ["z"] * 6),
        ("flexiv", ["z", "y", "z", "y", "z", "y"]),
    ],
)
@pytest.mark.parametrize("own", [True, False])
def test_the_descriptions_axes_are_where_the_urdf_has_them(
    style: Style, axes: list[str], own: bool, source: Source
) -> None:
    # The UR5 of example-robot-data turns some of its joints about y.
    path = source.path if own else load_robot("ur5").urdf
    table = yaml.safe_load(to_kinematics(load_source(path), style))
    given_by = table.get("kinematics", table)
    entries = [e.get("kinematic", e) for name, e in given_by.items() if name != "hash"]
    described = pin.Model()
    for n, (entry, axis) in enumerate(zip(entries, axes, strict=True)):
        values = np.array([entry[key] for key in NUMBERS])
        kind = {"y": pin.JointModelRY, "z": pin.JointModelRZ}[axis]()
        where = pin.SE3(rotation_of_rpy(values[3:]), values[:3])
        described.addJoint(n, kind, where, f"joint{n}")
    given = pin.buildModelFromUrdf(str(path))
    q = np.array([0.3, -0.8, 1.1, 0.4, -1.3, 0.7])
    for (p, a), (place, way) in zip(axes_in(described, q), axes_in(given, q), strict=True):
        np.testing.assert_allclose(p, place, atol=1e-9)
        np.testing.assert_allclose(a, way, atol=1e-9)


def test_kinematics_are_for_one_arm(source: Source) -> None:
    shorter = replace(source, joints=source.joints[1:])
    with pytest.raises(UsageError, match="6 joints"):
        to_kinematics(shorter, "ur")
    beside = tuple(
        replace(j, parent=source.root) if j.name == "wrist_3_joint" else j for j in source.joints
    )
    with pytest.raises(UsageError, match="wrist_3_joint"):
        to_kinematics(replace(source, joints=beside))


def test_the_imu_file_has_kalibrs_keys_and_what_was_found(source: Source) -> None:
    table = yaml.safe_load(to_imu(source))
    tree, state = calibration().model.tree, calibration().estimate.state
    assert list(table) == [f"imu{n}" for n in range(tree.n_sus)]
    for entry in table.values():
        assert {
            "T_i_b", "accelerometer_noise_density", "accelerometer_random_walk", "rostopic",
            "update_rate", "time_offset", "model", "accelerometers",
        } <= set(entry)  # fmt: skip
        u = tree.su_names.index(entry["frame_id"])
        np.testing.assert_allclose(
            entry["accelerometers"]["M"], state.sensor_matrix()[u], rtol=1e-12
        )
        np.testing.assert_allclose(entry["accelerometers"]["bias"], state.bias[u])
        assert entry["update_rate"] == pytest.approx(250, rel=1e-3)
        assert entry["rostopic"].startswith("/")
        # 1 mg at 250 Hz is what the simulated sensors have.
        assert entry["accelerometer_noise_density"] == pytest.approx(9.81e-3 / 250**0.5, rel=0.3)
        if tree.su_joint[u] < 0:
            assert entry["T_i_b"] is None
        else:
            expected = inverse(calibration().model.T_joint_su[u])
            np.testing.assert_allclose(entry["T_i_b"], expected, atol=1e-12)


def test_gyroscopes_that_counted_are_in_the_imu_file(source: Source) -> None:
    first, second, *rest = source.sus
    found = {
        "used": True, "scale": [0.1, 0.2, 0.3], "misalignment": [1, 2, 3, 4, 5, 6],
        "bias": [[0.0, 0.2, 0.4], [0.2, 0.4, 0.6]],
    }  # fmt: skip
    heard = replace(first, facts={**(first.facts or {}), "gyro": found, "gyro_noise_density": 1e-4})
    left_out = replace(second, facts={**(second.facts or {}), "gyro": {"used": False}})
    table = yaml.safe_load(to_imu(replace(source, sus=(heard, left_out, *rest))))
    assert table["imu0"]["gyroscopes"]["M"] == [[1.1, 1, 2], [3, 1.2, 4], [5, 6, 1.3]]
    np.testing.assert_allclose(table["imu0"]["gyroscopes"]["bias"], [0.1, 0.3, 0.5])
    assert table["imu0"]["gyroscope_noise_density"] == 1e-4
    assert "gyroscopes" not in table["imu1"]


def test_mjcf_has_the_same_kinematics_and_feels_gravity(source: Source) -> None:
    read = mujoco.MjModel.from_xml_string(to_mjcf(source))
    data = mujoco.MjData(read)
    model = calibration().model
    assert read.nsensor == len(placed_by_name())
    for q in np.random.default_rng(0).uniform(-3, 3, (3, model.tree.n_joints)):
        for name, value in zip(model.tree.joint_names, q, strict=True):
            data.qpos[read.joint(name).qposadr[0]] = value
        mujoco.mj_forward(read, data)
        for name, T in zip(model.tree.su_names, su_poses(model, q), strict=True):
            if name not in placed_by_name():
                continue
            site = data.site(name)
            np.testing.assert_allclose(site.xpos, T[:3, 3], atol=1e-9)
            np.testing.assert_allclose(site.xmat.reshape(3, 3), T[:3, :3], atol=1e-9)
            assert read.sensor(name).type == mujoco.mjtSensor.mjSENS_ACCELEROMETER
            assert read.sensor(name).noise > 0
    # Held still, each reads gravity, upwards.
    data.qfrc_applied[:] = data.qfrc_bias
    mujoco.mj_forward(read, data)
    for name in placed_by_name():
        up = data.site(name).xmat.reshape(3, 3).T @ [0.0, 0.0, 9.81]
        np.testing.assert_allclose(data.sensor(name).data, up, atol=1e-6)


def test_mjcf_has_gravity_as_the_robot_is_mounted(source: Source) -> None:
    assert source.document is not None
    hung = replace(source, document={**source.document, "gravity_up": [[0.0, 0.6, -0.8]]})
    read = mujoco.MjModel.from_xml_string(to_mjcf(hung))
    np.testing.assert_allclose(read.opt.gravity, [0.0, -5.886, 7.848], rtol=1e-3)


VENDOR = """\
<robot name="v">
  <link name="base"/><link name="a"/><link name="flange"><inertial><mass value="0.1"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="b"><inertial><origin xyz="0.1 0 0" rpy="0.3 0 0"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.2" izz="0.25" ixy="0.01" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://x/y.stl"/></geometry></visual>
    <collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="c"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="a"/>
    <origin xyz="0 0 0.3" rpy="0.2 0.1 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" effort="1" velocity="1"/><dynamics damping="0.5"/></joint>
  <joint name="f" type="fixed"><parent link="a"/><child link="flange"/></joint>
  <joint name="j2" type="prismatic"><parent link="flange"/><child link="b"/>
    <origin xyz="0.2 0 0"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>
  <joint name="j3" type="continuous"><parent link="a"/><child link="c"/>
    <mimic joint="j1" multiplier="2" offset="0.1"/></joint>
</robot>
"""


def test_mjcf_of_a_vendors_file_moves_as_pinocchio_moves_it(tmp_path: Path) -> None:
    path = tmp_path / "v.urdf"
    path.write_text(VENDOR)
    read = mujoco.MjModel.from_xml_string(to_mjcf(load_source(path)))
    data = mujoco.MjData(read)
    model = pin.buildModelFromXML(
        VENDOR.replace('<mimic joint="j1" multiplier="2" offset="0.1"/>', "")
    )
    pin_data = model.createData()
    q = pin.neutral(model)
    for name, value in (("j1", 0.7), ("j2", 0.2)):
        q[model.joints[model.getJointId(name)].idx_q] = value
        data.qpos[read.joint(name).qposadr[0]] = value
    pin.framesForwardKinematics(model, pin_data, q)
    mujoco.mj_kinematics(read, data)
    for link in ("a", "b", "flange"):
        placed = pin_data.oMf[model.getFrameId(link)]
        np.testing.assert_allclose(data.body(link).xpos, placed.translation, atol=1e-12)
        np.testing.assert_allclose(data.body(link).xmat.reshape(3, 3), placed.rotation, atol=1e-12)
    np.testing.assert_allclose(read.joint("j1").range, [-1, 2])
    assert read.neq == 1
    assert read.body("b").mass == 2
    expected = model.inertias[model.getJointId("j2")].inertia
    np.testing.assert_allclose(
        np.sort(read.body("b").inertia), np.linalg.eigvalsh(expected), rtol=1e-9
    )
    assert read.ngeom == 1


def test_a_base_called_world_is_mujocos(tmp_path: Path) -> None:
    path = tmp_path / "v.urdf"
    path.write_text(VENDOR.replace('"base"', '"world"'))
    read = mujoco.MjModel.from_xml_string(to_mjcf(load_source(path)))
    assert read.body("a").parentid[0] == 0
    path.write_text(VENDOR.replace('"flange"', '"world"'))
    assert mujoco.MjModel.from_xml_string(to_mjcf(load_source(path))).nbody == 6


def test_joints_that_mjcf_can_not_hold_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "v.urdf"
    path.write_text(VENDOR.replace('"prismatic"', '"planar"'))
    with pytest.raises(UsageError, match="j2"):
        to_mjcf(load_source(path))


@pytest.mark.parametrize("export", [to_xacro, to_launch, to_imu, to_kinematics, to_mjcf])
def test_nothing_is_ever_called_a_calibration_tag(
    source: Source, export: Callable[[Source], str]
) -> None:
    assert "<calibration" not in export(source)


def test_a_urdf_alone_gives_what_it_can(
    urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = tmp_path / "alone.urdf"
    alone.write_bytes(urdf.read_bytes())
    for to in ("xacro", "launch", "kinematics", "mjcf"):
        out = tmp_path / f"out.{to}"
        assert main(["export", str(alone), "--to", to, "-o", str(out), "--quiet"]) == 0
        assert out.stat().st_size
    out = tmp_path / "imu.yaml"
    assert main(["export", str(alone), "--to", "imu", "-o", str(out)]) == 2
    assert "JSON" in capsys.readouterr().err
    assert not out.exists()


def test_the_command_writes_names_and_refuses(
    urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "skin.xacro"
    assert main(["export", str(urdf), "--to", "xacro", "-o", str(out)]) == 0
    said = capsys.readouterr()
    assert "skin.xacro" in said.out
    assert said.err
    assert main(["export", str(urdf), "--to", "xacro"]) == 0
    assert capsys.readouterr().out == out.read_text()
    for words in (
        ["--to", "xacro", "-o", str(urdf)],
        ["--to", "xacro", "-o", str(urdf.with_suffix(".json"))],
        ["--to", "xacro", "--style", "ur"],
        ["--to", "mjcf", "-o", str(tmp_path / "none" / "a.xml")],
    ):
        assert main(["export", str(urdf), *words]) == 2
        assert "->" in capsys.readouterr().err
