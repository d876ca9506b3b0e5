from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from skin2urdf.recording.records import JointStream, Recording, SuStream

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
STAMP_TYPE = TYPES["builtin_interfaces/msg/Time"]
HEADER_TYPE = TYPES["std_msgs/msg/Header"]
JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"


def header(stamp: int, frame: str) -> Any:
    return HEADER_TYPE(STAMP_TYPE(stamp // 10**9, stamp % 10**9), frame)


def vector(xyz: Any) -> Any:
    return TYPES["geometry_msgs/msg/Vector3"](*(float(v) for v in xyz))


class RosLog:
    """Writes any messages through rosbags' serializer and mcap's writer."""

    def __init__(self, path: Path, profile: str = "ros2", **options: Any) -> None:
        self.path = path
        self.stream = path.open("wb")
        self._writer = Writer(self.stream, **options)
        self._writer.start(profile=profile)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def channel(self, topic: str, ros_type: str, encoding: str = "cdr") -> int:
        """Return the id of a topic's channel, registered at first use."""
        if topic not in self._channels:
            if ros_type not in self._schemas:
                text = STORE.generate_msgdef(ros_type, ros_version=2)[0].encode()
                self._schemas[ros_type] = self._writer.register_schema(ros_type, "ros2msg", text)
            self._channels[topic] = self._writer.register_channel(
                topic, encoding, self._schemas[ros_type]
            )
        return self._channels[topic]

    def raw(self, topic: str, ros_type: str, payload: bytes, log_time: int) -> None:
        """Add a payload as it is."""
        self._writer.add_message(self.channel(topic, ros_type), log_time, payload, log_time)

    def add(
        self, topic: str, message: Any, log_time: int | None = None, *, little_endian: bool = True
    ) -> None:
        """Add a message; its stamp is the log time unless given."""
        payload = bytes(
            STORE.serialize_cdr(message, message.__msgtype__, little_endian=little_endian)
        )
        stamp = message.header.stamp
        at = stamp.sec * 10**9 + stamp.nanosec if log_time is None else log_time
        self.raw(topic, message.__msgtype__, payload, at)

    def joints(
        self, stamp: int, positions: dict[str, float], topic: str = "/joint_states", **options: Any
    ) -> None:
        """Add a JointState message."""
        values = np.array(list(positions.values()), dtype=np.float64)
        empty = np.zeros(0)
        message = TYPES[JOINT_STATE](header(stamp, ""), list(positions), values, values, empty)
        self.add(topic, message, **options)

    def imu(
        self, stamp: int, force: Any, frame: str = "su", topic: str = "/imu", **options: Any
    ) -> None:
        """Add an Imu message whose other fields are not zero."""
        quaternion = TYPES["geometry_msgs/msg/Quaternion"](0.1, 0.2, 0.3, 0.4)
        covariance = np.arange(9.0)
        message = TYPES[IMU](
            header(stamp, frame),
            quaternion,
            covariance,
            vector([5.0, 6.0, 7.0]),
            covariance,
            vector(force),
            covariance,
        )
        self.add(topic, message, **options)

    def close(self) -> Path:
        """Finish the file and return its path."""
        self._writer.finish()
        self.stream.close()
        return self.path


@pytest.fixture
def ros_log(tmp_path: Path) -> Iterator[RosLog]:
    log = RosLog(tmp_path / "log.mcap")
    yield log
    log.stream.close()


@pytest.fixture
def ros_types() -> Any:
    return TYPES


@pytest.fixture
def make_log(tmp_path: Path) -> Any:
    def make(name: str = "made.mcap", **options: Any) -> RosLog:
        return RosLog(tmp_path / name, **options)

    return make


@pytest.fixture(scope="session")
def no_compression() -> CompressionType:
    return CompressionType.NONE


@pytest.fixture(scope="session")
def small() -> Recording:
    """Two joints at 100 Hz on their own times, three SUs at 200 Hz."""
    rng = np.random.default_rng(7)
    fast = np.arange(400) / 200.0
    joints = (
        JointStream("elbow", np.arange(200) / 100.0, rng.standard_normal(200)),
        JointStream("wrist", 0.003 + np.arange(190) / 100.0, rng.standard_normal(190)),
    )
    sus = tuple(
        SuStream(f"su_{k}", fast + 0.001 * k, rng.standard_normal((400, 3)), f"/skin/{k}")
        for k in range(3)
    )
    return Recording(joints, sus, start=1.7e9)
