"""Write a recording as a ROS 2 log that any reader of MCAP opens."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.errors import UsageError
from skin2urdf.recording.encode import imu_payloads, joint_state_payloads
from skin2urdf.recording.gather import U8
from skin2urdf.recording.messages import IMU, JOINT_STATE
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.recording.schemas import schema_text

if TYPE_CHECKING:
    from mcap.writer import Writer

Compression: TypeAlias = Literal["zstd", "lz4", "none"]

# header.stamp holds seconds in a signed 32-bit number.
LATEST_STAMP = (2**31 - 1) * 1_000_000_000
# Messages whose order is worked out at once; bounds the memory of a long recording.
SLICE = 1 << 16


class _Channel(NamedTuple):
    """Messages of one stream: topic, type, (N,) stamps [ns] and (N, L) payloads."""

    topic: str
    ros_type: str
    stamp: Int
    payload: U8


def write(
    recording: Recording,
    path: str | Path,
    *,
    compression: Compression = "zstd",
    chunked: bool = True,
    indexed: bool = True,
    chunk_size: int = 1024 * 1024,
    joint_topic: str = "/joint_states",
    joint_order: Sequence[str] | None = None,
    tell: Callable[[float], None] = lambda _: None,
) -> None:
    """Write a recording as an MCAP file of profile "ros2".

    Joints that share their times go into one JointState message per sample; every SU goes out as
    Imu messages on its topic, frame_id being its name. Stamps and log times are
    ``recording.start`` plus the time of the sample. The file appears only once it is complete.

    Args:
        recording: what to write.
        path: file to write; overwritten if it exists.
        compression: compression of the chunks.
        chunked: whether messages are gathered in chunks.
        indexed: whether message and chunk indexes are written.
        chunk_size: bytes of a chunk before compression.
        joint_topic: topic of the joint states.
        joint_order: all joint names in the order they have in messages; as recorded if None.
        tell: told the share of the work that is done.

    Raises:
        UsageError: an argument does not fit the recording, or the file can not be written.
    """
    channels = list(_channels(recording, joint_topic, joint_order))
    with mcap_writer(
        Path(path), compression, chunked=chunked, indexed=indexed, chunk_size=chunk_size
    ) as writer:
        _write_messages(writer, channels, tell)


@contextlib.contextmanager
def mcap_writer(
    target: Path,
    compression: Compression,
    *,
    chunked: bool = True,
    indexed: bool = True,
    chunk_size: int = 1024 * 1024,
) -> Iterator[Writer]:
    """A writer of an MCAP file of profile "ros2", which appears only once it is complete.

    Args:
        target: file to write; overwritten if it exists.
        compression: compression of the chunks.
        chunked: whether messages are gathered in chunks.
        indexed: whether message and chunk indexes are written.
        chunk_size: bytes of a chunk before compression.

    Raises:
        UsageError: the compression is unknown, or the file can not be written.
    """
    from mcap.writer import CompressionType, IndexType, Writer

    compressions = {
        "zstd": CompressionType.ZSTD,
        "lz4": CompressionType.LZ4,
        "none": CompressionType.NONE,
    }
    if compression not in compressions:
        raise UsageError(
            f"unknown compression {compression!r}",
            f"choose one of {', '.join(compressions)}",
            "compression",
        )
    unfinished = target.with_name(f"{target.name}.part")
    try:
        with unfinished.open("wb") as stream:
            writer = Writer(
                stream,
                chunk_size=chunk_size,
                compression=compressions[compression],
                index_types=IndexType.ALL if indexed else IndexType.NONE,
                use_chunking=chunked,
            )
            writer.start(profile="ros2", library="skin2urdf")
            yield writer
            writer.finish()
        unfinished.replace(target)
    except OSError as error:
        raise UsageError(
            f"{target} can not be written: {error.strerror}",
            "check that the folder exists and that you may write there",
            str(target),
        ) from error
    finally:
        if unfinished.is_file():
            unfinished.unlink()


def _write_messages(
    writer: Writer, channels: Sequence[_Channel], tell: Callable[[float], None]
) -> None:
    """Register the channels and add all messages in the order of their stamps."""
    schemas: dict[str, int] = {}
    topics: dict[str, int] = {}
    ids = []
    for channel in channels:
        if channel.ros_type not in schemas:
            schemas[channel.ros_type] = writer.register_schema(
                channel.ros_type, "ros2msg", schema_text(channel.ros_type)
            )
        if channel.topic not in topics:
            topics[channel.topic] = writer.register_channel(
                channel.topic, "cdr", schemas[channel.ros_type], {"offered_qos_profiles": ""}
            )
        ids.append(topics[channel.topic])
    if not channels:
        return
    stamps = np.concatenate([channel.stamp for channel in channels])
    sizes = [channel.stamp.size for channel in channels]
    source = np.repeat(np.arange(len(channels)), sizes)
    row = np.concatenate([np.arange(size) for size in sizes])
    order = np.argsort(stamps, kind="stable")
    payloads = [channel.payload.reshape(-1).data for channel in channels]
    lengths = [channel.payload.shape[1] for channel in channels]
    for begin in range(0, order.size, SLICE):
        tell(begin / order.size)
        part = order[begin : begin + SLICE]
        for time, k, n in zip(
            stamps[part].tolist(), source[part].tolist(), row[part].tolist(), strict=True
        ):
            size = lengths[k]
            data = payloads[k][n * size : (n + 1) * size]
            writer.add_message(ids[k], time, data, time, n)


def _channels(
    recording: Recording, joint_topic: str, joint_order: Sequence[str] | None
) -> Iterator[_Channel]:
    """Turn the streams of a recording into messages."""
    start = round(recording.start * 1_000_000_000)
    joints = list(recording.joints)
    if joint_order is not None:
        by_name = {joint.name: joint for joint in joints}
        if sorted(joint_order) != sorted(by_name):
            raise UsageError(
                "joint_order names other joints than the recording has",
                f"give an order of {', '.join(sorted(by_name))}",
                "joint_order",
            )
        joints = [by_name[name] for name in joint_order]
    for group in _sharing_times(joints):
        stamp = _stamps(group[0].time, start)
        position = np.stack([joint.position for joint in group], axis=1)
        names = [joint.name for joint in group]
        # A message has the efforts of all of its joints or of none.
        none = np.full(stamp.size, np.nan)
        efforts = [none if joint.effort is None else joint.effort for joint in group]
        measured = any(joint.effort is not None for joint in group)
        effort = np.stack(efforts, axis=1) if measured else None
        payload = joint_state_payloads(stamp, names, position, effort)
        yield _Channel(joint_topic, JOINT_STATE, stamp, payload)
    for su in recording.sus:
        topic = su.topic or f"/{su.name}"
        if topic == joint_topic:
            raise UsageError(
                f"the SU {su.name} is on {topic}, the topic of the joint states",
                "choose another joint_topic",
                "joint_topic",
            )
        stamp = _stamps(su.time, start)
        payload = imu_payloads(stamp, su.name, su.specific_force, su.angular_velocity)
        yield _Channel(topic, IMU, stamp, payload)


def _sharing_times(joints: Sequence[JointStream]) -> list[list[JointStream]]:
    """Group joints by their times."""
    groups: list[list[JointStream]] = []
    for joint in joints:
        for group in groups:
            times = group[0].time
            if times is joint.time or np.array_equal(times, joint.time):
                group.append(joint)
                break
        else:
            groups.append([joint])
    return groups


def _stamps(time: F64, start: int) -> Int:
    """Return (N,) stamps [ns] of (N,) times [s] since ``start`` [ns]."""
    stamp = start + np.rint(time * 1e9).astype(np.int64)
    if stamp.size and not (int(stamp.min()) >= 0 and int(stamp.max()) <= LATEST_STAMP):
        raise UsageError(
            "a ROS time stamp holds times from 1970 to 2038 only",
            "set the start of the recording so that all its times lie between",
            "start",
        )
    return stamp
