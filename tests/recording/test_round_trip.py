from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from skin2urdf.errors import UsageError
from skin2urdf.recording.progress import Share
from skin2urdf.recording.reading import inventory, read
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.writing import write

STORAGES = [
    {"compression": "zstd"},
    {"compression": "lz4"},
    {"compression": "none"},
    {"compression": "zstd", "indexed": False},
    {"compression": "lz4", "indexed": False},
    {"compression": "none", "indexed": False},
    {"chunked": False},
    {"chunked": False, "indexed": False},
    {"compression": "zstd", "chunk_size": 3000},
    {"compression": "lz4", "chunk_size": 3000, "indexed": False},
]


def read_with_rosbags(path: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, log_time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            assert stamp == log_time
            found.setdefault(connection.topic, []).append((stamp, message))
    return found


@pytest.mark.parametrize("storage", STORAGES, ids=str)
def test_values_and_times_are_those_rosbags_reads(
    storage: dict[str, Any], small: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "log.mcap"
    write(small, path, **storage)
    ours = read(path)
    theirs = read_with_rosbags(path)
    start = round(ours.start * 1e9)

    for su in ours.sus:
        messages = theirs[su.topic]
        vectors = [m.linear_acceleration for _, m in messages]
        assert np.array_equal(su.specific_force, [[v.x, v.y, v.z] for v in vectors])
        assert np.array_equal(np.rint(su.time * 1e9), [s - start for s, _ in messages])
        assert {m.header.frame_id for _, m in messages} == {su.name}
    for joint in ours.joints:
        messages = [(s, m) for s, m in theirs["/joint_states"] if joint.name in m.name]
        positions = [m.position[m.name.index(joint.name)] for _, m in messages]
        assert np.array_equal(joint.position, positions)
        assert np.array_equal(np.rint(joint.time * 1e9), [s - start for s, _ in messages])


@pytest.mark.parametrize("storage", STORAGES, ids=str)
def test_what_is_written_is_read_back(
    storage: dict[str, Any], small: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "log.mcap"
    write(small, path, **storage)
    back = read(path)

    assert back.start == small.start
    assert back.notes == ()
    for kind in ("joints", "sus"):
        for a, b in zip(getattr(small, kind), getattr(back, kind), strict=True):
            assert a.name == b.name
            np.testing.assert_allclose(b.time, a.time, rtol=0, atol=1e-9)
    assert [s.topic for s in back.sus] == [s.topic for s in small.sus]


names = st.text(
    st.characters(
        blacklist_characters="\0", blacklist_categories=["Cs", "Zs", "Cc", "Cf", "Zl", "Zp", "Cn"]
    ),
    max_size=12,
).filter(lambda name: name.strip().lstrip("/") == name != "")


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    joint_names=st.lists(names, min_size=1, max_size=5, unique=True),
    su_names=st.lists(names, min_size=1, max_size=4, unique=True),
    n=st.integers(2, 40),
    seed=st.integers(0, 99),
    chunked=st.booleans(),
    data=st.data(),
)
def test_any_names_survive(
    joint_names: list[str],
    su_names: list[str],
    n: int,
    seed: int,
    chunked: bool,
    data: st.DataObject,
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(seed)
    times = np.arange(n) / 8.0
    joints = tuple(JointStream(k, times, rng.standard_normal(n)) for k in sorted(joint_names))
    sus = tuple(
        SuStream(k, times, rng.standard_normal((n, 3)), f"/topic_{i}")
        for i, k in enumerate(sorted(su_names))
    )
    path = tmp_path / "log.mcap"
    order = data.draw(st.permutations(joint_names))
    write(Recording(joints, sus, start=5.0), path, chunked=chunked, joint_order=order)
    back = read(path)

    assert [j.name for j in back.joints] == sorted(joint_names)
    assert [s.name for s in back.sus] == sorted(su_names)
    assert all(
        np.array_equal(a.position, b.position) for a, b in zip(joints, back.joints, strict=True)
    )
    assert all(
        np.array_equal(a.specific_force, b.specific_force)
        for a, b in zip(sus, back.sus, strict=True)
    )
    assert len({id(j.time) for j in back.joints}) == 1


def test_the_joint_order_asked_for_is_written(small: Recording, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    time = small.joints[0].time
    joints = tuple(JointStream(name, time, time + k) for k, name in enumerate("abc"))
    write(Recording(joints, small.sus, start=1.0), path, joint_order=["c", "a", "b"])
    messages = read_with_rosbags(path)["/joint_states"]
    assert {tuple(m.name) for _, m in messages} == {("c", "a", "b")}
    assert len(messages) == time.size


def test_messages_lie_in_the_order_of_time(small: Recording, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(small, path, chunked=False)
    with path.open("rb") as stream:
        times = [m.log_time for _, _, m in make_reader(stream).iter_messages(log_time_order=False)]
    assert times == sorted(times)
    assert len(times) == 3 * 400 + 200 + 190


def test_inventory_counts_every_topic(small: Recording, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(small, path, compression="lz4")
    found = inventory(path)
    assert [(t.name, t.messages, t.used_as) for t in found.topics] == [
        ("/joint_states", 390, "joints"),
        ("/skin/0", 400, "su"),
        ("/skin/1", 400, "su"),
        ("/skin/2", 400, "su"),
    ]
    assert found.topics[0].ros_type == "sensor_msgs/msg/JointState"
    assert (found.compression, found.profile) == (("lz4",), "ros2")
    assert found.messages == 1590
    assert found.duration == pytest.approx(1.997, abs=1e-9)


def test_progress_rises_to_one(small: Recording, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(small, path, chunk_size=2000)
    seen: list[float] = []
    read(path, seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_bad_arguments_are_refused_and_leave_nothing(small: Recording, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    missing = tmp_path / "missing" / "log.mcap"
    wrong: dict[str, Callable[[], None]] = {
        "compression": lambda: write(small, path, compression="rar"),  # type: ignore[arg-type]
        "joint_order": lambda: write(small, path, joint_order=["elbow"]),
        str(missing): lambda: write(small, missing),
        "start": lambda: write(Recording(small.joints, small.sus, start=-5.0), path),
        "joint_topic": lambda: write(small, path, joint_topic="/skin/1"),
    }
    for argument, attempt in wrong.items():
        with pytest.raises(UsageError) as caught:
            attempt()
        assert caught.value.argument == argument
    assert list(tmp_path.iterdir()) == []


def test_progress_knows_the_bytes_that_were_read(small: Recording, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(small, path, chunk_size=20_000)
    told: list[Share] = []
    read(path, told.append)
    size = path.stat().st_size
    assert [share.total for share in told] == [size] * len(told)
    assert all(a.done <= b.done for a, b in pairwise(told))
    assert (told[-1], told[-1].done) == (1.0, size)
    later = told[-1].among(1, 4)
    assert (later, later.done) == (0.5, size)
