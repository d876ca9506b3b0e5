"""Time reading a log against mcap-ros2-support and rosbags, side by side in one run.

Writes logs of Imu messages on several topics with a JointState topic beside them, for every way
such a log can be stored, and reads each with all three. Ours is `skin2urdf.recording.reading.read`:
decompression, checks, arrays and the times of all samples. The others decode each message and keep
its stamp and acceleration; they read the first messages only, as each takes them as long as any,
and opening the log does not count for them.
Figures are messages per second of processor time, of all cores together, the best of some runs that
take turns; and, as ours unpacks chunks in other threads, of the time that passed.

    python scripts/benchmark_reading.py --messages 1000000
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.writing import write

RATE = 500.0
TOPICS = (8, 150, 999)
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


def read_with_mcap_ros2(path: Path) -> Iterator[tuple[float, ...]]:
    """Stamps and values of messages as mcap and mcap-ros2-support decode them."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for *_, ros in reader.iter_decoded_messages():
            yield kept(ros)


def read_with_rosbags(path: Path) -> Iterator[tuple[float, ...]]:
    """Stamps and values of messages as rosbags decodes them."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, _, raw in reader.messages():
            yield kept(reader.deserialize(raw, connection.msgtype))


def kept(ros: Any) -> tuple[float, ...]:
    """What is kept of a decoded message."""
    if hasattr(ros, "linear_acceleration"):
        vector = ros.linear_acceleration
        return (ros.header.stamp.sec, vector.x, vector.y, vector.z)
    return (ros.header.stamp.sec, *ros.position)


class Rate(NamedTuple):
    """Messages per second of processor time, and of the time that passed."""

    processor: float
    passed: float


def rate(job: Callable[[], object], count: int) -> Rate:
    """Rates of one run of a job on so many messages."""
    begin, passed = time.process_time(), time.perf_counter()
    job()
    return Rate(count / (time.process_time() - begin), count / (time.perf_counter() - passed))


def rate_of_some(messages: Iterator[tuple[float, ...]], most: int) -> Rate:
    """Rates of a reader from its second message on, so that opening the log does not count."""
    next(messages)
    return rate(lambda: list(islice(messages, most)), most)


def best(rates: list[Rate]) -> Rate:
    """The best of some runs."""
    return Rate(*(max(values) for values in zip(*rates, strict=True)))


def rows(path: Path, total: int, options: argparse.Namespace) -> dict[str, Rate]:
    """Rates of all readers on one log."""
    jobs: dict[str, Callable[[], Rate]] = {
        "ours": lambda: rate(lambda: read(path, with_digest=False), total),
        # The other readers take no digest of the file, so ours is shown with one apart.
        "digest": lambda: rate(lambda: read(path), total),
    }
    if not options.only_ours:
        most = min(options.others, total - 1)
        jobs["mcap"] = lambda: rate_of_some(read_with_mcap_ros2(path), most)
        jobs["rosbags"] = lambda: rate_of_some(read_with_rosbags(path), most)
    runs: dict[str, list[Rate]] = {name: [] for name in jobs}
    for _ in range(options.repeats):
        for name, job in jobs.items():
            runs[name].append(job())
    return {name: best(found) for name, found in runs.items()}


def main() -> None:
    """Run the comparison and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--messages", type=int, default=1_000_000, help="Imu messages in a log")
    parser.add_argument(
        "--topics", type=int, nargs="+", default=TOPICS, help="Imu topics of each log"
    )
    parser.add_argument("--others", type=int, default=50_000, help="messages that others read")
    parser.add_argument("--repeats", type=int, default=3, help="runs; the best counts")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise")
    parser.add_argument(
        "--storages", nargs="+", choices=STORAGES, default=list(STORAGES), metavar="STORAGE",
        help=f"any of {', '.join(STORAGES)}",
    )  # fmt: skip
    parser.add_argument(
        "--only-ours", action="store_true", help="leave out the other readers, which are slow"
    )
    options = parser.parse_args()
    print(f"{options.messages} Imu messages; ratios first, then million messages per second")
    print(
        f"{'topics':>6} {'storage':14} {'to mcap_ros2':>12} {'passed':>6} {'to rosbags':>10} "
        f"{'passed':>6} {'skin2urdf':>9} {'SHA-256':>7} {'passed':>6} {'mcap_ros2':>9} "
        f"{'rosbags':>7}"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        for topics in options.topics:
            recording = moving_recording(options.messages, topics, options.seed)
            total = sum(su.time.size for su in recording.sus) + recording.joints[0].time.size
            for name in options.storages:
                write(recording, path, **STORAGES[name])  # type: ignore[arg-type]
                found = rows(path, total, options)
                ours = found["ours"]
                ratios = [
                    f"{mine / his:.0f}x"
                    for other in ("mcap", "rosbags")
                    for mine, his in zip(ours, found.get(other, (np.inf, np.inf)), strict=True)
                ]
                theirs = [
                    f"{found[other].processor / 1e6:.3f}" if other in found else "-"
                    for other in ("mcap", "rosbags")
                ]
                print(
                    f"{topics + 1:6} {name:14} {ratios[0]:>12} {ratios[1]:>6} {ratios[2]:>10} "
                    f"{ratios[3]:>6} "
                    f"{ours.processor / 1e6:9.2f} {found['digest'].processor / 1e6:7.2f} "
                    f"{ours.passed / 1e6:6.2f} {theirs[0]:>9} {theirs[1]:>7}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
