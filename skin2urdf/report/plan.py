"""A plan in words: what it is, what was assumed, and what accuracy to expect."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.planning.earlier import Shrinking
from skin2urdf.planning.expected import Expected
from skin2urdf.planning.pieces import strain
from skin2urdf.planning.records import Plan
from skin2urdf.report.tables import count, number

_MM, _DEG = 1e3, float(np.rad2deg(1.0))
_KINDS = {
    "structural": "joints one at a time",
    "pattern": "patterns",
    "move": "transfers",
    "rest": "rests",
}
_LISTED = 4
_COLUMNS = 80


def as_text(
    plan: Plan,
    su_names: Sequence[str],
    expected: Sequence[Expected],
    shrinking: Sequence[Shrinking],
    advice: Sequence[str],
) -> str:
    """The plan for people.

    Args:
        plan: the plan.
        su_names: U SUs whose accuracy is told.
        expected: the accuracy to expect, by grade of sensors.
        shrinking: how uncertainties of an earlier calibration shrink.
        advice: what else to do.
    """
    seconds = Counter[str]()
    for phase in plan.phases:
        seconds[phase.kind] += phase.end - phase.start  # type: ignore[assignment]
    parts = ", ".join(
        f"{words} {seconds[kind]:.0f} s" for kind, words in _KINDS.items() if seconds[kind] > 0
    )
    used = strain(plan.trajectory, plan.limits)
    lines = [
        _wrapped(
            f"{count(plan.limits.n_joints, 'joint')}, {count(len(plan.poses), 'pose')}, "
            f"{plan.trajectory.duration:.0f} s: {parts}"
        ),
        _wrapped(
            f"of the limits it uses {_percent(used[0])} of positions, {_percent(used[1])} of "
            f"speed, {_percent(used[2])} of acceleration, {_percent(used[3])} of jerk"
        ),
    ]
    if plan.checked is not None:
        lines.append(f"{plan.checked} pairs of bodies are kept apart all along")
    lines += [_wrapped(f"note: {note}") for note in plan.notes]
    if expected:
        alone = " of this recording alone" if shrinking else ""
        lines += [
            "",
            f"accuracy to expect{alone} where gravity is known (calibrate --site), and else:",
        ]
        lines += [_accuracy(each) for each in expected]
        lines += _open(su_names, plan.limits.joint_names, expected[0])
    if shrinking:
        lines += ["", "the largest uncertainties of the earlier calibration, with this recording:"]
        lines += [
            f"  {each.what}: {number(each.before * _MM, 3)} mm -> {number(each.after * _MM, 3)} mm"
            for each in shrinking
        ]
    if advice:
        lines += ["", *(_wrapped(line) if line[0] != " " else line for line in advice)]
    return "\n".join(lines) + "\n"


def as_document(
    plan: Plan,
    su_names: Sequence[str],
    expected: Sequence[Expected],
    shrinking: Sequence[Shrinking],
    advice: Sequence[str],
) -> dict[str, Any]:
    """The plan for programs: seconds, mm and deg; arguments as of :func:`as_text`."""
    used = strain(plan.trajectory, plan.limits)
    return {
        "joints": list(plan.limits.joint_names),
        "seconds": plan.trajectory.duration,
        "poses": plan.poses.tolist(),
        "phases": [
            {"kind": p.kind, "start": p.start, "end": p.end, "joint": p.joint, "pose": p.pose}
            for p in plan.phases
        ],
        "share_of_limits": dict(
            zip(("position", "velocity", "acceleration", "jerk"), used.tolist(), strict=True)
        ),
        "pairs_kept_apart": plan.checked,
        "notes": list(plan.notes),
        "expected": {
            each.sensors.name: {
                "su_position_mm": _by_name(su_names, each.position * _MM),
                "su_position_gravity_unknown_mm": _by_name(su_names, each.position_elsewhere * _MM),
                "su_orientation_deg": _by_name(su_names, each.orientation * _DEG),
                "su_verdict": dict(zip(su_names, each.observability.su_verdict, strict=True)),
                "joint_verdict": dict(
                    zip(plan.limits.joint_names, each.observability.joint_verdict, strict=True)
                ),
            }
            for each in expected
        },
        "shrinking_mm": [
            {"what": s.what, "before": s.before * _MM, "after": s.after * _MM} for s in shrinking
        ],
        "advice": list(advice),
    }


def _wrapped(line: str) -> str:
    return textwrap.fill(line, _COLUMNS, subsequent_indent="  ", break_long_words=False)


def _accuracy(expected: Expected) -> str:
    known = expected.determined
    if not known.any():
        return f"  {expected.sensors.name}: no SU would be determined"
    position, elsewhere, orientation = (
        values[known]
        for values in (expected.position, expected.position_elsewhere, expected.orientation)
    )
    return (
        f"  {expected.sensors.name:8} SUs {number(_rms(position) * _MM, 3)} mm, "
        f"{number(_rms(orientation) * _DEG, 3)} deg rms, the worst "
        f"{number(position.max() * _MM, 3)} mm; else {number(_rms(elsewhere) * _MM, 2)} mm"
    )


def _open(su_names: Sequence[str], joint_names: Sequence[str], expected: Expected) -> list[str]:
    """What will not be determined; nothing of SUs on the base, which never are."""
    seen = expected.observability
    sus = [
        name
        for name, verdict, position in zip(
            su_names, seen.su_verdict, expected.position, strict=True
        )
        if verdict != "determined" and np.isfinite(position)
    ]
    joints = [
        name
        for name, verdict in zip(joint_names, seen.joint_verdict, strict=True)
        if verdict != "determined"
    ]
    return [
        f"  not determined in every direction: {_some(names)}" for names in (sus, joints) if names
    ]


def _some(names: Sequence[str]) -> str:
    more = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def _by_name(names: Sequence[str], values: F64) -> dict[str, float | None]:
    return {
        name: float(value) if np.isfinite(value) else None
        for name, value in zip(names, values, strict=True)
    }


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
