"""Logs of every format hold what the same messages in MCAP hold, and damage ends in words."""

from __future__ import annotations

import bz2
import sqlite3
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from skin2urdf.cli.main import main
from skin2urdf.errors import Skin2UrdfError, UnreadableInputError
from skin2urdf.notes import of_reading
from skin2urdf.recording.reading import inventory, read
from skin2urdf.recording.records import Recording

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
EPOCH = 1_700_000_000 * 10**9
COUNT = 60
FORCE = np.random.default_rng(4).standard_normal((COUNT, 2, 3))
ANGLE = np.random.default_rng(5).standard_normal((COUNT, 2))
JOINTS = ["shoulder", "elbow"]


def messages(types: Any, *, ros1: bool) -> list[tuple[str, Any, int]]:
    """Joint states and two SUs, with an Imu and a Vector3Stamped."""

    def header(k: int, frame: str) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](*divmod(EPOCH + 10**7 * k, 10**9))
        before = (k,) if ros1 else ()
        return types["std_msgs/msg/Header"](*before, stamp=stamp, frame_id=frame)

    vector = types["geometry_msgs/msg/Vector3"]
    turn = types["geometry_msgs/msg/Quaternion"](0.1, 0.2, 0.3, 0.4)
    nine, none = np.arange(9.0), np.zeros(0)
    found = []
    for k in range(COUNT):
        time = EPOCH + 10**7 * k
        joints = types["sensor_msgs/msg/JointState"](
            header(k, ""), JOINTS, ANGLE[k], ANGLE[k], none
        )
        imu = types["sensor_msgs/msg/Imu"](
            header(k, "hand"), turn, nine, vector(5, 6, 7), nine, vector(*FORCE[k, 0]), nine
        )
        plain = types["geometry_msgs/msg/Vector3Stamped"](header(k, "arm"), vector(*FORCE[k, 1]))
        other = types["std_msgs/msg/String"]("text")
        found += [
            ("/joints", joints, time),
            ("/hand/imu", imu, time),
            ("/arm", plain, time),
            ("/chatter", other, time),
        ]
    return found


def ros1_bag(path: Path, compression: Any = None) -> Path:
    writer = Ros1Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections: dict[str, Any] = {}
        for topic, message, time in messages(ROS1.types, ros1=True):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(connections[topic], time, ROS1.serialize_ros1(message, kind))
    return path


def rosbag2(
    path: Path,
    storage: StoragePlugin,
    mode: CompressionMode | None = None,
) -> Path:
    writer = Writer(path, version=8, storage_plugin=storage)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, message, time in messages(ROS2.types, ros1=False):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(connections[topic], time, ROS2.serialize_cdr(message, kind))
    return path


def check(recording: Recording) -> None:
    """The recording holds all that was sent."""
    hand, arm = (next(su for su in recording.sus if su.name == name) for name in ("hand", "arm"))
    assert len(recording.sus) == 2
    np.testing.assert_allclose(hand.specific_force, FORCE[:, 0], rtol=1e-12)
    np.testing.assert_allclose(arm.specific_force, FORCE[:, 1], rtol=1e-12)
    found = {joint.name: joint for joint in recording.joints}
    for k, name in enumerate(JOINTS):
        np.testing.assert_allclose(found[name].position, ANGLE[:, k], rtol=1e-12)
    for stream in (*recording.joints, *recording.sus):
        np.testing.assert_allclose(stream.time, 0.01 * np.arange(COUNT), atol=1e-6)
    assert recording.start == pytest.approx(EPOCH / 1e9)


def written(kind: str, folder: Path) -> Path:
    if kind.startswith("ros1"):
        form = {"bz2": Ros1Writer.CompressionFormat.BZ2, "lz4": Ros1Writer.CompressionFormat.LZ4}
        return ros1_bag(folder / "log.bag", form.get(kind[5:]))
    storage = StoragePlugin.SQLITE3 if "sqlite3" in kind else StoragePlugin.MCAP
    mode = next((m for m in CompressionMode if m.name.lower() == kind.split()[-1]), None)
    bag = rosbag2(folder / "bag", storage, mode)
    return next(bag.glob("*.db3*")) if kind == "sqlite3 alone" else bag


KINDS = [
    "ros1",
    "ros1 bz2",
    "ros1 lz4",
    "sqlite3",
    "sqlite3 alone",
    "sqlite3 file",
    "sqlite3 message",
    "mcap file",
    "mcap message",
]


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_holds_the_same(kind: str, tmp_path: Path) -> None:
    path = written(kind, tmp_path)
    recording = read(path)
    check(recording)
    assert len(recording.digest) == 64
    topics = {topic.name: topic for topic in inventory(path).topics}
    assert {name: t.messages for name, t in topics.items()} == dict.fromkeys(
        ("/joints", "/hand/imu", "/arm", "/chatter"), COUNT
    )
    assert topics["/hand/imu"].ros_type == "sensor_msgs/msg/Imu"
    assert {name: t.used_as for name, t in topics.items()} == {
        "/joints": "joints", "/hand/imu": "su", "/arm": "su", "/chatter": "ignored",
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["ros1 lz4", "sqlite3", "mcap file"])
def test_what_is_converted_reads_alike_everywhere(kind: str, tmp_path: Path) -> None:
    target = tmp_path / "converted.mcap"
    assert main(["convert", str(written(kind, tmp_path)), str(target)]) == 0
    check(read(target))
    assert inventory(target).messages == 3 * COUNT
    with target.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        theirs = [m for *_, m in reader.iter_decoded_messages(topics=["/hand/imu"])]
    assert [m.linear_acceleration.x for m in theirs] == FORCE[:, 0, 0].tolist()
    assert theirs[3].angular_velocity.y == 6.0
    assert theirs[3].header.frame_id == "hand"


DEGREES = ["--joint-unit", "deg", "--joint-unit", "elb*=2"]


def check_scaled(target: Path) -> None:
    """The log has the positions and velocities times the units, and all else as it was sent."""
    with target.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        states = [m for *_, m in reader.iter_decoded_messages(topics=["/joints"])]
    expected = ANGLE * [np.pi / 180, 2.0]
    np.testing.assert_allclose([m.position for m in states], expected, rtol=1e-12)
    np.testing.assert_allclose([m.velocity for m in states], expected, rtol=1e-12)
    assert {tuple(m.name) for m in states} == {tuple(JOINTS)}
    (hand,) = [su for su in read(target).sus if su.name == "hand"]
    np.testing.assert_allclose(hand.specific_force, FORCE[:, 0], rtol=1e-12)


@pytest.mark.parametrize("kind", ["ros1 lz4", "sqlite3", "mcap file"])
def test_positions_in_other_units_are_converted(kind: str, tmp_path: Path) -> None:
    target = tmp_path / "converted.mcap"
    assert main(["convert", str(written(kind, tmp_path)), str(target), *DEGREES]) == 0
    check_scaled(target)


def test_units_of_no_joint_are_refused(tmp_path: Path) -> None:
    bag, target = ros1_bag(tmp_path / "log.bag"), tmp_path / "out.mcap"
    assert main(["convert", str(bag), str(target), "--joint-unit", "nose=deg"]) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["log.bag"]


@pytest.mark.parametrize("unit", ["furlong", "elbow=0", "elbow=nan"])
def test_what_is_no_unit_is_bad_usage(unit: str) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["convert", "log.bag", "out.mcap", "--joint-unit", unit])
    assert stopped.value.code == 2


def test_conversions_that_can_not_be_are_refused(tmp_path: Path) -> None:
    bag = ros1_bag(tmp_path / "log.bag")
    assert main(["convert", str(bag), str(tmp_path / "out.db3")]) == 2
    empty = tmp_path / "empty.mcap"
    empty.write_bytes(b"\x89MCAP0\r\n")
    assert main(["convert", str(empty), str(tmp_path / "out.mcap")]) == 2
    assert main(["convert", str(bag), str(bag.with_suffix(".mcap") / "x.mcap")]) == 2
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty.mcap", "log.bag"]


def test_a_bag_that_was_not_closed_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    data = bytearray(ros1_bag(tmp_path / "log.bag").read_bytes())
    at = data.index(b"index_pos=") + 10
    data[at : at + 8] = bytes(8)
    cut = tmp_path / "cut.bag"
    cut.write_bytes(data[: data.rindex(b"op=\x05")])
    notes = inventory(cut).notes
    unclosed, left = (note.number for note in of_reading(notes, "cut short"))
    assert unclosed == 0 < left
    whole = tmp_path / "unclosed.bag"
    whole.write_bytes(data)
    check(read(whole))


def test_a_ros1_chunk_is_unpacked_no_further_than_it_claims(tmp_path: Path) -> None:
    bomb = bz2.compress(bytes(1 << 26))
    header = b"".join(
        struct.pack("<I", len(f)) + f
        for f in (b"op=\x05", b"compression=bz2", b"size=" + struct.pack("<I", 1000))
    )
    record = struct.pack("<I", len(header)) + header + struct.pack("<I", len(bomb)) + bomb
    path = tmp_path / "bomb.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + record)
    (note,) = of_reading(inventory(path).notes, "damaged")
    assert "1001" in note.words


def test_a_packed_file_is_unpacked_no_further_than_a_log_can_be(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap.zstd"
    path.write_bytes(zstandard.ZstdCompressor().compress(b"\x89MCAP0\r\n" + bytes(300 << 20)))
    with pytest.raises(UnreadableInputError) as caught:
        read(path)
    assert caught.value.why == "too large"


def test_messages_that_unpack_to_far_too_much_are_left_out(tmp_path: Path) -> None:
    bag = written("sqlite3 message", tmp_path)
    (path,) = bag.glob("*.db3")
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 24))
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET data = ? WHERE rowid = 2", (bomb,))
    recording = read(path)
    assert [note.number for note in of_reading(recording.notes, "damaged")] == [1]
    assert {len(su.time) for su in recording.sus} == {COUNT, COUNT - 1}


@pytest.mark.parametrize(
    "script",
    [
        # Rows without end that the database would compute.
        "DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE r(id) AS (SELECT 1 UNION ALL "
        "SELECT id + 1 FROM r) SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM r;",
        "DROP TABLE messages; CREATE TABLE messages (id, topic_id, timestamp, data GENERATED "
        "ALWAYS AS (zeroblob(100000000)) VIRTUAL); INSERT INTO messages VALUES (1, 1, 1);",
        "DROP TABLE topics;",
    ],
)
def test_databases_that_compute_their_rows_are_refused(script: str, tmp_path: Path) -> None:
    (path,) = written("sqlite3", tmp_path).glob("*.db3")
    with sqlite3.connect(path) as database:
        database.executescript(script)
    with pytest.raises(UnreadableInputError) as caught:
        inventory(path)
    assert caught.value.why == "another format"


def test_odd_rows_of_a_database_are_left_out_and_names_escaped(tmp_path: Path) -> None:
    (path,) = written("sqlite3", tmp_path).glob("*.db3")
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET data = 'text' WHERE rowid = 2")
        database.execute("UPDATE messages SET timestamp = 'noon' WHERE rowid = 3")
        database.execute("UPDATE messages SET topic_id = 77 WHERE rowid = 6")
        database.execute("UPDATE topics SET name = '/arm' || char(27) || '[2J' WHERE name = '/arm'")
    recording = read(path)
    assert [note.number for note in of_reading(recording.notes, "damaged")] == [3]
    assert {su.topic for su in recording.sus} == {"/hand/imu", "/arm\\x1b[2J"}


@pytest.mark.parametrize("kind", ["ros1 lz4", "ros1", "sqlite3 alone", "sqlite3 file"])
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    part=st.floats(0.0, 1.0),
    flips=st.lists(st.tuples(st.floats(0.0, 0.999), st.integers(1, 255)), max_size=8),
)
@example(part=1.0, flips=[(0.046875, 128)])
def test_damaged_logs_of_other_formats_raise_only_our_errors(
    kind: str, part: float, flips: list[tuple[float, int]], tmp_path: Path
) -> None:
    folder = tmp_path / kind
    if not folder.exists():
        folder.mkdir()
        path = written(kind, folder)
        path = next(path.glob("*.db3*")) if path.is_dir() else path
        (folder / "whole").write_bytes(path.read_bytes())
    data = bytearray((folder / "whole").read_bytes())
    for where, mask in flips:
        data[int(where * len(data))] ^= mask
    damaged = folder / "damaged.db3"
    damaged.write_bytes(data[: int(part * len(data))])
    try:
        inventory(damaged)
        remedy = read(damaged) and "none needed"
    except Skin2UrdfError as error:
        remedy = error.remedy
    assert remedy


def xcdr2(topic: str, message: Any) -> bytes:
    """A payload in plain CDR2, built field by field."""
    header = message.header
    out = struct.pack("<iI", header.stamp.sec, header.stamp.nanosec)

    def text(out: bytes, words: str) -> bytes:
        encoded = words.encode() + b"\0"
        return out + bytes(-len(out) % 4) + struct.pack("<I", len(encoded)) + encoded

    out = text(out, header.frame_id)
    out += bytes(-len(out) % 4)
    if topic == "/joints":
        names = struct.pack("<I", len(message.name))
        for name in message.name:
            names = text(names, name)
        out += struct.pack("<I", len(names)) + names
        out += bytes(-len(out) % 4)
        for values in (message.position, message.velocity, message.effort):
            out += struct.pack(f"<I{len(values)}d", len(values), *values)
    elif topic == "/arm":
        out += struct.pack("<3d", message.vector.x, message.vector.y, message.vector.z)
    else:
        v = message.linear_acceleration
        out += bytes(25 * 8) + struct.pack("<3d", v.x, v.y, v.z) + bytes(9 * 8)
    return b"\x00\x07\x00\x00" + out


def test_payloads_in_xcdr2(make_log: Any) -> None:
    log = make_log()
    for topic, message, time in messages(ROS2.types, ros1=False):
        if topic != "/chatter":
            log.raw(topic, message.__msgtype__, xcdr2(topic, message), time)
    path = log.close()
    check(read(path))
    target = path.with_name("converted.mcap")
    assert main(["convert", str(path), str(target), *DEGREES]) == 0
    found = {joint.name: joint.position for joint in read(target).joints}
    np.testing.assert_allclose(found["shoulder"], np.deg2rad(ANGLE[:, 0]), rtol=1e-12)
    np.testing.assert_allclose(found["elbow"], 2 * ANGLE[:, 1], rtol=1e-12)
