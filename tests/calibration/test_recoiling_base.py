"""A base that recoils under its robot: an SU on it tells, and lengths are as they are.

MuJoCo moves an arm on a slab that slides on springs. What the arm pushes the slab by goes with the
arm's own motion, as longer or shorter links would: without the SU on the base nothing tells. A
table rocks besides.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from joint_paths import JointPath
from mujoco_robot import Arm, random_arm, record, truth_urdf, upright
from simulated import held_against

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.trajectory import estimate
from skin2urdf.estimation.trajectory.attempt import Explained
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.recording.records import Recording
from skin2urdf.report.document import as_document
from skin2urdf.report.verdict import doubts


def _recorded(
    mass: float,
    others: float = 1.0,
    hertz: float = 1.5,
    rocks: tuple[float, float] | None = None,
    poses: int = 16,
    *,
    vertical: bool = False,
) -> tuple[Arm, Recording]:
    """An arm on a slab, and what it records.

    Args:
        mass: of the slab [kg].
        others: by how much joints move beyond the first, over what that does.
        hertz: frequency at which the slab slides.
        rocks: stiffness and depth of what it rocks on.
        poses: that the arm moves to.
        vertical: whether the first axis is.
    """
    arm = replace(upright(random_arm(2, 4)), slab=(mass, hertz), rocks=rocks)
    if vertical:
        first, *further = arm.joints
        first = replace(first, rpy=(0.0, 0.0, 0.4), axis=(0.0, 0.0, 1.0))
        arm = replace(arm, joints=(first, *further))
    rng = np.random.default_rng(3)
    path = JointPath([0.0] * arm.n_joints).rest(1.0)
    share = np.where(np.arange(arm.n_joints) == 0, 1.0, others)
    for pose in rng.uniform(-1.2, 1.2, (poses, arm.n_joints)):
        path.move(share * pose, 1.3).rest(0.7)
    sus, joints = _names(arm)
    return arm, record(arm, path, sus, joints, rng)


def _names(arm: Arm) -> tuple[list[str], list[str]]:
    """Names of the SUs, the first of which is on the base, and of the joints."""
    return (
        [f"skin_{n}" for n in range(arm.n_joints + 1)],
        [f"motor_{n}" for n in range(arm.n_joints)],
    )


def test_a_base_that_recoils_by_more_than_is_followed_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What no joint can carry moves with one: the base does, and it is no parallelogram."""
    monkeypatch.setattr(
        estimate, "standing_still", lambda problem, fitted, **_: (problem, fitted, None)
    )
    monkeypatch.setattr(
        estimate, "explained", lambda problem, fitted, *_, **__: Explained(problem, fitted)
    )
    arm, recording = _recorded(4.0, others=0.25)
    found = calibrate(recording)
    assert _names(arm)[0][0] in dict(found.recoiling)
    assert not {su for su, _ in found.recoiling} & {su for su, _ in found.carried_along}
    assert found.quality == "bad"
    assert "base recoils" in [doubt.kind for doubt in doubts(found)]


@pytest.mark.parametrize("late", [0.0, 0.1])
def test_what_a_base_recoils_by_makes_no_lengths(late: float, tmp_path: Path) -> None:
    """The clock of its SU, which nothing else tells, may be any."""
    arm, recording = _recorded(150.0)
    sus, joints = _names(arm)
    on_base, *others = recording.sus
    assert on_base.name == sus[0]
    on_base = replace(on_base, time=on_base.time + late)
    found = calibrate(replace(recording, sus=(on_base, *others)))
    compared = held_against(found, truth_urdf(arm, sus, joints), tmp_path)
    assert compared.tree_equal
    assert found.along is not None
    base = found.along.moving_base
    assert base is not None
    assert base.names == (sus[0],)
    assert as_document(found)["samples"]["base_felt"][sus[0]] > 0.01
    assert "moving base" not in [doubt.kind for doubt in doubts(found)]
    assert compared.position.rms < 2.0 * _stated(found)
    assert compared.position.rms < 0.3e-3


@pytest.mark.parametrize(
    ("mass", "hertz", "stiffness", "poses"), [(30.0, 14.0, 7500.0, 40), (60.0, 2.6, 15000.0, 16)]
)
def test_an_su_on_a_table_that_rocks_is_on_no_joint(
    mass: float, hertz: float, stiffness: float, poses: int, tmp_path: Path
) -> None:
    """The table turns by 9 mrad as the first joint moves: to a rigid robot its SU sits on that.

    To one with elastic gears as well, by a sensor that is none.
    """
    arm, recording = _recorded(mass, hertz=hertz, rocks=(stiffness, 0.7), poses=poses)
    sus, joints = _names(arm)
    found = calibrate(recording)
    compared = held_against(found, truth_urdf(arm, sus, joints), tmp_path)
    assert compared.tree_equal
    assert found.quality == "good"
    assert compared.position.rms < 2.0 * _stated(found)
    assert compared.position.rms < 0.3e-3


def test_an_su_on_the_axis_of_a_vertical_joint_sits_on_a_table_that_rocks(tmp_path: Path) -> None:
    """Slow moves fit it as a base that yields and joints read late, with no place for its case."""
    arm, recording = _recorded(40.0, hertz=14.0, rocks=(20000.0, 0.7), poses=24, vertical=True)
    sus, joints = _names(arm)
    found = calibrate(recording)
    compared = held_against(found, truth_urdf(arm, sus, joints), tmp_path)
    assert compared.tree_equal
    assert found.along is not None
    assert found.along.causes == ()
    assert found.quality == "good"
    assert compared.position.rms < 2.0 * _stated(found)


def _stated(found: Calibration) -> float:
    """Error of SUs that is stated, rms over configurations [m]."""
    share = np.random.default_rng(0).uniform(size=(60, found.model.tree.n_joints))
    q = found.limits[:, 0] + share * (found.limits[:, 1] - found.limits[:, 0])
    stated, _ = aligned_deviations(found.estimate, found.observability, q)
    return float(np.sqrt(np.nanmean(stated**2)))
