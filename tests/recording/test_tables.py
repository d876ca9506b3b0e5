"""Tables are logs: columns with units, empty cells, several files, and what is wrong with them."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skin2urdf.cli.main import main
from skin2urdf.errors import Skin2UrdfError, UnreadableInputError
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.notes import of_reading
from skin2urdf.recording.reading import inventory, read

COUNT = 40
TIME = 0.01 * np.arange(COUNT)
RNG = np.random.default_rng(2)
ANGLE, FORCE = RNG.standard_normal(COUNT), RNG.standard_normal((COUNT, 3))
HEADER = "time [s],elbow [rad],hand.x [m/s^2],hand.y [m/s^2],hand.z [m/s^2]"


def lines(columns: list[np.ndarray], separator: str = ",") -> str:
    rows = np.column_stack(columns)
    return "".join(separator.join(repr(float(v)) for v in row) + "\n" for row in rows)


def table(path: Path, header: str, columns: list[np.ndarray], separator: str = ",") -> Path:
    path.write_text(f"{header}\n{lines(columns, separator)}")
    return path


def check(path: Path) -> None:
    recording = read(path)
    (joint,), (su,) = recording.joints, recording.sus
    assert (joint.name, su.name) == ("elbow", "hand")
    np.testing.assert_allclose(joint.position, ANGLE, rtol=1e-9)
    np.testing.assert_allclose(su.specific_force, FORCE, rtol=1e-9)
    np.testing.assert_allclose(su.time, TIME, atol=1e-9)


@pytest.mark.parametrize(
    ("header", "factors"),
    [
        (HEADER, (1, 1, 1)),
        (
            "elbow [deg],t [ms],hand.Z [g],hand.X [mg],hand.y [m/s²]",
            (180 / np.pi, 1e3, 1 / GRAVITY, 1e3 / GRAVITY, 1),
        ),
        ("timestamp (us),elbow (deg),hand.x (g),hand.y (g),hand.z (g)", None),
    ],
)
def test_units_are_those_of_the_headers(
    header: str, factors: tuple[float, ...] | None, tmp_path: Path
) -> None:
    columns = [TIME, ANGLE, *FORCE.T]
    if factors is None:
        columns = [1e6 * TIME, np.degrees(ANGLE), *(FORCE / GRAVITY).T]
    elif factors[0] != 1:
        columns = [ANGLE, TIME, FORCE[:, 2], FORCE[:, 0], FORCE[:, 1]]
        columns = [c * f for c, f in zip(columns, factors, strict=True)]
    check(table(tmp_path / "log.csv", header, columns))


def test_decimal_commas_byte_order_marks_and_quotes(tmp_path: Path) -> None:
    text = lines([1e9 * TIME, ANGLE, *FORCE.T], ";").replace(".", ",")
    header = 'time [ns];"elbow [rad]";hand.x [m/s^2];hand.y [m/s^2];hand.z [m/s^2]'
    path = tmp_path / "log.csv"
    path.write_text(f"\ufeff{header}\r\n{text}", encoding="utf-8")
    check(path)


def test_empty_cells_are_samples_that_were_not_taken(tmp_path: Path) -> None:
    rows = []
    for k in range(COUNT):
        rows += [f"{TIME[k]},{float(ANGLE[k])!r},,,"]
        rows += [f"{TIME[k]},,{','.join(repr(float(v)) for v in FORCE[k])}"]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([HEADER, *rows]))
    check(path)
    assert {(t.ros_type, t.messages) for t in inventory(path).topics} == {
        ("sensor_msgs/msg/JointState", COUNT),
        ("sensor_msgs/msg/Imu", COUNT),
    }


def test_an_su_without_a_single_number_is_there_without_readings(tmp_path: Path) -> None:
    rows = [f"{0.01 * k},{0.1 * k},nan,nan,nan,0,0,{9 + 0.01 * k}" for k in range(30)]
    head = "time [s],j [rad]," + ",".join(
        f"{su}.{axis} [m/s^2]" for su in ("broken", "works") for axis in "xyz"
    )
    table = tmp_path / "log.csv"
    table.write_text("\n".join([head, *rows]))
    recording = read(table)
    assert {su.name: su.time.size for su in recording.sus} == {"broken": 0, "works": 30}


def test_a_folder_of_tables_is_one_log(tmp_path: Path) -> None:
    table(tmp_path / "joints.csv", "time [s],elbow [rad]", [TIME, ANGLE])
    table(tmp_path / "hand.tsv", "time [s]\tskin.x [g]\tskin.y [g]\tskin.z [g]",
          [TIME, *FORCE.T / GRAVITY], "\t")  # fmt: skip
    recording = read(tmp_path)
    assert [su.topic for su in recording.sus] == ["/hand/skin"]
    np.testing.assert_allclose(recording.sus[0].specific_force, FORCE, rtol=1e-9)


def test_parquet_is_read_like_csv(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    names = HEADER.split(",")
    columns = dict(zip(names, [TIME, ANGLE, *FORCE.T], strict=True))
    pq.write_table(pa.table(columns), tmp_path / "log.parquet", row_group_size=16)
    check(tmp_path / "log.parquet")
    stamped = {"time": pa.array((1e9 * TIME).astype("datetime64[ns]")), "side": ["a"] * COUNT}
    stamped |= {name: columns[name] for name in names[1:]}
    pq.write_table(pa.table(stamped), tmp_path / "stamped.parquet")
    check(tmp_path / "stamped.parquet")
    data = bytearray((tmp_path / "log.parquet").read_bytes())
    for at in range(8, len(data) - 8, 97):
        data[at] ^= 0x55
    (tmp_path / "damaged.parquet").write_bytes(data)
    with pytest.raises(UnreadableInputError):
        read(tmp_path / "damaged.parquet")


def test_what_is_no_number_or_no_time_is_left_out_and_said(tmp_path: Path) -> None:
    path = table(tmp_path / "log.csv", f"{HEADER},colour\x1b[2J", [TIME, ANGLE, *FORCE.T, TIME])
    with path.open("a") as stream:
        stream.write("later,0,0,0,0,0\n-5,0,0,0,0,0\n1e300,0,0,0,0,0\n1,2\n9,x,0,0,0,0\n")
    recording = read(path)
    assert len(recording.joints[0].time) == COUNT
    assert len(recording.sus[0].time) == COUNT + 1
    assert [note.number for note in of_reading(recording.notes, "bad cells")] == [2]
    assert [note.number for note in of_reading(recording.notes, "bad rows")] == [4]
    (unused,) = of_reading(recording.notes, "unused columns")
    assert "colour\\x1b[2J" in unused.words


@pytest.mark.parametrize(
    ("header", "why"),
    [
        ("elbow [rad],hand.x [g]", "no times"),
        ("time,elbow [rad]", "no unit"),
        ("time [s],t [s],elbow [rad]", "several times"),
        ("time [s],hand.x [g],hand.z [g]", "missing axis"),
        ("time [s],elbow [rad],elbow [deg]", "same column"),
        ("time [s],elbow", "nothing usable"),
        ("", "no rows"),
    ],
)
def test_other_headers_are_refused_with_the_next_step(
    header: str, why: str, tmp_path: Path
) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{header}\n0,0,0,0\n")
    with pytest.raises(UnreadableInputError) as caught:
        read(path)
    assert caught.value.why == why
    assert "time [s]" in caught.value.remedy


def test_endless_lines_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(b"0" * (5 << 20))
    with pytest.raises(UnreadableInputError) as caught:
        read(path)
    assert caught.value.why == "long line"


def test_a_long_cell_takes_no_more_room_than_it_has(tmp_path: Path) -> None:
    """An array of text has room for its longest one in every cell."""
    path = table(tmp_path / "log.csv", HEADER, [TIME, ANGLE, *FORCE.T])
    with path.open("a") as stream:
        stream.write(f"9,0,{'0.' + '1' * 100_000},0,0\n")
    tracemalloc.start()
    try:
        recording = read(path)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 64 << 20
    assert [note.number for note in of_reading(recording.notes, "bad cells")] == [1]
    assert len(recording.joints[0].time) == len(recording.sus[0].time) + 1 == COUNT + 1


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(text=st.text(max_size=300), header=st.booleans())
def test_any_text_raises_only_our_errors(text: str, header: bool, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{HEADER}\n{text}" if header else text or "x", errors="replace")
    with pytest.raises(Skin2UrdfError) as caught:
        read(path)
    assert caught.value.remedy


def test_a_table_is_converted_in_the_order_of_its_times(tmp_path: Path) -> None:
    path = table(tmp_path / "log.csv", HEADER, [TIME, ANGLE, *FORCE.T])
    assert main(["convert", str(path), str(tmp_path / "log.mcap"), "--quiet"]) == 0
    check(tmp_path / "log.mcap")
