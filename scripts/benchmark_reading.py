"""Time reading a log against mcap-ros2-support and rosbags, side by side in one run.

Writes a log of Imu messages on several topics with a JointState topic beside them, for every way
such a log can be stored, and reads each with all three. Ours is `skin2urdf.recording.reading.read`:
decompression, checks, arrays and the times of all samples. The others decode every message and
keep its stamp and acceleration. Figures are processor time of one core, the best of some runs.

    python scripts/benchmark_reading.py --messages 200000
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.writing import write

RATE = 500.0
STORAGES: dict[str, dict[str, object]] = {
    "zstd, indexed": {"compression": "zstd"},
    "lz4, indexed": {"compression": "lz4"},
    "none, indexed": {"compression": "none"},
    "zstd, no index": {"compression": "zstd", "indexed": False},
    "unchunked": {"chunked": False},
}


def moving_recording(messages: int, topics: int, seed: int) -> Recording:
    """Make a recording of moving SUs whose stamps jitter by 0.1 ms.

    Args:
        messages: Imu messages in total.
        topics: number of SUs, each on its own topic.
        seed: seed of the noise.

    Returns:
        The recording.
    """
    rng = np.random.default_rng(seed)
    regular = np.arange(messages // topics) / RATE
    sus = []
    for k in range(topics):
        phase = 2 * np.pi * (0.3 * regular[:, None] + np.arange(3) / 3 + k / topics)
        noise = 0.01 * rng.standard_normal((regular.size, 3))
        jittered = regular + 1e-4 * rng.random(regular.size)
        sus.append(SuStream(f"su_{k}", jittered, GRAVITY * np.sin(phase) + noise, f"/skin/su_{k}"))
    joint = JointStream("joint_1", regular[::2], np.sin(regular[::2]))
    return Recording((joint,), tuple(sus), start=1.7e9)


def read_with_mcap_ros2(path: Path) -> int:
    """Read all messages with mcap and mcap-ros2-support.

    Returns:
        Number of messages.
    """
    from mcap_ros2.reader import read_ros2_messages

    kept = []
    for message in read_ros2_messages(str(path)):
        ros = message.ros_msg
        if hasattr(ros, "linear_acceleration"):
            vector = ros.linear_acceleration
            kept.append((ros.header.stamp.sec, vector.x, vector.y, vector.z))
        else:
            kept.append((ros.header.stamp.sec, *ros.position))
    return len(kept)


def read_with_rosbags(path: Path) -> int:
    """Read all messages with rosbags.

    Returns:
        Number of messages.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    kept = []
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, _, raw in reader.messages():
            ros: Any = reader.deserialize(raw, connection.msgtype)
            if hasattr(ros, "linear_acceleration"):
                vector = ros.linear_acceleration
                kept.append((ros.header.stamp.sec, vector.x, vector.y, vector.z))
            else:
                kept.append((ros.header.stamp.sec, *ros.position))
    return len(kept)


def seconds(job: Callable[[], object], repeats: int) -> float:
    """Return the least processor time of some runs [s]."""
    best = float("inf")
    for _ in range(repeats):
        begin = time.process_time()
        job()
        best = min(best, time.process_time() - begin)
    return best


def main() -> None:
    """Run the comparison and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--messages", type=int, default=200_000, help="Imu messages in the log")
    parser.add_argument("--topics", type=int, default=8, help="topics they are spread over")
    parser.add_argument("--repeats", type=int, default=3, help="runs of ours; the best counts")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise")
    parser.add_argument(
        "--only-ours", action="store_true", help="leave out the other readers, which are slow"
    )
    options = parser.parse_args()
    recording = moving_recording(options.messages, options.topics, options.seed)
    total = sum(su.time.size for su in recording.sus) + recording.joints[0].time.size
    print(f"{total} messages on {options.topics + 1} topics; million messages per second")
    print(
        f"{'storage':16} {'skin2urdf':>9} {'with SHA-256':>12} {'mcap_ros2':>10} "
        f"{'rosbags':>8} {'ratios':>14}"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        for name, storage in STORAGES.items():
            write(recording, path, **storage)  # type: ignore[arg-type]
            # The other readers take no digest of the file, so ours is left out and shown apart.
            bare = seconds(lambda: read(path, with_digest=False), options.repeats)
            whole = total / seconds(lambda: read(path), options.repeats) / 1e6
            ours = total / bare / 1e6
            if options.only_ours:
                print(f"{name:16} {ours:9.2f} {whole:12.2f}")
                continue
            mcap = total / seconds(lambda: read_with_mcap_ros2(path), 1) / 1e6
            rosbags = total / seconds(lambda: read_with_rosbags(path), 1) / 1e6
            print(
                f"{name:16} {ours:9.2f} {whole:12.2f} {mcap:10.3f} {rosbags:8.3f} "
                f"{ours / mcap:6.0f}x {ours / rosbags:5.0f}x"
            )


if __name__ == "__main__":
    main()
