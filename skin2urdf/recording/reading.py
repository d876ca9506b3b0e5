"""Read a log, whatever its format, to a recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from skin2urdf.errors import Unreadable, UnreadableInputError
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.assemble import (
    recorded,
    timed_joints,
    timed_sus,
    timing_notes,
)
from skin2urdf.recording.copies import without_copies
from skin2urdf.recording.inputs import RECORD_REMEDY
from skin2urdf.recording.inventory import LogInventory, Tally
from skin2urdf.recording.log_files import LogFiles
from skin2urdf.recording.messages import ACCELERATION_TAIL, JOINT_STATE, role_of
from skin2urdf.recording.naming import shortened
from skin2urdf.recording.positions import without_glitches
from skin2urdf.recording.progress import Share
from skin2urdf.recording.records import Recording
from skin2urdf.recording.segments import on_one_clock
from skin2urdf.recording.shelf import Shelf
from skin2urdf.recording.steps import without_steps
from skin2urdf.recording.streams import Collector

__all__ = ["inventory", "read"]


def read(
    path: str | Path,
    progress: Callable[[Share], None] | None = None,
    *,
    with_digest: bool = True,
) -> Recording:
    """Read joint positions and accelerations out of a log.

    Args:
        path: a file of any format, or a directory, whose files are read as one log.
        progress: called now and then with the share that is read, up to 1, and its bytes.
        with_digest: take the digest as well, a third of the time of an uncompressed log.

    Returns:
        The recording. Its digest is over the bytes of all files in their order.

    Raises:
        UnreadableInputError: the log can not be read, or holds no joint or no SU.
    """
    source = Path(path)
    log = LogFiles(
        source, lambda channel: role_of(channel.ros_type) != "ignored", progress, with_digest
    )
    shelf = Shelf()
    collector = Collector(log.channels, shelf)
    for block in log.blocks():
        collector.add(block)
    positions, forces = collector.joints(), collector.accelerations()
    names = [
        *(f"{topic} ({shortened(joints)})" for topic, joints in positions),
        *(f"{topic} ({frame})" if frame else topic for topic, frame in forces),
    ]
    topics = [topic for topic, _ in (*positions, *forces)]
    samples, step_notes = without_steps([*positions.values(), *forces.values()], names)
    samples, clock_notes = on_one_clock(samples, names, topics)
    joints, joint_notes = timed_joints(dict(zip(positions, samples, strict=False)))
    forces = dict(zip(forces, samples[len(positions) :], strict=True))
    del samples
    sus, empty, su_notes = timed_sus(forces, shelf)
    notes = [
        *log.notes,
        *_passed_notes(collector),
        *step_notes,
        *clock_notes,
        *joint_notes,
        *su_notes,
    ]
    if not joints or not sus:
        raise _missing(source, log, notes, "joints" if not joints else "SUs")
    notes.extend(timing_notes([*joints, *sus]))
    whole = recorded(joints, sus, empty, shelf, source=str(path), digest=log.digest, notes=notes)
    return without_copies(without_glitches(whole))


def inventory(path: str | Path) -> LogInventory:
    """List what a log holds, usable or not.

    Args:
        path: a file of any format, or a directory.

    Returns:
        Topics with types and numbers of messages, duration, compression and profile.

    Raises:
        UnreadableInputError: the log can not be read.
    """
    source = Path(path)
    log = LogFiles(source, lambda _: True, None, with_digest=False)
    tally = Tally(log.channels)
    for block in log.blocks():
        tally.add(block)
    return tally.inventory(
        source=str(path),
        profile=log.profile,
        compressions=log.compressions,
        notes=log.notes,
    )


def _passed_notes(collector: Collector) -> list[ReadingNote]:
    """Say which messages were passed over."""
    return [
        ReadingNote(
            "passed over", f"{topic}: {count} messages passed over: {reason}", (topic,), count
        )
        for topic, reasons in sorted(collector.passed.items())
        for reason, count in sorted(reasons.items())
    ]


def _missing(
    source: Path, log: LogFiles, notes: list[ReadingNote], what: str
) -> UnreadableInputError:
    """Say that a log holds no joints or no SUs, and why."""
    joint_types = (JOINT_STATE,)
    types = joint_types if what == "joints" else tuple(ACCELERATION_TAIL)
    topics = sorted({c.topic for c in log.channels.known if c.ros_type in types})
    names = " or ".join(name.rsplit("/", 1)[-1] for name in types)
    why: Unreadable = "nothing usable"
    if topics:
        problem = f"no usable {what}: {', '.join(topics)} held nothing that could be used"
        remedy = "see what the topic publishes with `ros2 topic echo`, then record again"
    elif log.channels.known:
        held = ", ".join(sorted(f"{c.topic} ({c.ros_type})" for c in log.channels.known))
        why = "no joints" if what == "joints" else "no SUs"
        problem = f"no {what}: no topic of type {names}; the log holds {held}"
        remedy = RECORD_REMEDY
    else:
        why = "no messages"
        problem = "the log holds no messages"
        remedy = RECORD_REMEDY
    because = f" ({'; '.join(note.words for note in notes[:5])})" if notes else ""
    return UnreadableInputError(str(source), problem + because, remedy, why)
