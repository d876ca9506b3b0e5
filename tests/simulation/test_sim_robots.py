from __future__ import annotations

import tomllib
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np
import pytest

from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.simulation import SimulationSettings, load_robot, robot_names
from skin2urdf.simulation.mechanism import load_mechanism
from skin2urdf.simulation.skins import place_skin

ARMS = ("panda", "ur3", "ur5", "ur10", "kinova", "xarm7", "z1", "so101")
DOFS = dict(zip(ARMS, (7, 6, 6, 6, 6, 7, 6, 5), strict=True))
UPRIGHT = (0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ARMS)
def test_every_arm_has_its_file(name: str) -> None:
    robot = load_robot(name)
    mechanism = load_mechanism(robot, robot.base_rpy)
    assert name in robot_names()
    assert robot.description
    assert mechanism.n_joints == DOFS[name]
    assert list(mechanism.parent) == list(range(-1, DOFS[name] - 1))
    assert not mechanism.prismatic.any()


def test_base_tilt_turns_gravity() -> None:
    robot = load_robot("panda")
    assert robot.base_rpy == pytest.approx((radians(25), radians(15), 0))
    g = load_mechanism(robot, (radians(90), 0.0, 0.0)).gravity_base
    # Rolled by 90 degrees, the base's y axis points up.
    np.testing.assert_allclose(g, [0, -GRAVITY, 0], atol=1e-12)


def test_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(UsageError, match="pandda") as caught:
        load_robot("pandda")
    assert "panda" in caught.value.remedy


def test_missing_urdf() -> None:
    with pytest.raises(UsageError) as caught:
        load_robot("nowhere/robot.urdf")
    assert caught.value.argument.endswith("robot.urdf")


@pytest.mark.parametrize("text", ["", "not xml", "<robot/>", "<other><joint/></other>"])
def test_file_that_is_no_urdf(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bad.urdf"
    path.write_text(text)
    with pytest.raises(UnreadableInputError, match=r"bad\.urdf"):
        load_mechanism(load_robot(path), UPRIGHT)


def test_xml_that_pinocchio_refuses(tmp_path: Path) -> None:
    path = tmp_path / "dangling.urdf"
    path.write_text('<robot name="x"><joint name="j" type="fixed"/></robot>')
    with pytest.raises(UnreadableInputError, match="Pinocchio"):
        load_mechanism(load_robot(path), UPRIGHT)


def test_bare_urdf_moves_all_but_mimic_joints(gantry: Path) -> None:
    mechanism = load_mechanism(load_robot(gantry), UPRIGHT)
    assert mechanism.joint_names == ("slide", "swing", "grip_left")
    assert mechanism.link_names == ("carriage", "arm", "left")
    assert mechanism.root_link == "rail"
    assert list(mechanism.prismatic) == [True, False, True]
    assert list(mechanism.parent) == [-1, 0, 1]
    assert mechanism.lower[1] == -np.inf
    assert mechanism.upper[0] == pytest.approx(0.6)
    assert mechanism.locked == {"grip_right": 0.0}


def test_configuration_wraps_continuous_joints(gantry: Path) -> None:
    mechanism = load_mechanism(load_robot(gantry), UPRIGHT)
    q = mechanism.configuration(np.array([[0.1, 7.0, 0.02]]))
    np.testing.assert_allclose(q, [[0.1, np.cos(7.0), np.sin(7.0), 0.02]])


def test_locked_joint_is_clipped_into_its_limits(gantry: Path) -> None:
    robot = replace(load_robot(gantry), locked={"grip_left": None})
    assert load_mechanism(robot, UPRIGHT).locked["grip_left"] == pytest.approx(0.01)


@pytest.mark.usefixtures("gantry")
def test_toml_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("""
        urdf = "gantry.urdf"
        base_rpy_deg = [90, 0, 0]
        moving = ["s*"]
        [locked]
        grip_left = 0.03
        [skin]
        sus_per_segment = 2
        sus_on_base = 0
        distance = [0.01, 0.02]
        [[skin.su]]
        link = "left"
        xyz = [0.1, 0.2, 0.3]
        rpy_deg = [0, 0, 90]
        [motion]
        frequency = 3
        step = [0.2, 0.4]
        """)
    robot = load_robot(file)
    mechanism = load_mechanism(robot, robot.base_rpy)
    assert robot.base_rpy[0] == pytest.approx(np.pi / 2)
    assert mechanism.joint_names == ("slide", "swing")
    assert mechanism.locked == {"grip_left": 0.03, "grip_right": 0.0}
    assert robot.motion.frequency == 3.0
    assert robot.motion.step == (0.2, 0.4)

    sus = place_skin(mechanism, robot.skin, np.random.default_rng(0))
    given = next(su for su in sus if su.link == "left")
    assert sorted(su.joint for su in sus) == [0, 0, 1, 1, 1]
    assert given.joint == 1
    np.testing.assert_allclose(given.T_link_su[:3, 3], [0.1, 0.2, 0.3])
    # "left" hangs on a locked joint at y = 0.4 of the arm, turned by 0.2 and slid by 0.03.
    c, s = np.cos(0.2), np.sin(0.2)
    expected = [0.1, 0.4 + c * 0.2 - s * 0.33, s * 0.2 + c * 0.33]
    np.testing.assert_allclose(given.T_joint_su[:3, 3], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "cause", "names"),
    [
        ("urdf = 3 = 4", tomllib.TOMLDecodeError, ""),
        ("description = 'no urdf'", KeyError, "urdf"),
        ("urdf = 'gone.urdf'", ValueError, "gone.urdf"),
        ("urdf = 'gantry.urdf'\nseed = 3", ValueError, "seed"),
        ("urdf = 'gantry.urdf'\n[skin]\ncount = 3", ValueError, "count"),
        ("urdf = 'gantry.urdf'\n[motion]\nfreq = 3", ValueError, "freq"),
        ("urdf = 'gantry.urdf'\nbase_rpy_deg = [1, 2]", ValueError, ""),
        ("urdf = 'gantry.urdf'\nmoving = 'slide'", TypeError, "slide"),
    ],
)
def test_bad_toml_is_refused_in_words(
    gantry: Path, tmp_path: Path, text: str, cause: type[Exception], names: str
) -> None:
    assert gantry.parent == tmp_path
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(UnreadableInputError) as caught:
        load_robot(file)
    assert isinstance(caught.value.__cause__, cause)
    assert caught.value.path == str(file)
    assert names in str(caught.value)


def test_limits_that_were_never_given_are_none(gantry: Path) -> None:
    """Exporters write zeros where nobody set limits, effort and speed; a real limit of 0 stays."""
    text = gantry.read_text()
    old = '<limit lower="0.01" upper="0.05" effort="10" velocity="1"/>'
    turning = text.replace('name="grip_left" type="prismatic"', 'name="grip_left" type="revolute"')
    assert old in turning
    for effort, moves in (("0", True), ("10", False)):
        limit = f'<limit lower="0" upper="0" effort="{effort}" velocity="0"/>'
        gantry.write_text(turning.replace(old, limit))
        found = load_mechanism(load_robot(gantry), UPRIGHT)
        assert ("grip_left" in found.joint_names) == moves
        if moves:
            assert found.upper[found.joint_names.index("grip_left")] == np.inf


def test_what_can_not_be(gantry: Path) -> None:
    robot = load_robot(gantry)
    with pytest.raises(UsageError, match=r"finger\*"):
        load_mechanism(replace(robot, locked={"finger*": 0.0}), UPRIGHT)
    with pytest.raises(UsageError, match=r"2 \w+, 1 \w+, 1 \w+"):
        load_mechanism(replace(robot, moving=()), UPRIGHT)
    bare = replace(robot.skin, sus_per_segment=0, sus_on_base=0)
    with pytest.raises(UsageError):
        place_skin(load_mechanism(robot, UPRIGHT), bare, np.random.default_rng(0))


@pytest.mark.parametrize(
    "options",
    [
        {"n_poses": 0},
        {"seed": -1},
        {"imu_rate": 0.0},
        {"encoder_bits": -1},
        {"jitter": -1e-3},
        {"imu_rate": 1e9},
        {"lag": float("nan")},
        {"sus_per_segment": -1},
        {"excite": "some"},
        {"excite": "all", "minutes": 1.0},
        {"upright": True, "base_rpy": (0.1, 0.0, 0.0)},
    ],
)
def test_impossible_settings(options: dict[str, object]) -> None:
    with pytest.raises(UsageError):
        SimulationSettings(**options)  # type: ignore[arg-type]


def test_unknown_grades_are_listed() -> None:
    with pytest.raises(UsageError) as caught:
        _ = SimulationSettings(grade="gold").sensor_grade
    assert "bma150" in caught.value.remedy
    with pytest.raises(UsageError) as caught:
        _ = SimulationSettings(tracking="loose").plant
    assert "servo" in caught.value.remedy


def test_skin_is_near_its_segment_and_looks_everywhere() -> None:
    robot = load_robot("ur10")
    mechanism = load_mechanism(robot, UPRIGHT)
    layout = replace(robot.skin, sus_per_segment=60)
    sus = place_skin(mechanism, layout, np.random.default_rng(0))
    assert len({su.name for su in sus}) == len(sus) == 361
    # The upper arm's middle: half way to the elbow.
    elbow = mechanism.model.jointPlacements[3].translation
    upper_arm = [su.T_joint_su for su in sus if su.joint == 1]
    distance = [np.linalg.norm(T[:3, 3] - elbow / 2) for T in upper_arm]
    assert 0.04 <= min(distance) < 0.05
    assert 0.07 < max(distance) <= 0.08
    rotations = np.array([su.T_joint_su[:3, :3] for su in sus])
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    np.testing.assert_allclose(
        rotations @ rotations.mT, np.broadcast_to(np.eye(3), (361, 3, 3)), atol=1e-12
    )
    # Uniform rotations average to zero with a standard error of 1 / sqrt(3 N) per entry.
    assert np.abs(rotations.mean(axis=0)).max() < 4 / np.sqrt(3 * 361)


def test_locked_joints_as_a_list(gantry: Path, tmp_path: Path) -> None:
    file = tmp_path / "listed.toml"
    file.write_text(f'urdf = "{gantry.as_posix()}"\nlocked = ["grip_*"]')
    mechanism = load_mechanism(load_robot(file), UPRIGHT)
    assert mechanism.locked == {"grip_left": 0.01, "grip_right": 0.0}


def test_a_locked_joint_may_be_called_like_a_link(tmp_path: Path) -> None:
    inertial = (
        '<inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in ("upper", "wrist", "tip"))
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        '<origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for name, parent, child in (
            ("shoulder", "base", "upper"), ("wrist", "upper", "wrist"), ("last", "wrist", "tip"),
        )
    )  # fmt: skip
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r"><link name="base"/>{links}{joints}</robot>')
    robot = replace(load_robot(path), locked={"wrist": 0.3})
    mechanism = load_mechanism(robot, UPRIGHT)
    assert mechanism.joint_names == ("shoulder", "last")
    sus = place_skin(mechanism, replace(robot.skin, sus_per_segment=1), np.random.default_rng(0))
    # The link between them is rigid with the first joint's, and the second one stands on it.
    assert {su.joint for su in sus} == {-1, 0, 1}
    placement = mechanism.model.jointPlacements[2]
    np.testing.assert_allclose(
        placement.translation, [0.5 * np.sin(0.3), 0.0, 0.5 + 0.5 * np.cos(0.3)], atol=1e-12
    )
