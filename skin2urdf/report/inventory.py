"""What a log holds and what it lacks for a calibration, as text."""

from __future__ import annotations

from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.report.clocks import clock_notes
from skin2urdf.report.faults import fault_words
from skin2urdf.report.notes import note_words
from skin2urdf.report.plain import to_plain
from skin2urdf.report.tables import bullets, count, number, span, table
from skin2urdf.survey import Surveyed

_DEG = float(np.rad2deg(1.0))


def as_text(surveyed: Surveyed) -> str:
    """Topics, joints, SUs, rests and poses, and what is missing."""
    log = surveyed.inventory
    compression = ", ".join(log.compression) or "no chunks"
    lines = [
        f"{log.source}: {log.duration:.1f} s, {log.messages} messages, "
        f"profile {log.profile or 'none'}, {compression}",
        "",
        *table(
            ("topic", "type", "messages", "used as"),
            [
                (t.name, t.ros_type or t.encoding, str(t.messages), _use(t.used_as))
                for t in log.topics
            ],
            "<<><",
        ),
    ]
    if surveyed.recording is not None:
        lines += ["", *_joints(surveyed), "", *_sus(surveyed.recording, surveyed)]
    if surveyed.sampled is not None:
        lines += ["", _found(surveyed, len(surveyed.sampled.at_rest))]
    lines += bullets("Notes", _notes(surveyed))
    lines += bullets("Faults", _faults(surveyed))
    if surveyed.problems:
        lines += bullets("Missing", [problem.words for problem in surveyed.problems])
    elif not _faults(surveyed):
        lines += ["", "Nothing is missing: calibrate with `skin2urdf calibrate`."]
    return "\n".join(lines) + "\n"


def as_document(surveyed: Surveyed) -> dict[str, Any]:
    """Everything in :func:`as_text` for a script; times in s, positions in rad or m."""
    log, recording, sampled = surveyed.inventory, surveyed.recording, surveyed.sampled
    document: dict[str, Any] = to_plain(
        {
            "source": log.source,
            "duration": log.duration,
            "messages": log.messages,
            "profile": log.profile,
            "compression": log.compression,
            "topics": [
                {
                    "name": t.name,
                    "type": t.ros_type,
                    "encoding": t.encoding,
                    "messages": t.messages,
                    "used_as": t.used_as,
                }
                for t in log.topics
            ],
            "joints": {j.name: _joint(j, i, surveyed) for i, j in _numbered(recording)},
            "sus": {su.name: _su(su) for su in recording.sus} if recording else {},
            "rests": len(sampled.at_rest) if sampled else 0,
            "poses": len(surveyed.features.q) if surveyed.features else 0,
            "poses_with_pattern": int(surveyed.excited.any(axis=-1).sum()),
            "notes": _notes(surveyed),
            "faults": _faults(surveyed),
            "missing": [problem.words for problem in surveyed.problems],
            "obstacles": [problem.words for problem in surveyed.obstacles],
        }
    )
    return document


def _use(used_as: str) -> str:
    return {"joints": "joints", "su": "SU"}.get(used_as, "-")


def _numbered(recording: Recording | None) -> list[tuple[int, JointStream]]:
    return list(enumerate(recording.joints)) if recording else []


def _rate(time: F64) -> tuple[float, float]:
    """Typical samples per second [Hz] and the longest gap [s] of a stream."""
    if time.size < 2:
        return float("nan"), float("nan")
    steps = np.diff(time)
    return 1 / float(np.median(steps)), float(steps.max())


def _joint(joint: JointStream, index: int, surveyed: Surveyed) -> dict[str, Any]:
    """Figures of one joint; joints of a recording are sorted as the DoFs are."""
    rate, gap = _rate(joint.time)
    moves = surveyed.features.moves.dof if surveyed.features else np.zeros(0)
    sampled = surveyed.sampled
    return {
        "rate": rate,
        "longest_gap": gap,
        "range": [float(joint.position.min()), float(joint.position.max())],
        "encoder_step": float(sampled.motion.resolution[index]) if sampled else None,
        "patterns": int(surveyed.excited[:, index].sum()) if surveyed.excited.ndim == 2 else 0,
        "structural_moves": int((moves == index).sum()),
        "effort": joint.effort is not None,
    }


def _su(su: SuStream) -> dict[str, Any]:
    """Figures of one SU."""
    rate, gap = _rate(su.time)
    size = np.linalg.norm(su.specific_force, axis=1)
    return {
        "topic": su.topic,
        "rate": rate,
        "longest_gap": gap,
        "median_reading": float(np.median(size)) if size.size else None,
        "gyroscope": su.angular_velocity is not None,
    }


def _joints(surveyed: Surveyed) -> list[str]:
    """The table of joints; positions as if they were angles, which the log does not tell."""
    rows = []
    for index, joint in _numbered(surveyed.recording):
        figures = _joint(joint, index, surveyed)
        low, high = figures["range"]
        step = figures["encoder_step"]
        rows.append(
            (
                joint.name,
                number(figures["rate"], 0),
                number(figures["longest_gap"] * 1e3, 0),
                span(low, high, 2),
                f"{step:.1e}" if step else "-",
                str(figures["patterns"]),
                str(figures["structural_moves"]),
                "real" if figures["effort"] else "-",
            )
        )
    head = (
        "joint",
        "rate [Hz]",
        "longest gap [ms]",
        "range [rad, m]",
        "encoder step",
        "poses with pattern",
        "structural moves",
        "effort",
    )
    return table(head, rows, "<>>>>>><")


def _sus(recording: Recording, surveyed: Surveyed) -> list[str]:
    """The table of SUs."""
    latency: dict[str, float] = {}
    if surveyed.features is not None:
        f = surveyed.features
        known = np.where(np.isfinite(f.latency_sd), f.latency, np.nan)
        latency = dict(zip(f.su_names, map(float, known), strict=True))
    rows = []
    for su in recording.sus:
        figures = _su(su)
        rows.append(
            (
                su.name,
                su.topic,
                number(figures["rate"], 0),
                number(figures["longest_gap"] * 1e3, 0),
                number(figures["median_reading"] or float("nan")),
                "real" if figures["gyroscope"] else "-",
                number(latency.get(su.name, float("nan")) * 1e3),
            )
        )
    head = (
        "SU", "topic", "rate [Hz]", "longest gap [ms]", "reading [m/s^2]", "gyroscope",
        "latency [ms]",
    )  # fmt: skip
    return table(head, rows, "<<>>><>")


def _found(surveyed: Surveyed, rests: int) -> str:
    """Rests and poses in one line."""
    poses = len(surveyed.features.q) if surveyed.features else 0
    patterned = int(surveyed.excited.any(axis=-1).sum())
    return f"{count(rests, 'rest')} in {count(poses, 'pose')}; patterns around {patterned} of them"


def _faults(surveyed: Surveyed) -> list[str]:
    """What is wrong with the SUs' streams, in words."""
    faults = surveyed.sampled.faults if surveyed.sampled is not None else ()
    return [str(fault_words(fault, 1)) for fault in faults]


def _notes(surveyed: Surveyed) -> list[str]:
    """Notes of every stage, each once."""
    notes = note_words(surveyed.inventory.notes)
    for stage in (surveyed.recording, surveyed.sampled, surveyed.features):
        notes += [note for note in note_words(stage.notes if stage else ()) if note not in notes]
    if surveyed.sampled is not None:
        notes += clock_notes([surveyed.sampled.clocks])
    return notes
