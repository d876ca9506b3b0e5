from __future__ import annotations

import gzip
import os
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from skin2urdf.errors import Skin2UrdfError, UnreadableInputError
from skin2urdf.notes import of_reading
from skin2urdf.recording.reading import inventory, read
from skin2urdf.recording.records import Recording
from skin2urdf.recording.writing import write

MAGIC = b"\x89MCAP0\r\n"
STORAGES: list[dict[str, Any]] = [
    {"compression": "zstd", "chunk_size": 20_000},
    {"compression": "lz4", "chunk_size": 20_000},
    {"compression": "none", "chunk_size": 20_000},
    {"compression": "zstd", "chunk_size": 20_000, "indexed": False},
    {"chunked": False},
]


def written(recording: Recording, folder: Path, storage: dict[str, Any]) -> bytes:
    path = folder / "whole.mcap"
    if not path.exists():
        write(recording, path, **storage)
    return path.read_bytes()


@pytest.mark.parametrize("storage", STORAGES, ids=str)
def test_a_cut_file_gives_what_is_whole(
    storage: dict[str, Any], small: Recording, tmp_path: Path
) -> None:
    data = written(small, tmp_path, storage)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(0.6 * len(data))])
    recording = read(cut)
    for got, whole in zip(recording.sus, small.sus, strict=True):
        n = got.time.size
        assert 150 < n < whole.time.size
        assert np.array_equal(got.specific_force, whole.specific_force[:n])
    (note,) = of_reading(recording.notes, "cut short")
    assert note.number > 0
    assert note in inventory(cut).notes


def test_every_chunk_counts_even_without_a_summary(small: Recording, tmp_path: Path) -> None:
    data = written(small, tmp_path, {"compression": "zstd", "chunk_size": 20_000})
    end_of_data = data.index(b"\x0f" + (4).to_bytes(8, "little"))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[:end_of_data])
    recording = read(cut)
    assert [s.time.size for s in recording.sus] == [400, 400, 400]
    assert [note.number for note in of_reading(recording.notes, "cut short")] == [0]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_chunk_whose_checksum_fails_is_left_out_and_named(
    compression: Any, small: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "log.mcap"
    write(small, path, compression=compression, chunk_size=20_000)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[2]
    data = bytearray(path.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0x10
    path.write_bytes(data)
    recording = read(path)
    assert all(300 < s.time.size < 400 for s in recording.sus)
    assert len(of_reading(recording.notes, "damaged")) == 1


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.binary(max_size=400), magic=st.booleans())
def test_random_bytes_raise_only_our_errors(data: bytes, magic: bool, tmp_path: Path) -> None:
    path = tmp_path / "noise.mcap"
    path.write_bytes(MAGIC + data if magic else data)
    with pytest.raises(Skin2UrdfError) as caught:
        read(path)
    assert caught.value.exit_status == 2
    assert caught.value.remedy


@pytest.mark.parametrize("storage", STORAGES, ids=str)
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    part=st.floats(0.0, 1.0),
    flips=st.lists(st.tuples(st.floats(0.0, 0.999), st.integers(1, 255)), max_size=8),
)
def test_damaged_logs_raise_only_our_errors(
    storage: dict[str, Any],
    part: float,
    flips: list[tuple[float, int]],
    small: Recording,
    tmp_path: Path,
) -> None:
    data = bytearray(written(small, tmp_path, storage))
    for where, mask in flips:
        data[int(where * len(data))] ^= mask
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data[: int(part * len(data))])
    try:
        recording = read(path)
    except Skin2UrdfError as error:
        recording = Recording((), ())
        remedy = error.remedy
    else:
        remedy = "none needed"
    assert remedy
    for stream in (*recording.joints, *recording.sus):
        assert (np.diff(stream.time) > 0.0).all()
        assert np.isfinite(stream.time).all()


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(payloads=st.lists(st.binary(max_size=120), min_size=1, max_size=6), plain=st.booleans())
def test_garbage_payloads_raise_only_our_errors(
    payloads: list[bytes], plain: bool, make_log: Any
) -> None:
    log = make_log()
    for k, payload in enumerate(payloads):
        content = b"\x00\x01\x00\x00" + payload if plain else payload
        for topic, ros_type in (
            ("/joint_states", "sensor_msgs/msg/JointState"),
            ("/imu", "sensor_msgs/msg/Imu"),
            ("/v", "geometry_msgs/msg/Vector3Stamped"),
        ):
            log.raw(topic, ros_type, content, k)
    path = log.close()
    try:
        remedy = read(path) and "none needed"
    except Skin2UrdfError as error:
        remedy = error.remedy
    assert remedy


def refused(path: Path) -> UnreadableInputError:
    with pytest.raises(UnreadableInputError) as caught:
        read(path)
    assert caught.value.exit_status == 2
    with pytest.raises(UnreadableInputError):
        inventory(path)
    return caught.value


def test_other_inputs_are_refused_with_the_next_step(tmp_path: Path) -> None:
    empty = tmp_path / "empty.mcap"
    empty.touch()
    assert refused(empty).why == "empty"
    assert "ros2" in refused(empty).remedy

    database = tmp_path / "bag.db3"
    connection = sqlite3.connect(database)
    connection.execute("create table messages (id)")
    connection.commit()
    connection.close()
    assert refused(database).why == "another format"

    ros1 = tmp_path / "old.bag"
    ros1.write_bytes(b"#ROSBAG V1.1\n")
    assert "rosbag fix" in refused(ros1).remedy

    packed = tmp_path / "log.mcap.gz"
    packed.write_bytes(gzip.compress(MAGIC))
    assert "gunzip" in refused(packed).remedy

    text = tmp_path / "robot.urdf"
    for content in ("<robot/>", "\ufeff\n<robot/>", '{"sus": {}}'):
        text.write_text(content)
        assert refused(text).why == "a text"
    text.write_text("neither")
    assert refused(text).why == "another format"

    missing = refused(tmp_path / "missing.mcap")
    assert isinstance(missing.__cause__, FileNotFoundError)
    assert missing.remedy


def test_directories_without_a_log_are_refused_with_the_next_step(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    assert refused(folder).why == "no log"
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:")
    assert str(folder) in refused(folder / "metadata.yaml").remedy
    (folder / "bag_0.mcap.zstd").write_bytes(b"\x28\xb5\x2f\xfd")
    assert "zstd -d" in refused(folder).remedy
    (folder / "bag_0.mcap.zstd").unlink()
    (folder / "bag_0.db3").touch()
    assert refused(folder).why == "empty"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(MAGIC)
    path.chmod(0)
    assert isinstance(refused(path).__cause__, PermissionError)


def test_a_log_without_joints_or_sus_says_what_it_holds(make_log: Any) -> None:
    log = make_log("no_joints.mcap")
    log.imu(10**9, [0, 0, 1])
    with pytest.raises(UnreadableInputError) as caught:
        read(log.close())
    assert caught.value.why == "no joints"
    assert all(name in str(caught.value) for name in ("JointState", "/imu"))
    log = make_log("no_sus.mcap")
    log.joints(10**9, {"a": 0.0})
    log.joints(10**9 + 5, {"a": 0.0})
    with pytest.raises(UnreadableInputError) as caught:
        read(log.close())
    assert caught.value.why == "no SUs"
    assert all(name in str(caught.value) for name in ("Imu", "AccelStamped"))
    log = make_log("nothing.mcap")
    with pytest.raises(UnreadableInputError) as caught:
        read(log.close())
    assert caught.value.why == "no messages"
    log = make_log("protobuf.mcap")
    log.channel("/joint_states", "sensor_msgs/msg/JointState", "protobuf")
    log.joints(10**9, {"a": 0.0})
    with pytest.raises(UnreadableInputError, match="protobuf"):
        read(log.close())
