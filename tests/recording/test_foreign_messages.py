from __future__ import annotations

import hashlib
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from skin2urdf.errors import UnreadableInputError
from skin2urdf.notes import of_reading
from skin2urdf.recording.reading import inventory, read

EPOCH = 1_700_000_000 * 10**9
MS = 10**6


def fill_joints(log: Any, n: int = 40) -> None:
    for k in range(n):
        log.joints(EPOCH + 10 * MS * k, {"joint": 0.1 * k})


def stamped(types: Any, ros_type: str, stamp: int, frame: str, force: Any) -> Any:
    header = types["std_msgs/msg/Header"](
        types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), frame
    )
    vector = types["geometry_msgs/msg/Vector3"]
    accel = types["geometry_msgs/msg/Accel"](vector(*force), vector(8.0, 9.0, 10.0))
    if ros_type == "Vector3Stamped":
        return types["geometry_msgs/msg/Vector3Stamped"](header, vector(*force))
    if ros_type == "AccelStamped":
        return types["geometry_msgs/msg/AccelStamped"](header, accel)
    covariance = types["geometry_msgs/msg/AccelWithCovariance"](accel, np.arange(36.0))
    return types["geometry_msgs/msg/AccelWithCovarianceStamped"](header, covariance)


@pytest.mark.parametrize("little_endian", [True, False])
@pytest.mark.parametrize("frame", ["", "a", "abc", "abcd", "sensor_frame_7"])
@pytest.mark.parametrize(
    "ros_type", ["Imu", "AccelStamped", "AccelWithCovarianceStamped", "Vector3Stamped"]
)
def test_accelerations_of_every_type(
    ros_type: str, frame: str, little_endian: bool, ros_log: Any, ros_types: Any
) -> None:
    force = np.random.default_rng(3).standard_normal((30, 3))
    for k in range(30):
        stamp = EPOCH + 5 * MS * k
        ros_log.joints(stamp, {"b": 2.0 * k, "a": -1.0 * k}, little_endian=little_endian)
        if ros_type == "Imu":
            ros_log.imu(stamp, force[k], frame, "/x/acc", little_endian=little_endian)
        else:
            message = stamped(ros_types, ros_type, stamp, frame, force[k])
            ros_log.add("/x/acc", message, little_endian=little_endian)
    recording = read(ros_log.close())

    (su,) = recording.sus
    assert su.name == (frame or "x_acc")
    assert su.topic == "/x/acc"
    assert np.array_equal(su.specific_force, force)
    np.testing.assert_allclose(su.time, np.arange(30) * 0.005, atol=1e-9)
    assert [j.name for j in recording.joints] == ["a", "b"]
    assert np.array_equal(recording.joints[0].position, -1.0 * np.arange(30))
    assert np.array_equal(recording.joints[1].position, 2.0 * np.arange(30))


def test_both_byte_orders_on_one_topic(ros_log: Any) -> None:
    fill_joints(ros_log)
    for k in range(40):
        ros_log.imu(EPOCH + 10 * MS * k, [k, 0, 0], little_endian=k % 2 == 0)
    (su,) = read(ros_log.close()).sus
    assert np.array_equal(su.specific_force[:, 0], np.arange(40.0))


def test_other_encapsulations_are_refused_in_words(ros_log: Any) -> None:
    fill_joints(ros_log)
    for k in range(5):
        ros_log.raw("/imu", "sensor_msgs/msg/Imu", b"\x00\x03\x00\x00" + bytes(320), EPOCH + k)
    path = ros_log.close()
    with pytest.raises(UnreadableInputError, match="0x0003"):
        read(path)


def test_many_sus_on_one_topic_and_names_from_topics(ros_log: Any) -> None:
    fill_joints(ros_log)
    rng = np.random.default_rng(0)
    sent: dict[str, list[float]] = {f"cell_{k}": [] for k in range(20)}
    for k in range(40):
        for frame in rng.permutation(list(sent)):
            sent[frame].append(float(rng.standard_normal()))
            ros_log.imu(EPOCH + 10 * MS * k, [sent[frame][-1], 0, 1], str(frame), "/skin")
        ros_log.imu(EPOCH + 10 * MS * k, [1, 2, 3], "cell_3", "/arm/imu")
        ros_log.imu(EPOCH + 10 * MS * k, [1, 2, 4], "", "/hand/imu")
    recording = read(ros_log.close())

    # cell_3 is on two topics, so its frame_id names neither.
    expected = {f: f for f in sent} | {"cell_3": "skin_cell_3"}
    by_name = {su.name: su for su in recording.sus}
    assert set(by_name) == set(expected.values()) | {"arm_imu", "hand_imu"}
    for frame, values in sent.items():
        assert np.array_equal(by_name[expected[frame]].specific_force[:, 0], values)
    assert [su.name for su in recording.sus] == sorted(by_name)


def test_joint_order_may_change_in_every_message(ros_log: Any) -> None:
    rng = np.random.default_rng(1)
    names = [f"j{k}" for k in range(6)]
    values = rng.standard_normal((200, 6))
    for k in range(200):
        order = rng.permutation(6)
        ros_log.joints(EPOCH + 4 * MS * k, {names[j]: values[k, j] for j in order})
        ros_log.imu(EPOCH + 4 * MS * k, [0, 0, 9.81])
    recording = read(ros_log.close())
    assert np.array_equal(np.stack([j.position for j in recording.joints], 1), values)
    assert all(j.time is recording.joints[0].time for j in recording.joints)


@pytest.mark.parametrize("topic", ["/joint_states", "/gripper/joint_states"])
def test_two_publishers_each_carry_a_part(topic: str, ros_log: Any) -> None:
    for k in range(60):
        ros_log.joints(EPOCH + 4 * MS * k, {"a": k, "b": -k})
        if k % 2 == 0:
            ros_log.joints(EPOCH + 4 * MS * k + MS, {"finger": 10 + k}, topic)
        ros_log.imu(EPOCH + 4 * MS * k, [0, 0, 9.81])
    recording = read(ros_log.close())
    a, b, finger = recording.joints
    assert [a.name, b.name, finger.name] == ["a", "b", "finger"]
    assert np.array_equal(a.position, np.arange(60))
    assert np.array_equal(b.position, -np.arange(60))
    assert np.array_equal(finger.position, 10 + np.arange(0, 60, 2))
    np.testing.assert_allclose(finger.time, 0.001 + 0.008 * np.arange(30), atol=1e-9)


def test_a_joint_that_comes_in_two_companies_is_joined(ros_log: Any) -> None:
    for k in range(60):
        ros_log.joints(EPOCH + 4 * MS * k, {"a": k, "b": -k} if k % 3 else {"a": k})
        ros_log.imu(EPOCH + 4 * MS * k, [0, 0, 9.81])
    a, b = read(ros_log.close()).joints
    assert np.array_equal(a.position, np.arange(60))
    assert np.array_equal(b.position, [-k for k in range(60) if k % 3])


def test_a_joint_on_two_topics_is_read_from_the_busier_one(ros_log: Any) -> None:
    for k in range(60):
        ros_log.joints(EPOCH + 4 * MS * k, {"a": k}, "/arm/joint_states")
        if k % 4 == 0:
            ros_log.joints(EPOCH + 4 * MS * k + MS, {"a": 1000}, "/joint_states")
        ros_log.imu(EPOCH + 4 * MS * k, [0, 0, 9.81])
    recording = read(ros_log.close())
    assert np.array_equal(recording.joints[0].position, np.arange(60))
    (note,) = of_reading(recording.notes, "several topics")
    assert note.sources == ("a", "/joint_states")


@pytest.mark.parametrize(
    ("topics", "called"),
    [
        (("/left/joint_states", "/right/joint_states"), ["left_a", "left_b", "right_a", "right_b"]),
        (("/joint_states", "/two/joint_states"), ["a", "b", "two_a", "two_b"]),
    ],
)
def test_joints_of_one_name_that_go_their_own_ways_are_told_apart(
    topics: tuple[str, str], called: list[str], ros_log: Any
) -> None:
    rng = np.random.default_rng(3)
    ways = rng.uniform(-1, 1, (2, 2, 12)).repeat(50, axis=2)
    for k in range(600):
        for topic, (a, b) in zip(topics, ways[:, :, k], strict=True):
            ros_log.joints(EPOCH + 4 * MS * k, {"a": a, "b": b}, topic)
        ros_log.imu(EPOCH + 4 * MS * k, [0, 0, 9.81])
    recording = read(ros_log.close())
    assert [joint.name for joint in recording.joints] == called
    for joint, way in zip(recording.joints, ways.reshape(4, -1), strict=True):
        assert np.array_equal(joint.position, way)
    notes = of_reading(recording.notes, "joints of one name")
    assert [note.sources for note in notes] == [("a", *topics), ("b", *topics)]


@pytest.mark.parametrize("scale", [1.0, -57.3])
def test_a_command_and_what_follows_it_are_one_joint(scale: float, ros_log: Any) -> None:
    rng = np.random.default_rng(4)
    command = rng.uniform(-1, 1, (2, 12)).repeat(50, axis=1)
    follows = np.zeros_like(command)
    for k in range(1, 600):
        follows[:, k] = follows[:, k - 1] + 0.15 * (command[:, k] - follows[:, k - 1])
    for k in range(600):
        ros_log.joints(EPOCH + 4 * MS * k, dict(zip("ab", follows[:, k], strict=True)))
        if k % 2:
            sent = dict(zip("ab", scale * command[:, k], strict=True))
            ros_log.joints(EPOCH + 4 * MS * k, sent, "/commands")
        ros_log.imu(EPOCH + 4 * MS * k, [0, 0, 9.81])
    recording = read(ros_log.close())
    assert np.array_equal([joint.position for joint in recording.joints], follows)
    passed = of_reading(recording.notes, "several topics")
    assert [note.sources for note in passed] == [("a", "/commands"), ("b", "/commands")]


def test_positions_missing_or_not_finite_are_skipped_with_a_note(
    ros_log: Any, ros_types: Any
) -> None:
    for k in range(50):
        stamp = EPOCH + 4 * MS * k
        ros_log.joints(stamp, {"a": np.nan if k == 7 else k, "b": k, "dead": np.nan})
        ros_log.imu(stamp, [{3: np.inf, 4: -1e300}.get(k, k), 0, 9.81])
        if k % 10 == 0:
            header = ros_types["std_msgs/msg/Header"](
                ros_types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), ""
            )
            empty = np.zeros(0)
            velocity_only = ros_types["sensor_msgs/msg/JointState"](
                header, ["a", "b"], empty, np.ones(2), empty
            )
            ros_log.add("/joint_states", velocity_only)
    recording = read(ros_log.close())
    assert [j.name for j in recording.joints] == ["a", "b"]
    assert recording.joints[0].position.size == 49
    assert np.array_equal(recording.joints[1].position, np.arange(50))
    assert np.array_equal(recording.sus[0].specific_force[:, 0], [0, 1, 2, *range(5, 50)])
    (passed,) = of_reading(recording.notes, "passed over")
    assert (passed.sources, passed.number) == (("/joint_states",), 5)
    absurd = {note.sources: note.number for note in of_reading(recording.notes, "absurd values")}
    assert absurd == {("a", "/joint_states"): 1, ("dead", "/joint_states"): 50, ("su", "/imu"): 2}
    (few,) = of_reading(recording.notes, "too few")
    assert few.sources == ("dead", "/joint_states")


def test_an_su_that_sends_nothing_but_nan_is_an_su_without_readings(ros_log: Any) -> None:
    fill_joints(ros_log)
    for k in range(40):
        stamp = EPOCH + 10 * MS * k
        ros_log.imu(stamp, [k, 0, 9.8], "works", "/works")
        ros_log.imu(stamp, [np.nan, np.nan, np.nan], "broken", "/broken")
    ros_log.imu(EPOCH, [1, 2, 3], "damaged name", "/works")
    recording = read(ros_log.close())
    assert [(su.topic, su.time.size) for su in recording.sus] == [("/broken", 0), ("/works", 40)]
    assert recording.sus[0].specific_force.shape == (0, 3)


def test_zero_stamps_mean_log_time(ros_log: Any) -> None:
    for k in range(50):
        ros_log.joints(EPOCH + 4 * MS * k, {"a": k})
        ros_log.imu(0, [k, 0, 0], log_time=EPOCH + 4 * MS * k + 2 * MS)
    recording = read(ros_log.close())
    np.testing.assert_allclose(recording.sus[0].time, 0.002 + 0.004 * np.arange(50), atol=1e-9)
    assert [n.sources for n in of_reading(recording.notes, "no stamps")] == [("/imu",)]


def test_some_stamps_unset_or_wild_are_filled_from_log_times(ros_log: Any) -> None:
    for k in range(100):
        at = EPOCH + 4 * MS * k
        ros_log.joints(at, {"a": k})
        stamp = {20: 0, 21: 0, 60: at + 3600 * 10**9, 0: 0}.get(k, at)
        ros_log.imu(stamp, [k, 0, 0], log_time=at + MS)
    recording = read(ros_log.close())
    np.testing.assert_allclose(recording.sus[0].time, 0.004 * np.arange(100), atol=1e-6)


def test_a_device_clock_is_moved_to_the_clock_of_the_joints(ros_log: Any) -> None:
    for k in range(100):
        at = EPOCH + 4 * MS * k
        ros_log.joints(at, {"a": k}, log_time=at + MS)
        ros_log.imu(17 * 10**9 + 4 * MS * k, [k, 0, 0], log_time=at + MS)
    recording = read(ros_log.close())
    np.testing.assert_allclose(recording.sus[0].time, recording.joints[0].time, atol=1e-6)
    assert [n.sources for n in of_reading(recording.notes, "other clock")] == [("/imu",)]


def test_simulated_time_is_kept(ros_log: Any) -> None:
    for k in range(100):
        ros_log.joints(10**9 + 4 * MS * k, {"a": k}, log_time=EPOCH + 4 * MS * k)
        ros_log.imu(10**9 + 4 * MS * k, [k, 0, 0], log_time=EPOCH + 4 * MS * k)
    recording = read(ros_log.close())
    assert recording.start == 1.0
    assert not recording.notes


def test_a_split_bag_directory_is_one_log(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    parts = []
    for part in range(11):
        bag = tmp_path / f"part{part}"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for topic, kind in (("/js", "JointState"), ("/acc", "Vector3Stamped")):
                package = "sensor_msgs" if kind == "JointState" else "geometry_msgs"
                ros_type = f"{package}/msg/{kind}"
                connection = writer.add_connection(topic, ros_type, typestore=store)
                for k in range(10):
                    at = EPOCH + 4 * MS * (10 * part + k)
                    value = float(10 * part + k)
                    if kind == "JointState":
                        header = types["std_msgs/msg/Header"](
                            types["builtin_interfaces/msg/Time"](at // 10**9, at % 10**9), ""
                        )
                        empty = np.zeros(0)
                        message = types[ros_type](header, ["j"], np.array([value]), empty, empty)
                    else:
                        message = stamped(types, kind, at, "su", (value, 0.0, 0.0))
                    writer.write(connection, at, store.serialize_cdr(message, ros_type))
        parts.append(bag / f"part{part}.mcap")
    whole = tmp_path / "whole"
    whole.mkdir()
    for k, part_path in enumerate(parts):
        shutil.copy(part_path, whole / f"whole_{k}.mcap")
    recording = read(whole)
    assert np.array_equal(recording.joints[0].position, np.arange(110.0))
    assert np.array_equal(recording.sus[0].specific_force[:, 0], np.arange(110.0))
    digest = hashlib.sha256(b"".join(p.read_bytes() for p in parts)).hexdigest()
    assert recording.digest == digest
    assert sum(t.messages for t in inventory(whole).topics) == 220


def test_topics_of_no_use_are_left_alone(ros_log: Any) -> None:
    fill_joints(ros_log)
    for k in range(40):
        ros_log.imu(EPOCH + 10 * MS * k, [k, 0, 0])
        ros_log.raw("/chatter", "std_msgs/msg/String", b"\x00\x01\x00\x00\x02\x00\x00\x00a\0", k)
    path = ros_log.close()
    assert len(read(path).sus) == 1
    used = {t.name: t.used_as for t in inventory(path).topics}
    assert used == {"/joint_states": "joints", "/imu": "su", "/chatter": "ignored"}


def test_an_index_that_lies_is_not_believed(make_log: Any) -> None:
    log = make_log(compression=CompressionType.NONE)
    fill_joints(log)
    for k in range(40):
        log.imu(EPOCH + 10 * MS * k, [k, 0, 0])
    path = log.close()
    data = bytearray(path.read_bytes())
    # The first entry of the first message index behind the chunk: opcode 7, length, channel,
    # size of the entries, log time, offset.
    at = data.index(b"\x07" + (6 + 40 * 16).to_bytes(8, "little"))
    data[at + 9 + 6 + 8] += 1
    path.write_bytes(data)
    recording = read(path)
    assert recording.joints[0].position.size == 40
    assert np.array_equal(recording.sus[0].specific_force[:, 0], np.arange(40.0))
    assert of_reading(recording.notes, "contradicted index")
