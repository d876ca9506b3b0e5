"""What gyroscopes add to the activity: who turns with a joint, wherever gravity points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_robots import Joint, robot_of

from skin2urdf.arrays import F64
from skin2urdf.recording.records import Recording, SuStream
from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.features import extract_features
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import sampled_together
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import GivenSu, SkinLayout
from skin2urdf.structure.activity import CERTAIN, activity
from skin2urdf.structure.tree import kinematic_tree

JOINTS = (
    Joint("pan", -1, "revolute"),
    Joint("lift", 0, "revolute", rpy=(np.pi / 2, 0.0, 0.0)),
    Joint("slide", 1, "prismatic", rpy=(0.4, 0.0, 0.0), limits=(-0.2, 0.2)),
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """An upright robot with SUs on the base, on the vertical axis itself, and further out."""
    given = (
        GivenSu("base", (0.1, 0.0, 0.0), (0.2, 0.0, 0.1)),
        GivenSu("link_pan", (0.0, 0.0, 0.1), (0.3, 0.2, 0.1)),
        GivenSu("link_lift", (0.1, 0.05, 0.02), (0.0, 0.4, 0.0)),
        GivenSu("link_slide", (0.05, 0.1, 0.0), (0.0, 0.4, 0.7)),
    )
    robot = robot_of(JOINTS, tmp_path_factory.mktemp("robot"), SkinLayout(0, 0, given=given))
    settings = SimulationSettings(
        n_poses=3, seed=2, upright=True, grade="bma150", gyro="cheap", imu_rate=250.0,
        joint_rate=125.0,
    )  # fmt: skip
    return retimed(simulate(robot, settings).recording)


def _features(log: Recording, changed: Callable[[F64], F64 | None] = lambda w: w) -> Features:
    """Features of the log with what gyroscopes read changed."""
    sus = tuple(
        replace(su, angular_velocity=changed(np.array(su.angular_velocity))) for su in log.sus
    )
    return extract_features(*sampled_together([replace(log, sus=sus)]))


def _carried(features: Features) -> list[list[str]]:
    """The joints before each SU of the tree, shortest chain first."""
    tree = kinematic_tree(activity(features), features)
    chains = [[tree.joint_names[j] for j in tree.chain(int(at))] for at in tree.su_joint]
    return sorted(chains, key=len)


def test_an_su_on_a_vertical_axis_is_no_su_on_the_base(log: Recording) -> None:
    expected = [[], ["pan"], ["pan", "lift"], ["pan", "lift", "slide"]]
    assert _carried(_features(log)) == expected
    assert _carried(_features(log, lambda _: None))[:2] == [[], []]


def test_lengths_are_one_or_nothing_whatever_the_axes(log: Recording) -> None:
    features = _features(log)
    assert features.turns is not None
    revolute = [features.dof_names.index(name) for name in ("pan", "lift")]
    length = features.turns.length[:, revolute]
    assert np.minimum(np.abs(length - 1), length).max() < 0.15
    odd = _features(log, lambda w: w[:, [1, 0, 2]] * [1.0, -1.0, 1.0])
    assert odd.turns is not None
    np.testing.assert_allclose(odd.turns.length[:, revolute], length, atol=0.02)


def test_a_joint_that_moves_sus_and_turns_none_slides(log: Recording) -> None:
    features = _features(log)
    seen = activity(features)
    assert seen.turned is not None
    slide = features.dof_names.index("slide")
    assert (seen.turned[:, slide] < -CERTAIN).all()
    assert seen.turns.sum() == 2
    assert seen.matrix[:, slide].sum() == 1
    tree = kinematic_tree(seen, features)
    assert dict(zip(tree.joint_names, tree.joint_types, strict=True))["slide"] == "prismatic"
    # What the accelerations leave of it does not matter then.
    odd = np.array(features.coefficients)
    odd[:, :, 1 + slide] += 3.0
    blurred = kinematic_tree(seen, replace(features, coefficients=odd))
    assert dict(zip(blurred.joint_names, blurred.joint_types, strict=True))["slide"] == "prismatic"


def test_sus_that_exchange_their_names_tell_nothing(log: Recording) -> None:
    fewest, most = min(log.sus, key=_motion), max(log.sus, key=_motion)
    time = most.time
    rates = np.array(most.angular_velocity)
    other = np.array(fewest.angular_velocity)
    later = np.flatnonzero(time > time.mean())
    later = later[later < len(other)]
    rates[later] = other[later]
    sus = tuple(replace(su, angular_velocity=rates) if su is most else su for su in log.sus)
    features = extract_features(*sampled_together([replace(log, sus=sus)]))
    seen = activity(features)
    assert seen.turned is not None
    turning = [features.dof_names.index(name) for name in ("pan", "lift")]
    u = features.su_names.index(most.name)
    assert np.isnan(seen.turned[u, turning]).any()
    others = np.delete(seen.turned[:, turning], u, axis=0)
    assert np.isfinite(others).all()


def _motion(su: SuStream) -> float:
    return float(np.std(np.array(su.angular_velocity)))


def test_what_is_certain_outweighs_gyroscopes(log: Recording) -> None:
    features = _features(log)
    seen = activity(features)
    pan = features.dof_names.index("pan")
    su = int(np.flatnonzero(~seen.matrix[:, pan])[0])
    told = seen.moved_by(features.su_names[su], "pan", moved=True)
    assert told.evidence[su, pan] > CERTAIN


def test_a_robot_that_gravity_says_nothing_of_shows_its_tree(tmp_path: Path) -> None:
    """All axes vertical, as of SCARA robots: the last one turns an SU and hardly moves it."""
    joints = (
        Joint("a", -1, "revolute"),
        Joint("b", 0, "revolute", xyz=(0.3, 0.0, 0.0)),
        Joint("c", 1, "prismatic", xyz=(0.25, 0.0, 0.0), limits=(-0.2, 0.2)),
        Joint("d", 2, "revolute"),
    )
    settings = SimulationSettings(
        n_poses=3, seed=4, upright=True, excite="all", gyro="mems", imu_rate=250.0,
        joint_rate=125.0,
    )  # fmt: skip
    robot = robot_of(joints, tmp_path, SkinLayout(1, 1))
    simulation = simulate(robot, settings)
    features = _features(retimed(simulation.recording))
    tree = kinematic_tree(activity(features), features)
    assert tree.joint_names == ("a", "b", "c", "d")
    assert tree.parent.tolist() == [-1, 0, 1, 2]
    assert tree.joint_types == ("revolute", "revolute", "prismatic", "revolute")
    true = {su.name: su.joint for su in simulation.truth.sus}
    assert [true[name] for name in tree.su_names] == tree.su_joint.tolist()
