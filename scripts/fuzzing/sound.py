"""Sound logs that calibrate, as small as can be, and the same in every format."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import zstandard
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from fuzzing.messages import messages_of
from skin2urdf.cli.main import main as skin2urdf
from skin2urdf.recording.reading import read

ROBOT = """<robot name="two">
<link name="base"/><link name="upper"/><link name="lower"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<origin xyz="0 0 0.2" rpy="1.2 0 0"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" velocity="3" effort="50"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
<origin xyz="0.3 0 0" rpy="0.7 0.4 0"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" velocity="3" effort="50"/></joint>
</robot>
"""


# Joints that swing one after the other in two poses make the shortest log that is calibrated well.
# The others lead through other code: all joints swing together, the robot never rests, and it moves
# from rest to rest without any pattern. Rates and lengths are the least with which a result states
# less than a millimetre, so that one that is wrong stands out.
MOTIONS = {
    "one": ["--poses", "2"],
    "all": ["--poses", "2", "--no-structural"],
    "series": ["--minutes", "0.4"],
    "none": ["--minutes", "0.5"],
}


class Sound(NamedTuple):
    """A sound log, and the robot that it was recorded on."""

    log: Path
    truth: Path


def sound_log(folder: Path, excite: str) -> Sound:
    """Simulate a robot with two joints.

    Args:
        folder: where log and robot are written; made if it is not there.
        excite: how its joints move, a key of `MOTIONS`.
    """
    folder.mkdir(exist_ok=True)
    robot, log, truth = (folder / name for name in ("two.urdf", "log.mcap", "truth.urdf"))
    robot.write_text(ROBOT)
    skin2urdf(
        ["simulate", str(robot), "-o", str(log), "--truth", str(truth), "--sus-per-segment", "2",
         "--imu-rate", "40", "--joint-rate", "40", "--seed", "5", "--excite", excite,
         *MOTIONS[excite], "--quiet"]
    )  # fmt: skip
    return Sound(log, truth)


def formats(log: Path) -> dict[str, bytes]:
    """A sound log in every format, by the end of its name.

    Args:
        log: the log in MCAP; other files are written beside it.
    """
    store = get_typestore(Stores.ROS2_HUMBLE)
    ros1 = get_typestore(Stores.ROS1_NOETIC)
    whole = log.read_bytes()
    bag, folder = log.with_suffix(".bag"), log.with_name("as_database")
    old = Ros1Writer(bag)
    old.set_compression(Ros1Writer.CompressionFormat.LZ4)
    new = Writer2(folder, version=8, storage_plugin=StoragePlugin.SQLITE3)
    with old, new:
        lines: dict[tuple[str, str], tuple[object, object]] = {}
        for topic, ros_type, time_, payload in messages_of(whole):
            if (topic, ros_type) not in lines:
                lines[topic, ros_type] = (
                    old.add_connection(topic, ros_type, typestore=ros1),
                    new.add_connection(topic, ros_type, typestore=store),
                )
            first, second = lines[topic, ros_type]
            old.write(first, time_, store.cdr_to_ros1(payload, ros_type))  # type: ignore[arg-type]
            new.write(second, time_, payload)  # type: ignore[arg-type]
    (database,) = folder.glob("*.db3")
    return {
        ".mcap": whole,
        ".bag": bag.read_bytes(),
        ".db3": database.read_bytes(),
        ".csv": _as_table(log).encode(),
        ".mcap.zstd": zstandard.ZstdCompressor().compress(whole),
    }


def _as_table(log: Path) -> str:
    """A log as a table: a row for each time at which a stream has a sample."""
    recording = read(log)
    names = [f"{joint.name} [rad]" for joint in recording.joints]
    names += [f"{su.name}.{axis} [m/s^2]" for su in recording.sus for axis in "xyz"]
    columns = [(joint.time, joint.position[:, None]) for joint in recording.joints]
    columns += [(su.time, su.specific_force) for su in recording.sus]
    rows: dict[float, list[str]] = {}
    at = 0
    for times, values in columns:
        for time_, some in zip(times.tolist(), values.tolist(), strict=True):
            row = rows.setdefault(time_, [""] * len(names))
            row[at : at + len(some)] = map(repr, some)
        at += values.shape[1]
    lines = (f"{time_!r},{','.join(rows[time_])}" for time_ in sorted(rows))
    return "\n".join([",".join(["time [s]", *names]), *lines])
