"""Limits of joints: seen, wide, or from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skin2urdf.errors import Skin2UrdfError, UnreadableInputError, UsageError
from skin2urdf.urdf.limits import GivenLimit, read_limits, seen_limits, wide_limits, with_given

SEEN = np.array([[0.2, 1.0], [-4.0, 1.0], [0.1, 0.3]])
PRISMATIC = np.array([False, False, True])
NAMES = ("a", "b", "slide")

MOVEIT = """\
joint_limits:
  a:
    has_position_limits: true
    min_position: -2.5
    max_position: 2.25
    has_velocity_limits: true
    max_velocity: 1.5
  b: {max_velocity: 2}
"""
PAIRS = "a: [-2.5, 2.25]\n"
TOML = "[a]\nlower = -2.5\nupper = 2.25\nvelocity = 1.5\n"
URDF = """\
<robot name="r"><joint name="a" type="revolute">
<limit lower="-2.5" upper="2.25" velocity="1.5" effort="1"/></joint>
<joint name="wheel" type="continuous"><limit effort="1" velocity="3"/></joint>
<joint name="fixed" type="fixed"/></robot>
"""


def test_wide_limits_hold_zero_and_all_that_was_seen() -> None:
    wide = wide_limits(SEEN, np.array([0.1, 9.0, 0.1]), PRISMATIC, soft=True)
    assert (wide.position[:, 0] <= np.minimum(SEEN[:, 0], 0)).all()
    assert (wide.position[:, 1] >= np.maximum(SEEN[:, 1], 0)).all()
    np.testing.assert_allclose(wide.position[0], [-np.pi, np.pi])
    np.testing.assert_allclose(wide.position[1], [-4.0, np.pi])
    np.testing.assert_allclose(wide.position[2], [-0.2, 0.5])
    np.testing.assert_array_equal(wide.soft, SEEN)
    assert wide.velocity[1] == 9.0
    assert not wide.known.any()
    assert np.isnan(wide_limits(SEEN, np.ones(3), PRISMATIC).soft).all()


@pytest.mark.parametrize(
    ("name", "text", "speed"),
    [("l.yaml", MOVEIT, 1.5), ("l.yml", PAIRS, None), ("l.toml", TOML, 1.5), ("l.urdf", URDF, 1.5)],
)
def test_files_give_limits_by_name(
    tmp_path: Path, name: str, text: str, speed: float | None
) -> None:
    (tmp_path / name).write_text(text)
    given = read_limits(tmp_path / name)
    assert given["a"] == GivenLimit(-2.5, 2.25, speed)
    wide = wide_limits(SEEN, np.full(3, 0.1), PRISMATIC, soft=True)
    limits = with_given(wide, NAMES, given, name)
    np.testing.assert_array_equal(limits.position[0], [-2.5, 2.25])
    np.testing.assert_array_equal(limits.position[1:], wide.position[1:])
    assert limits.known.tolist() == [True, False, False]
    assert np.isnan(limits.soft[0]).all()
    assert limits.velocity[0] == (speed or wide.velocity[0])


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("l.yaml", "a: [1, 2"),
        ("l.yaml", "a: [one, two]"),
        ("l.yaml", "a: [.nan, 2]"),
        ("l.yaml", "- a"),
        ("l.toml", "a = "),
        ("l.urdf", "<robot"),
        ("l.urdf", "<robot/>"),
        ("l.yaml", "\udcff"),
    ],
)
def test_files_without_limits_are_refused(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(UnreadableInputError) as raised:
        read_limits(tmp_path / name)
    assert raised.value.remedy


def test_what_is_no_file_with_limits_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as raised:
        read_limits("narrow")
    assert raised.value.argument == "narrow"
    with pytest.raises(UnreadableInputError):
        read_limits(tmp_path / "none.yaml")


@pytest.mark.parametrize("given", [{"x": GivenLimit(0, 1)}, {"a": GivenLimit(1, 1)}])
def test_limits_of_other_joints_or_in_the_wrong_order_are_refused(
    given: dict[str, GivenLimit],
) -> None:
    with pytest.raises(Skin2UrdfError) as raised:
        with_given(seen_limits(SEEN, np.ones(3)), NAMES, given, "l.yaml")
    assert raised.value.remedy
