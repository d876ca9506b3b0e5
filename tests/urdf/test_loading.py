"""URDFs that are none are named with a reason; those of real robots load."""

from __future__ import annotations

import re
import time
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest

from skin2urdf.errors import UnreadableInputError
from skin2urdf.urdf.compare import compare
from skin2urdf.urdf.loading import check_tree, configuration, load_robot, neutral, parsed_urdf

ROBOTS = Path(
    str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data"))
)

BAD = {
    "": "no XML",
    "#VRML V2.0": "no XML",
    "\x89MCAP0\r\n": "a log",
    "SQLite format 3\0": "a log",
    "<sdf/>": "another format",
    "<robot name='r'/>": "no links",
    "<robot><link name='a'/><link name='a'/></robot>": "same name",
    "<robot><link/></robot>": "same name",
    "<robot><link name='a'/><link name='b'/></robot>": "several trees",
    "<robot><link name='a'/><joint name='j'><parent link='a'/><child link='b'/></joint></robot>": (
        "missing link"
    ),
    "<robot><link name='a'/><joint name='j'/></robot>": "missing link",
    "<robot name='r'><link name='a'/><link name='b'/><link name='c'/>"
    "<joint name='j' type='fixed'><parent link='b'/><child link='c'/></joint>"
    "<joint name='k' type='fixed'><parent link='c'/><child link='b'/></joint></robot>": "circle",
    "<robot name='r'><link name='a'/><link name='b'/>"
    "<joint name='j' type='wobbly'><parent link='a'/><child link='b'/></joint></robot>": "refused",
}


@pytest.mark.parametrize(("text", "why"), BAD.items())
def test_what_is_no_urdf_is_named(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_bytes(text.encode("latin1"))
    with pytest.raises(UnreadableInputError) as caught:
        load_robot(path)
    assert caught.value.why == why
    assert caught.value.exit_status == 2
    assert caught.value.path == str(path)
    assert caught.value.remedy


def test_more_links_than_robots_have_are_refused_within_seconds(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    count = 100_000
    links = "".join(f"<link name='l{k}'/>" for k in range(count))
    joints = "".join(
        f"<joint name='j{k}' type='fixed'><parent link='l{k - 1}'/><child link='l{k}'/></joint>"
        for k in range(1, count)
    )
    path.write_text(f"<robot name='r'>{links}{joints}</robot>")
    begin = time.process_time()
    with pytest.raises(UnreadableInputError) as caught:
        load_robot(path)
    assert caught.value.why == "too large"
    assert time.process_time() - begin < 5.0


def test_a_long_chain_is_looked_through_in_proportion() -> None:
    def seconds(count: int) -> float:
        links = "".join(f"<link name='l{k}'/>" for k in range(count))
        joints = "".join(
            f"<joint name='j{k}' type='fixed'><parent link='l{k - 1}'/><child link='l{k}'/></joint>"
            for k in range(1, count)
        )
        root = parsed_urdf(f"<robot>{links}{joints}</robot>".encode(), "long")
        begin = time.process_time()
        check_tree(root, "long")
        return time.process_time() - begin

    # 20 times as long: 20 times the time in proportion, 400 times if each looks through all.
    assert min(seconds(5000) for _ in range(3)) < 150 * min(seconds(250) for _ in range(9))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    for path in (tmp_path / "missing.urdf", tmp_path):
        with pytest.raises(UnreadableInputError, match=re.escape(str(path))):
            load_robot(path)


@pytest.mark.parametrize(
    "urdf",
    [
        "panda_description/urdf/panda.urdf",
        "ur_description/urdf/ur5_robot.urdf",
        "kinova_description/robots/kinova.urdf",
        "tiago_description/robots/tiago.urdf",
    ],
)
def test_real_robots_equal_themselves(urdf: str) -> None:
    """With continuous joints, mimic joints, meshes that are not found, several limbs."""
    path = ROBOTS / "robots" / urdf
    robot = load_robot(path)
    q = configuration(robot, {})
    model = robot.model
    assert q.shape == (model.nq,)
    assert (q >= model.lowerPositionLimit - 1e-12).all()
    assert (q <= model.upperPositionLimit + 1e-12).all()
    assert neutral(robot).keys() == robot.joint_types.keys()
    c = compare(path, path, n_configurations=5, rng=np.random.default_rng(0))
    assert c.tree_equal
    assert len(c.joints) + len(c.joints_left_out) == len(robot.joint_types)
    assert max(c.position.max, c.axis_distance.max) < 1e-9
    assert max(c.orientation.max, c.axis_angle.max) < 1e-7


def test_a_continuous_joint_equals_a_revolute_one(tmp_path: Path) -> None:
    """What is (cos, sin) in one configuration vector is an angle in the other."""
    paths = []
    for kind in ("continuous", "revolute"):
        paths.append(tmp_path / f"{kind}.urdf")
        paths[-1].write_text(
            "<robot name='r'><link name='base'/><link name='arm'/><link name='su'/>"
            f"<joint name='j' type='{kind}'><parent link='base'/><child link='arm'/>"
            "<axis xyz='0 0.6 0.8'/><limit lower='-2' upper='2' effort='1' velocity='1'/></joint>"
            "<joint name='m' type='fixed'><parent link='arm'/><child link='su'/>"
            "<origin xyz='1 0 0'/></joint></robot>"
        )
    c = compare(*paths, n_configurations=20, rng=np.random.default_rng(0))
    assert c.tree_equal
    assert c.position.max < 1e-12
    assert c.axis_distance.max < 1e-12
    np.testing.assert_allclose(c.alignments[0].T_truth_estimate, np.eye(4), atol=1e-12)
