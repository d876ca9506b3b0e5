"""Mutate a small log and see that every command ends in time, in words, and never wrong in silence.

A sound log of a robot with two joints is simulated and calibrated once. Mutants of its bytes
(flipped, cut, repeated), of its MCAP records (left out, doubled, exchanged, with other lengths), of
its messages (stamps, values, order, payloads) and of the bytes of the same log in other formats
(database, ROS 1 bag, table, packed) then go through `info`, `explore` and `calibrate`, each in a
process of its own with a limit of time and memory. A mutant fails where a command is killed by a
limit or a signal, prints a traceback or an internal error, ends with an unknown status, or writes a
URDF that is wrong by more than twice what it states without a word that the sound log's result does
not have.
Mutants that fail are kept.

    python scripts/fuzz.py --mutants 1000 --seconds 3600
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import signal
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

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
MAGIC = b"\x89MCAP0\r\n"
COMMANDS = ("info", "explore", "calibrate")
# Statuses that the commands document.
STATUSES = {0, 1, 2, 3}
# Numbers that programs trip over.
ODD = (0.0, -0.0, 1e-308, 1e5, 1e30, 1e308, -1e308, float("nan"), float("inf"), 9.81)
# A mutant may take so many times as long as the sound log, and so much more [s].
PATIENCE, GRACE = 3.0, 10.0
WAITING = 100.0

Mutation = Callable[[bytes, np.random.Generator], bytes]


class Message(NamedTuple):
    """A message of a log: topic, type, when it was recorded [ns], payload."""

    topic: str
    ros_type: str
    log_time: int
    payload: bytes


class Outcome(NamedTuple):
    """How a command ended.

    Attributes:
        fault: what is wrong with it, empty if nothing.
        status: exit status, negative for a signal.
        output: what it printed.
        seconds: processor time that it took.
    """

    fault: str
    status: int
    output: str
    seconds: float


def mutated_bytes(log: bytes, rng: np.random.Generator) -> bytes:
    """Flip, cut, repeat or zero some bytes."""
    data = bytearray(log)
    for _ in range(int(rng.integers(1, 8))):
        at = int(rng.integers(len(data)))
        size = int(2 ** rng.uniform(0, 12))
        kind = rng.integers(5)
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at : at + size] = rng.bytes(min(size, len(data) - at))
        elif kind == 2:
            del data[at : at + size]
        elif kind == 3:
            data[at:at] = data[at : at + size]
        else:
            data[at : at + size] = bytes(min(size, len(data) - at))
    return bytes(data[: int(rng.integers(len(data)))]) if rng.random() < 0.1 else bytes(data)


def mutated_records(log: bytes, rng: np.random.Generator) -> bytes:
    """Leave out, double, exchange or damage whole records."""
    records, at = [], len(MAGIC)
    while at + 9 <= len(log) - len(MAGIC):
        (length,) = struct.unpack_from("<Q", log, at + 1)
        records.append(log[at : at + 9 + length])
        at += 9 + length
    for _ in range(int(rng.integers(1, 6))):
        a, b = (int(k) for k in rng.integers(len(records), size=2))
        kind = rng.integers(6)
        if kind == 0 and len(records) > 2:
            del records[a]
        elif kind == 1:
            records.insert(b, records[a])
        elif kind == 2:
            records[a], records[b] = records[b], records[a]
        elif kind == 3:
            claim = int(2 ** rng.uniform(0, 64)) & (2**64 - 1)
            records[a] = records[a][:1] + struct.pack("<Q", claim) + records[a][9:]
        elif kind == 4 and len(records[a]) > 41:
            # The size that a chunk claims to have once unpacked.
            claim = struct.pack("<Q", int(2 ** rng.uniform(0, 40)))
            records[a] = records[a][:25] + claim + records[a][33:]
        else:
            records[a] = bytes([int(rng.integers(16))]) + records[a][1:]
    return MAGIC + b"".join(records) + MAGIC


def mutated_messages(log: bytes, rng: np.random.Generator) -> bytes:
    """Change times, values, order and payloads of messages, and write them as a sound log."""
    messages = _messages(log)
    for _ in range(int(rng.integers(1, 4))):
        messages = _MESSAGE_KINDS[int(rng.integers(len(_MESSAGE_KINDS)))](messages, rng)
    return _written(messages)


def _span(messages: Sequence[Message], rng: np.random.Generator) -> tuple[int, int]:
    """First and last of some messages in a row."""
    begin = int(rng.integers(len(messages)))
    return begin, min(len(messages), begin + int(2 ** rng.uniform(0, 14)))


def _topic(messages: Sequence[Message], rng: np.random.Generator) -> str:
    return str(rng.choice(sorted({message.topic for message in messages})))


def _dropped(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    begin, end = _span(messages, rng)
    topic = _topic(messages, rng) if rng.random() < 0.5 else None
    kept = [
        m for k, m in enumerate(messages)
        if not (begin <= k < end and topic in (None, m.topic))
    ]  # fmt: skip
    return kept or messages


def _reordered(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    window = 2 ** rng.uniform(0, 8)
    order = np.argsort(np.arange(len(messages)) + window * rng.random(len(messages)))
    return [messages[k] for k in order]


def _doubled(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    begin, end = _span(messages, rng)
    return messages[:end] + messages[begin:end] + messages[end:]


def _restamped(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    """Stamps of one topic or all move from some message on, or scatter, or are not set."""
    begin, _ = _span(messages, rng)
    topic = _topic(messages, rng) if rng.random() < 0.5 else None
    jump = int(1e9 * float(rng.choice([-1.0, 1.0])) * 10 ** rng.uniform(-3, 5))
    kind = rng.integers(3)

    def moved(k: int, message: Message) -> Message:
        if k < begin or topic not in (None, message.topic) or len(message.payload) < 12:
            return message
        sec, nanosec = struct.unpack_from("<iI", message.payload, 4)
        stamp = sec * 10**9 + nanosec
        if kind == 0:
            stamp += jump
        elif kind == 1:
            stamp += int(rng.integers(-abs(jump), abs(jump) + 1))
        else:
            stamp = 0
        sec, nanosec = divmod(max(0, min(stamp, (2**31 - 1) * 10**9)), 10**9)
        payload = message.payload[:4] + struct.pack("<iI", sec, nanosec) + message.payload[12:]
        return message._replace(payload=payload)

    return [moved(k, message) for k, message in enumerate(messages)]


def _revalued(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    """Doubles at the end of some messages of a topic become odd, or get a factor."""
    topic, share = _topic(messages, rng), 10 ** rng.uniform(-4, 0)
    odd = float(rng.choice(ODD))
    back = 8 * int(rng.integers(1, 14))

    def changed(message: Message) -> Message:
        payload = message.payload
        if message.topic != topic or rng.random() > share or len(payload) < 24 + back:
            return message
        at = len(payload) - back
        return message._replace(payload=payload[:at] + struct.pack("<d", odd) + payload[at + 8 :])

    return [changed(message) for message in messages]


def _damaged(messages: list[Message], rng: np.random.Generator) -> list[Message]:
    """Payloads are cut, flipped, or another topic's."""
    out = list(messages)
    for k in rng.integers(len(out), size=int(rng.integers(1, 20))):
        message = out[k]
        payload = bytearray(message.payload)
        if payload and rng.random() < 0.5:
            payload[int(rng.integers(len(payload)))] ^= 1 << int(rng.integers(8))
        elif rng.random() < 0.5:
            payload = payload[: int(rng.integers(len(payload) + 1))]
        else:
            payload = bytearray(out[int(rng.integers(len(out)))].payload)
        out[k] = message._replace(payload=bytes(payload))
    return out


_MESSAGE_KINDS = (_dropped, _reordered, _doubled, _restamped, _revalued, _damaged)
MUTATIONS: tuple[Mutation, ...] = (mutated_bytes, mutated_records, mutated_messages)
# What a mutant is made of: every other one is of messages, which get furthest.
PLAN: tuple[tuple[str, Mutation], ...] = (
    (".mcap", mutated_messages),
    (".mcap", mutated_bytes),
    (".mcap", mutated_messages),
    (".mcap", mutated_records),
    (".mcap", mutated_messages),
    (".bag", mutated_bytes),
    (".mcap", mutated_messages),
    (".db3", mutated_bytes),
    (".mcap", mutated_messages),
    (".csv", mutated_bytes),
    (".mcap", mutated_messages),
    (".mcap.zstd", mutated_bytes),
)


def _messages(log: bytes) -> list[Message]:
    """All messages of a sound log, in the order of their log times."""
    return [
        Message(channel.topic, schema.name if schema else "", message.log_time, message.data)
        for schema, channel, message in make_reader(BytesIO(log)).iter_messages()
    ]


def _written(messages: Sequence[Message]) -> bytes:
    """A log of these messages in this order."""
    stream = BytesIO()
    writer = Writer(stream, chunk_size=1 << 18)
    writer.start(profile="ros2")
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for topic, ros_type, log_time, payload in messages:
        if ros_type not in schemas:
            schemas[ros_type] = writer.register_schema(ros_type, "ros2msg", b"")
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "cdr", schemas[ros_type])
        writer.add_message(channels[topic], log_time, payload, log_time)
    writer.finish()
    return stream.getvalue()


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
        for topic, ros_type, time_, payload in _messages(whole):
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


def perform(words: Sequence[str], seconds: float, memory: int) -> Outcome:
    """Run a command in a process of its own.

    Args:
        words: the command and its arguments.
        seconds: processor time after which it is ended; should it wait for something instead, it
            is after `WAITING` times as long.
        memory: bytes that it may take beyond those that this process has.

    Returns:
        How it ended.
    """
    begin = time.monotonic()
    with tempfile.TemporaryFile("w+", errors="replace") as printed:
        child = os.fork()
        if child == 0:
            _child(words, seconds, memory, printed.fileno())
        status, used = None, 0.0
        while status is None and time.monotonic() - begin < WAITING * seconds:
            ended, code, usage = os.wait4(child, os.WNOHANG)
            if ended:
                status = os.waitstatus_to_exitcode(code)
                used = usage.ru_utime + usage.ru_stime
            time.sleep(0.005)
        if status is None:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        printed.seek(0)
        output = printed.read()
    if status is None:
        waited = time.monotonic() - begin
        return Outcome(f"took more than {waited:.0f} s", -signal.SIGKILL, output, seconds)
    if used > seconds:
        return Outcome(f"took more than {seconds:.0f} s of work", status, output, used)
    if "Traceback" in output or "internal error" in output:
        return Outcome("an error that is not in words", status, output, used)
    if status not in STATUSES:
        return Outcome(f"ended with {status}", status, output, used)
    return Outcome("", status, output, used)


def _child(words: Sequence[str], seconds: float, memory: int, output: int) -> None:
    """Run a command and end this process."""
    status = 120
    try:
        os.dup2(output, 1)
        os.dup2(output, 2)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + memory
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        work = int(seconds) + 2
        resource.setrlimit(resource.RLIMIT_CPU, (work, work))
        status = skin2urdf(list(words))
        sys.stdout.flush()
        sys.stderr.flush()
    except SystemExit as error:
        status = int(error.code or 0)
    except BaseException as error:
        os.write(2, f"Traceback: {type(error).__name__}: {error}".encode())
    finally:
        os._exit(status)


def wrong_in_silence(urdf: Path, truth: Path, sound: set[str]) -> str:
    """What is wrong with a result that says no more than the sound log's, empty if nothing.

    Args:
        urdf: what a mutant was calibrated to.
        truth: the robot.
        sound: all that the sound log's result says in words.
    """
    from skin2urdf.urdf.compare import compare, load_determined, load_open, load_unobservable

    beside = urdf.with_suffix(".json")
    document = json.loads(beside.read_text())
    if spoken(document) - sound:
        return ""
    comparison = compare(
        urdf,
        truth,
        unobservable=load_unobservable(beside),
        anchors=load_determined(beside),
        open_directions=load_open(beside),
        rng=np.random.default_rng(0),
    )
    millimetres = document["fit"]["expected_su_position_mm"]
    stated = float("inf") if millimetres is None else 1e-3 * float(millimetres)
    if not comparison.tree_equal:
        return "a wrong tree without a word"
    if comparison.position.rms > 2.0 * stated:
        rms = comparison.position.rms
        return f"wrong by {1e3 * rms:.3g} mm, {1e3 * stated:.3g} stated, without a word"
    return ""


def spoken(document: dict[str, object]) -> set[str]:
    """All notes and faults of a result, and its verdict."""
    verdict = document.get("verdict")
    said = {str(verdict.get("quality"))} if isinstance(verdict, dict) else set()
    for key in ("notes", "faults"):
        found = document.get(key, [])
        said |= {json.dumps(item) for item in found} if isinstance(found, list) else set()
    return said


def main() -> None:
    """Mutate, run, judge, sum up."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--mutants", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=600.0, help="time for all of them")
    parser.add_argument("--memory", type=int, default=1024, help="of one command [MiB]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--keep", type=Path, default=Path("fuzz"), help="where failures go")
    options = parser.parse_args()
    end = time.monotonic() + options.seconds
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(KeyboardInterrupt):
        place = Path(folder)
        robot, log, truth, urdf = (
            place / name for name in ("two.urdf", "log.mcap", "truth.urdf", "robot.urdf")
        )
        robot.write_text(ROBOT)
        skin2urdf(
            ["simulate", str(robot), "-o", str(log), "--truth", str(truth), "--poses", "5",
             "--sus-per-segment", "2", "--seed", "5", "--imu-rate", "100", "--joint-rate", "100",
             "--excite", "all", "--quiet"]
        )  # fmt: skip

        def words_of(name: str, log: Path) -> list[str]:
            return [name, str(log), *(["-o", str(urdf)] if name == "calibrate" else [])]

        memory = options.memory << 20
        usual = {name: perform(words_of(name, log), 600.0, memory) for name in options.commands}
        for name, outcome in usual.items():
            print(
                f"sound log, {name}: status {outcome.status}, {outcome.seconds:.1f} s", flush=True
            )
            if outcome.status:
                raise SystemExit(f"{name} ends so for the sound log: {outcome.output.strip()}")
        beside = urdf.with_suffix(".json")
        sound = spoken(json.loads(beside.read_text())) if beside.exists() else set()
        whole = formats(log)
        statuses: Counter[tuple[str, int]] = Counter()
        failures = done = 0
        for number in range(options.mutants):
            if time.monotonic() > end:
                break
            rng = np.random.default_rng([options.seed, number])
            ending, mutation = PLAN[number % len(PLAN)]
            mutant = place / f"mutant{ending}"
            mutant.write_bytes(mutation(whole[ending], rng))
            for name in options.commands:
                urdf.unlink(missing_ok=True)
                limit = PATIENCE * usual[name].seconds + GRACE
                outcome = perform(words_of(name, mutant), limit, memory)
                statuses[name, outcome.status] += 1
                fault = outcome.fault
                if not fault and name == "calibrate" and urdf.exists():
                    fault = wrong_in_silence(urdf, truth, sound)
                if fault:
                    failures += 1
                    options.keep.mkdir(exist_ok=True)
                    kept = options.keep / f"{options.seed}_{number}_{name}{ending}"
                    kept.write_bytes(mutant.read_bytes())
                    last = outcome.output.strip().splitlines()[-3:]
                    print(f"{kept}: {mutation.__name__}: {fault}", *last, sep="\n    ")
            done += 1
        print(f"{done} mutants, {failures} failures")
        for (name, status), count in sorted(statuses.items()):
            print(f"  {name}: status {status}: {count}")
    raise SystemExit(1 if failures else 0)


if __name__ == "__main__":
    main()
