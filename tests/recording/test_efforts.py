"""Efforts of sensor_msgs/JointState: real ones are read, what drivers fill in is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.recording.writing import write
from skin2urdf.signals.motion import joint_motion

_TIME = np.arange(300) / 100.0
_EFFORT = np.random.default_rng(7).standard_normal((300, 3))


def _recording(small: Recording, effort: F64 | None) -> Recording:
    """Three joints that share their messages, with efforts (300, 3) or none."""
    joints = tuple(
        JointStream(
            name,
            _TIME,
            np.sin(_TIME + d),
            effort=None if effort is None else effort[:, d],
        )
        for d, name in enumerate(("elbow", "lift", "wrist"))
    )
    return replace(small, joints=joints)


def test_efforts_come_back_as_they_were_written(small: Recording, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    # Names in another order than the joints are kept in.
    write(_recording(small, _EFFORT), path, joint_order=["wrist", "elbow", "lift"])
    for d, joint in enumerate(read(path).joints):
        assert joint.effort is not None
        np.testing.assert_array_equal(joint.effort, _EFFORT[:, d])


@pytest.mark.parametrize("what", ["none", "zero", "constant", "nan", "absurd"])
def test_what_drivers_fill_in_is_no_effort(what: str, small: Recording, tmp_path: Path) -> None:
    filled = {
        "none": None,
        "zero": 0.0 * _EFFORT,
        "constant": np.full_like(_EFFORT, 3.5),
        "nan": np.full_like(_EFFORT, np.nan),
        "absurd": np.where(_EFFORT > 0, 1e300, np.inf),
    }[what]
    path = tmp_path / "log.mcap"
    write(_recording(small, filled), path)
    assert all(joint.effort is None for joint in read(path).joints)


def test_one_joint_may_have_no_effort(small: Recording, tmp_path: Path) -> None:
    effort = _EFFORT.copy()
    effort[:, 1] = 0.0
    path = tmp_path / "log.mcap"
    write(_recording(small, effort), path)
    recording = read(path)
    assert [joint.effort is None for joint in recording.joints] == [False, True, False]
    on_grid = joint_motion(recording).effort
    assert np.isfinite(on_grid).all(axis=0).tolist() == [True, False, True]


@pytest.mark.parametrize(
    ("velocities", "efforts", "there"), [(3, 3, True), (0, 3, True), (3, 0, False), (3, 2, False)]
)
def test_efforts_lie_behind_velocities_of_any_number(
    make_log: Any, velocities: int, efforts: int, there: bool
) -> None:
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE).types
    log = make_log()
    names = ["wrist", "elbow", "lift"]
    for k, t in enumerate(_TIME):
        ns = 1_700_000_000_000_000_000 + round(t * 1e9)
        stamp = types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        header = types["std_msgs/msg/Header"](stamp, "")
        message = types["sensor_msgs/msg/JointState"](
            header,
            names,
            np.array([np.sin(t), np.cos(t), t]),
            np.ones(velocities),
            _EFFORT[k, :efforts],
        )
        log.add("/joint_states", message)
        vector = types["geometry_msgs/msg/Vector3"](0.1 * np.sin(t), 0.2, 9.8)
        reading = types["geometry_msgs/msg/Vector3Stamped"](
            types["std_msgs/msg/Header"](stamp, "hand"), vector
        )
        log.add("/hand", reading)
    found = {joint.name: joint.effort for joint in read(log.close()).joints}
    for column, name in enumerate(names):
        if there:
            np.testing.assert_array_equal(found[name], _EFFORT[:, column])
        else:
            assert found[name] is None


def test_single_missing_efforts_are_bridged_and_gaps_are_not(small: Recording) -> None:
    holes = _EFFORT.copy()
    holes[50, 0] = np.nan
    holes[100:250, 2] = np.nan
    on_grid = joint_motion(_recording(small, holes)).effort
    assert np.isfinite(on_grid).all(axis=0).tolist() == [True, True, False]
    assert joint_motion(_recording(small, None)).effort.size == 0


def test_tables_hold_efforts_in_columns_of_their_joints(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    head = "time [s],elbow [rad],elbow [Nm],lift [rad],hand.x [m/s^2],hand.y [m/s^2],hand.z [m/s^2]"
    rows = [
        f"{t + 1.7e9:.3f},{np.sin(t)},{float(_EFFORT[k, 0])!r},{t},0.1,{0.1 * np.cos(t)},9.8"
        for k, t in enumerate(_TIME)
    ]
    path.write_text("\n".join([head, *rows]), encoding="utf-8")
    elbow, lift = read(path).joints
    assert elbow.effort is not None
    np.testing.assert_allclose(elbow.effort, _EFFORT[:, 0])
    assert lift.effort is None
