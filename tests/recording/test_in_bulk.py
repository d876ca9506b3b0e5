"""What is done for many messages at once finds what stepping through them one by one finds."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType

from skin2urdf.notes import of_reading
from skin2urdf.recording import container
from skin2urdf.recording.framing import BATCH, walk
from skin2urdf.recording.reading import inventory, read

MESSAGE, INDEX = 5, 7


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def stepped(data: bytes) -> list[tuple[int, int]]:
    """Kind and start of each whole record."""
    found, at = [], 0
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if at + 9 + length > len(data):
            break
        found.append((opcode, at))
        at += 9 + length
    return found


def payload(rng: np.random.Generator) -> bytes:
    """Bytes with the beginnings of records in them that are none."""
    fake = record(int(rng.choice([MESSAGE, INDEX])), b"x" * int(rng.integers(22, 40)))
    pieces = [rng.bytes(int(rng.integers(30, 60))), fake, fake[: int(rng.integers(1, 12))]]
    return b"".join(pieces[k] for k in rng.permutation(3)[: int(rng.integers(1, 4))]) + bytes(22)


@pytest.mark.parametrize("seed", range(4))
def test_records_in_a_row_are_those_that_stepping_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = record(6, b"chunk" * 8)
    for _ in range(6):
        kind = int(rng.choice([MESSAGE, INDEX]))
        run = [record(kind, payload(rng)) for _ in range(int(rng.integers(1, 300)))]
        data += b"".join(run) + record(6, b"chunk" * 8)
    data = data[: len(data) - int(rng.integers(0, 200))]
    messages, indexes = [], []
    stop = 0
    for batch in walk(memoryview(data), 0, len(data), size=64):
        messages += batch.messages.tolist()
        indexes += [at - 9 for other in batch.others for at in other.indexes.tolist()]
        stop = batch.stop
    expected = stepped(data)
    assert messages == [at for kind, at in expected if kind == MESSAGE]
    assert indexes == [at for kind, at in expected if kind == INDEX]
    assert stop <= len(data) < stop + 400


def test_one_message_alone_may_be_unlike_those_before_it(make_log: Any) -> None:
    """The first of the next batch, of another frame whose name is as long."""
    log = make_log(use_chunking=False)
    for k in range(BATCH):
        if k % 100 == 0:
            log.joints(10**18 + k * 10**6, {"elbow": np.sin(0.01 * k)})
        else:
            log.imu(10**18 + k * 10**6, [0.5 * k, 0.0, 1.0], frame="hand", topic="/imu")
    log.imu(10**18 + BATCH * 10**6, [1.0, 0.0, 0.0], frame="palm", topic="/imu")
    (su,) = read(log.close()).sus
    assert len(su.time) == BATCH - -(-BATCH // 100)


def test_messages_unlike_those_before_them_are_read_with_care(make_log: Any) -> None:
    """Cut, of another frame or byte order, between such as repeat each other."""
    log = make_log(chunk_size=60_000)
    for k in range(600):
        stamp = 10**18 + k * 10**7
        log.joints(stamp, {"elbow": np.sin(0.01 * k)})
        frame = "tip" if k % 100 == 50 else "hand"
        for topic, name in (("/imu", frame), ("/other", "arm")):
            options = {"little_endian": False} if k % 100 == 60 else {}
            log.imu(stamp, [0.5 * k, topic == "/imu", 1.0], frame=name, topic=topic, **options)
        if k % 100 == 70:
            log.raw("/other", "sensor_msgs/msg/Imu", bytes(40), stamp)
    path = log.close()
    recording = read(path)
    found = {su.name: su.specific_force[:, 0].tolist() for su in recording.sus}
    assert found["hand"] == [0.5 * k for k in range(600) if k % 100 != 50]
    assert found["tip"] == [0.5 * k for k in range(50, 600, 100)]
    assert found["arm"] == [0.5 * k for k in range(600)]
    assert [n.number for n in of_reading(recording.notes, "passed over")].count(6) == 1


@pytest.mark.parametrize("indexed", [True, False])
def test_a_hundred_topics_keep_their_messages(make_log: Any, indexed: bool) -> None:
    from mcap.writer import IndexType

    log = make_log(chunk_size=200_000, index_types=IndexType.ALL if indexed else IndexType.NONE)
    log.imu(10**18, [0.0, 0.0, 9.0], frame="su_0", topic="/skin/0")
    for k in range(24):
        stamp = 10**18 + k * 10**7
        log.joints(stamp, {"elbow": np.sin(k)})
        for su in range(100):
            log.imu(stamp + su, [k, su, 9.0], frame=f"su_{su}", topic=f"/skin/{su}")
    path = log.close()
    assert inventory(path).messages == 24 * 101 + 1
    recording = read(path)
    assert len(recording.sus) == 100
    for stream in recording.sus:
        assert (stream.specific_force[:, 1] == float(stream.name[3:])).all()
        assert stream.specific_force[-1, 0] == 23.0


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize("first", ["/skin/0", "/joint_states"])
def test_definitions_stand_where_they_are_first_needed_and_the_file_ends_far_behind(
    first: str, compression: CompressionType, make_log: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As rosbag2 writes them; the summary at the end has all of them, but comes too late."""
    monkeypatch.setattr(container, "WINDOW", 1 << 14)
    log = make_log(chunk_size=4096, compression=compression)
    topics = [first, *sorted({"/joint_states", *(f"/skin/{k}" for k in range(4))} - {first})]
    for k in range(400):
        for topic in topics:
            stamp = 1_700_000_000 * 10**9 + 10**7 * k
            if topic == "/joint_states":
                log.joints(stamp, {"elbow": 0.01 * k})
            else:
                log.imu(stamp, [0.1 * k, int(topic[-1]), 9.8], topic[-1], topic)
    recording = read(log.close())
    assert [joint.time.size for joint in recording.joints] == [400]
    assert {su.topic: su.time.size for su in recording.sus} == {f"/skin/{k}": 400 for k in range(4)}
