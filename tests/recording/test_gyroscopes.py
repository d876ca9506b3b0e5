"""Angular velocities of sensor_msgs/Imu: real ones are read, what drivers fill in is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from skin2urdf.arrays import F64
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import Recording
from skin2urdf.recording.retiming import retimed
from skin2urdf.recording.writing import write


def _turning(recording: Recording, rates: F64 | None) -> Recording:
    """The recording whose first SU has a gyroscope, and no other one."""
    first, *others = recording.sus
    return replace(recording, sus=(replace(first, angular_velocity=rates), *others))


@pytest.fixture
def rates(small: Recording) -> F64:
    rng = np.random.default_rng(5)
    return np.asarray(rng.standard_normal(small.sus[0].specific_force.shape))


def test_rates_come_back_as_they_were_written(small: Recording, rates: F64, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(_turning(small, rates), path)
    first, *others = read(path).sus
    assert first.angular_velocity is not None
    np.testing.assert_array_equal(first.angular_velocity, rates)
    np.testing.assert_array_equal(first.specific_force, small.sus[0].specific_force)
    assert all(su.angular_velocity is None for su in others)


def test_other_readers_see_the_same(small: Recording, rates: F64, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(_turning(small, rates), path)
    seen: dict[str, list[tuple[F64, float]]] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, _, raw in reader.messages():
            if connection.msgtype == "sensor_msgs/msg/Imu":
                message = reader.deserialize(raw, connection.msgtype)
                w = message.angular_velocity
                covariance = float(message.angular_velocity_covariance[0])
                seen.setdefault(connection.topic, []).append(
                    (np.array([w.x, w.y, w.z]), covariance)
                )
    first, *others = small.sus
    np.testing.assert_array_equal([w for w, _ in seen[first.topic]], rates)
    assert {c for _, c in seen[first.topic]} == {0.0}
    for su in others:
        assert {(tuple(w), c) for w, c in seen[su.topic]} == {((0.0, 0.0, 0.0), -1.0)}


@pytest.mark.parametrize("what", ["zero", "constant", "nan", "two axes"])
def test_what_drivers_fill_in_is_no_gyroscope(
    what: str, small: Recording, rates: F64, tmp_path: Path
) -> None:
    filled = np.zeros_like(rates) if what == "zero" else np.full_like(rates, 0.01)
    if what == "nan":
        filled[:] = np.nan
    elif what == "two axes":
        filled[:, :2] = rates[:, :2]
    path = tmp_path / "log.mcap"
    write(_turning(small, filled), path)
    assert read(path).sus[0].angular_velocity is None


def test_messages_that_deny_their_rates_are_believed(
    small: Recording, rates: F64, tmp_path: Path
) -> None:
    path = tmp_path / "log.mcap"
    write(_turning(small, rates), path, compression="none", chunked=False, indexed=False)
    data = bytearray(path.read_bytes())
    denied = [3, 10]
    first = small.sus[0]
    with path.open("rb") as stream:
        messages = [
            m.data for _, c, m in make_reader(stream).iter_messages() if c.topic == first.topic
        ]
    for number in denied:
        at = data.index(messages[number])
        body = data.index(rates[number].tobytes(), at)
        data[body + 24 : body + 32] = np.float64(-1.0).tobytes()
    path.write_bytes(bytes(data))
    found = read(path).sus[0].angular_velocity
    assert found is not None
    missing = np.isnan(found).all(axis=1)
    assert np.flatnonzero(missing).tolist() == denied
    np.testing.assert_array_equal(found[~missing], rates[~missing])


def test_rates_keep_to_their_samples(small: Recording, rates: F64) -> None:
    turning = _turning(small, rates)
    kept = np.arange(0, len(rates), 3)
    part = turning.sus[0].at(kept)
    assert part.angular_velocity is not None
    np.testing.assert_array_equal(part.angular_velocity, rates[kept])
    np.testing.assert_array_equal(part.time, turning.sus[0].time[kept])
    again = retimed(turning).sus[0]
    assert again.angular_velocity is not None
    assert len(again.angular_velocity) == len(again.time)


def test_a_gyroscope_that_starts_late_is_read_from_then_on(
    small: Recording, rates: F64, tmp_path: Path
) -> None:
    path = tmp_path / "log.mcap"
    late = np.array(rates)
    late[: len(late) // 2] = 0.0
    write(_turning(small, late), path, chunk_size=3000)
    found = read(path).sus[0].angular_velocity
    assert found is not None
    np.testing.assert_array_equal(found[len(late) // 2 :], late[len(late) // 2 :])
    # Blocks without any rate have none; a zero among others is a reading like any.
    assert np.nan_to_num(found[: len(late) // 2]).max() == 0.0
