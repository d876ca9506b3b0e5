"""An emitted URDF is read back before it is trusted."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from skin2urdf.model.poses import su_poses
from skin2urdf.model.records import KinematicModel
from skin2urdf.urdf.check import InconsistentUrdfError, check_urdf
from skin2urdf.urdf.emit import emit

Make = Callable[..., KinematicModel]


def text_of(model: KinematicModel) -> str:
    limits = np.tile([-1.0, 1.0], (model.tree.n_joints, 1))
    return emit(model, name="robot", limits=limits)


def test_what_is_emitted_passes(random_robot: Make) -> None:
    for seed in range(5):
        model = random_robot(np.random.default_rng(seed))
        check_urdf(text_of(model), model)


def test_a_robot_without_joints_passes(random_robot: Make) -> None:
    model = random_robot(np.random.default_rng(0), (), (-1,), ())
    check_urdf(text_of(model), model)


def test_its_kinematics_are_those_of_the_records(
    random_robot: Make, su_poses: Callable[[KinematicModel, np.ndarray], np.ndarray]
) -> None:
    from skin2urdf.model.poses import su_poses as checked

    rng = np.random.default_rng(1)
    model = random_robot(rng)
    q = rng.uniform(-2, 2, model.tree.n_joints)
    np.testing.assert_allclose(checked(model, q), su_poses(model, q), atol=1e-12)


@pytest.mark.parametrize("what", ["xyz", "rpy"])
def test_a_changed_placement_is_found(random_robot: Make, what: str) -> None:
    model = random_robot(np.random.default_rng(2))
    text = text_of(model)
    joint = text.index('<joint name="joint_3"')
    number = re.compile(rf'({what}=")(\S+)').search(text, joint)
    assert number is not None
    changed = f"{number[1]}{float(number[2]) + 1e-7!r}"
    with pytest.raises(InconsistentUrdfError, match=r"\d"):
        check_urdf(text[: number.start()] + changed + text[number.end() :], model)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("</robot>", ""),
        ('<parent link="base_link" />', '<parent link="nowhere" />'),
        ('type="prismatic"', 'type="revolute"'),
        ('axis xyz="0 0 1"', 'axis xyz="0 1 0"'),
        ('name="joint_4" type="revolute"', 'name="joint_4" type="fixed"'),
    ],
)
def test_a_broken_file_is_found(random_robot: Make, old: str, new: str) -> None:
    model = random_robot(np.random.default_rng(3))
    text = text_of(model)
    assert old in text
    with pytest.raises(InconsistentUrdfError) as raised:
        check_urdf(text.replace(old, new), model)
    assert raised.value.exit_status == 1
    assert "report" in raised.value.remedy


def test_it_is_quiet_about_good_files(
    random_robot: Make, capfd: pytest.CaptureFixture[str]
) -> None:
    model = random_robot(np.random.default_rng(4))
    check_urdf(text_of(model), model)
    assert capfd.readouterr() == ("", "")
    assert su_poses(model, np.zeros(model.tree.n_joints)).shape == (model.tree.n_sus, 4, 4)
