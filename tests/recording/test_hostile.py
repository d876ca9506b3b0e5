"""Logs that are huge, forged or changed while they are read."""

from __future__ import annotations

import os
import shutil
import struct
import time
import tracemalloc
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import zstandard

from skin2urdf.errors import UnreadableInputError
from skin2urdf.notes import of_reading
from skin2urdf.recording.inputs import listed_files, opened
from skin2urdf.recording.naming import printable, writable
from skin2urdf.recording.reading import inventory, read
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.writing import write

MAGIC = b"\x89MCAP0\r\n"
EPOCH = 1_700_000_000 * 10**9
MS = 10**6
IMU = "sensor_msgs/msg/Imu"


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def chunk(data: bytes, compression: str = "", size: int | None = None) -> bytes:
    head = struct.pack("<QQQI", 0, 0, len(data) if size is None else size, 0)
    return record(6, head + text(compression) + struct.pack("<Q", len(data)) + data)


def inserted(path: Path, records: bytes) -> Path:
    """Put records behind the header of a log."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<Q", data, len(MAGIC) + 1)
    at = len(MAGIC) + 9 + length
    path.write_bytes(data[:at] + records + data[at:])
    return path


@pytest.fixture
def log(small: Recording, tmp_path: Path) -> Path:
    path = tmp_path / "log.mcap"
    write(small, path, chunk_size=20_000)
    return path


def peak_of_reading(path: Path) -> tuple[Recording, int]:
    """A log, and the most memory that reading it took [byte]."""
    tracemalloc.start()
    try:
        recording = read(path)
        return recording, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("claim", [1000, 100 << 20, 3 << 30])
def test_a_chunk_takes_no_more_memory_than_it_may(
    compression: str, claim: int, log: Path, small: Recording
) -> None:
    """100 MB of zeros, packed into some kilobytes, with a claim that is true or not."""
    zeros = bytes(100 << 20)
    pack = lz4.frame.compress if compression == "lz4" else zstandard.compress
    inserted(log, chunk(pack(zeros), compression, claim))
    recording, peak = peak_of_reading(log)
    assert [su.time.size for su in recording.sus] == [su.time.size for su in small.sus]
    assert peak < (300 << 20 if claim == len(zeros) else 60 << 20)
    if claim != len(zeros):
        assert of_reading(recording.notes, "damaged")


def test_attachments_and_records_larger_than_a_window_are_passed_over(
    log: Path, small: Recording
) -> None:
    inserted(log, record(9, bytes(80 << 20)))
    recording, peak = peak_of_reading(log)
    assert [su.time.size for su in recording.sus] == [su.time.size for su in small.sus]
    assert peak < 150 << 20


def test_a_chunk_larger_than_a_window_is_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    path = tmp_path / "log.mcap"
    n = 70_000
    t = np.arange(n) / 1000.0
    sus = (SuStream("a" * 200, t, rng.standard_normal((n, 3))),)
    write(Recording((JointStream("j", t[::10], t[::10]),), sus, start=1.7e9), path,
          compression="none", chunk_size=1 << 30)  # fmt: skip
    assert path.stat().st_size > 36 << 20
    recording = read(path)
    assert np.array_equal(recording.sus[0].specific_force, sus[0].specific_force)
    assert not of_reading(recording.notes, "cut short")


@pytest.mark.parametrize("indexes", [0, 2])
def test_empty_chunks_take_time_in_proportion(indexes: int, log: Path) -> None:
    """In time with the square of their number, as by a copy of what follows each, minutes."""
    index = record(7, struct.pack("<HI", 7, 0)) * indexes
    inserted(log, (chunk(b"") + index) * 100_000)
    begin = time.process_time()
    read(log)
    assert time.process_time() - begin < 15.0


def test_many_channels_take_time_in_proportion(log: Path) -> None:
    schema = record(3, struct.pack("<H", 9) + text(IMU) + text("ros2msg") + text(""))
    channels = b"".join(
        record(4, struct.pack("<HH", k, 9) + text(f"/su_{k}") + text("cdr") + bytes(4))
        for k in range(100, 20_000)
    )
    payload = b"\0\1\0\0" + bytes(8) + struct.pack("<I", 1) + bytes(4) + bytes(37 * 8)
    messages = b"".join(
        record(5, struct.pack("<HIQQ", k, 0, EPOCH, EPOCH) + payload) for k in range(100, 20_000)
    )
    inserted(log, schema + channels + messages)
    begin = time.process_time()
    recording = read(log)
    assert len(inventory(log).topics) == 19_904
    assert time.process_time() - begin < 15.0
    assert len(recording.sus) == 3
    assert sum(len(note.words) for note in recording.notes) < 3000


def test_messages_with_a_million_names_are_passed_over(ros_log: Any) -> None:
    for k in range(40):
        ros_log.joints(EPOCH + 10 * MS * k, {"joint": 0.1 * k})
        ros_log.imu(EPOCH + 10 * MS * k, [0, 0, 9.81])
    names = b"".join(struct.pack("<I", 8) + b"%07d\0" % k for k in range(10**6))
    head = b"\0\1\0\0" + bytes(8) + struct.pack("<I", 1) + bytes(4)
    payload = head + struct.pack("<I", 10**6) + names + struct.pack("<I", 10**6) + bytes(8 * 10**6)
    ros_log.raw("/joint_states", "sensor_msgs/msg/JointState", payload, EPOCH)
    path = ros_log.close()
    begin = time.process_time()
    recording = read(path)
    assert time.process_time() - begin < 5.0
    assert [joint.name for joint in recording.joints] == ["joint"]
    assert [note.number for note in of_reading(recording.notes, "passed over")] == [1]


def test_a_log_that_is_shortened_while_it_is_read_is_refused(log: Path) -> None:
    with opened(log) as file:
        os.truncate(log, 1000)
        assert file.read(0, 1000).size == 1000
        with pytest.raises(UnreadableInputError) as caught:
            file.read(500, 10_000)
        assert caught.value.why == "shortened"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.mcap"
    os.mkfifo(pipe)
    with pytest.raises(UnreadableInputError) as caught:
        read(pipe)
    assert caught.value.why == "no regular file"


def test_names_that_would_act_on_a_terminal_are_escaped(make_log: Any) -> None:
    log = make_log()
    for k in range(60):
        log.joints(EPOCH + 10 * MS * k, {"a\x1b[31m": 0.1 * k, "universe": k, " ": k})
        log.imu(EPOCH + 10 * MS * k, [0, 0, 9.81], "s\nerror: forged", "/x\x1b]0;t\x07")
        log.imu(EPOCH + 10 * MS * k, [0, 0, 9.81], "universe", "/y")
    path = log.close()
    recording = read(path)
    listed = inventory(path)
    assert [j.name for j in recording.joints] == ["a\\x1b[31m", "joint", "universe_joint"]
    assert [s.name for s in recording.sus] == ["s\\nerror: forged", "universe_su"]
    said = [note.words for note in recording.notes]
    shown = [*said, *(t.name for t in listed.topics), *(s.topic for s in recording.sus)]
    assert all(line.isprintable() for line in shown)
    renamed = [note.sources for note in of_reading(recording.notes, "renamed")]
    assert ("universe", "universe_joint") in renamed
    assert ("universe", "universe_su") in renamed


def test_plain_names_stay() -> None:
    assert printable("Gelenk_ä/π 1") == "Gelenk_ä/π 1"
    assert printable("\u202eab\x9b\0") == "\\u202eab\\x9b\\x00"
    assert writable(["universe", "universe_joint"], "joint")[0] == [
        "universe_joint_2",
        "universe_joint",
    ]


def split(log: Path, small: Recording, folder: Path) -> list[Path]:
    """A bag of three parts of which the names are in another order than the times."""
    folder.mkdir()
    parts = []
    for k, name in enumerate(["z_0", "b_1", "a_2"]):
        part = folder / f"{name}.mcap"
        write(Recording(small.joints, small.sus, start=small.start + 10 * k), part)
        parts.append(part)
    shutil.copy(log, folder / "another_run.mcap")
    return parts


def describe(folder: Path, names: list[str]) -> None:
    lines = "".join(f"    - {name}\n" for name in names)
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{lines}"
        "  duration:\n    nanoseconds: 1\n"
    )


def test_metadata_says_which_files_are_parts_and_in_which_order(
    log: Path, small: Recording, tmp_path: Path
) -> None:
    folder = tmp_path / "bag"
    parts = split(log, small, folder)
    describe(folder, [part.name for part in parts])
    recording = read(folder)
    assert [su.time.size for su in recording.sus] == [3 * su.time.size for su in small.sus]
    whole = np.concatenate([small.sus[0].specific_force] * 3)
    assert np.array_equal(recording.sus[0].specific_force, whole)
    (note,) = of_reading(recording.notes, "part left out")
    assert note.sources == ("another_run.mcap",)


def test_parts_that_are_empty_or_missing_are_said(
    log: Path, small: Recording, tmp_path: Path
) -> None:
    folder = tmp_path / "bag"
    parts = split(log, small, folder)
    describe(folder, [*(part.name for part in parts), "gone_3.mcap"])
    parts[1].write_bytes(b"")
    for notes in (read(folder).notes, inventory(folder).notes):
        left, missing = (of_reading(notes, kind) for kind in ("part left out", "part missing"))
        assert ("b_1.mcap",) in [note.sources for note in left]
        assert [note.sources for note in missing] == [("gone_3.mcap",)]
    for part in folder.glob("*.mcap"):
        part.write_bytes(b"")
    with pytest.raises(UnreadableInputError) as caught:
        read(folder)
    assert caught.value.why == "empty"


@pytest.mark.parametrize(
    ("listing", "names"),
    [
        ("relative_file_paths:\n  - a.mcap\n  - 'b c.mcap'\n  more: 1\n", ["a.mcap", "b c.mcap"]),
        ("  relative_file_paths: [a.mcap, \"b.mcap\"]\n", ["a.mcap", "b.mcap"]),
        ("  relative_file_paths:\n    - x/a.mcap", ["x/a.mcap"]),
        ("relative_file_paths:\n", []),
        ("nothing: 1\n", []),
    ],
)  # fmt: skip
def test_lists_of_files_are_read_as_rosbag2_writes_them(listing: str, names: list[str]) -> None:
    assert listed_files(listing) == names
