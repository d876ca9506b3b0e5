"""Clocks of SUs and of some joints that run differently from most joints', in words."""

from __future__ import annotations

from collections.abc import Sequence

from skin2urdf.recording.naming import shortened
from skin2urdf.report.tables import number
from skin2urdf.signals.records import JointClock, SuClock

_ALIKE = 4.0
"""Standard deviations within which clocks are told as one."""
_LEAST = 1e-3, 1e-5
"""Latency [s] and drift [s/s] by which clocks differ at least to be told apart."""


def clock_notes(logs: Sequence[Sequence[SuClock]]) -> list[str]:
    """What was found of the clocks of each log, SUs with the same clock in one sentence.

    Args:
        logs: by log, the clocks that are off.
    """
    return _told([_of_one_log(clocks) for clocks in logs], "samples")


def publisher_notes(logs: Sequence[Sequence[JointClock]]) -> list[str]:
    """What was found of the clocks of publishers of joint states.

    Args:
        logs: by log, the clocks that are off.
    """
    return _told([[_of_joints(clock) for clock in clocks] for clocks in logs], "positions")


def _told(logs: Sequence[Sequence[str]], what: str) -> list[str]:
    """Sentences of all logs, each with its log where there are several."""
    names = [f" in log {i + 1}" if len(logs) > 1 else "" for i in range(len(logs))]
    return [
        f"{words}{name}; the {what} were set right"
        for of_log, name in zip(logs, names, strict=True)
        for words in of_log
    ]


def _of_joints(clock: JointClock) -> str:
    """Latency and drift of a publisher of joint states."""
    whose = f"the clock that stamps {shortened(clock.joints, 4)} is"
    return f"{whose} {_off(clock, 'other')}"


def _of_one_log(clocks: Sequence[SuClock]) -> list[str]:
    """SUs with the same clock in one sentence."""
    groups: list[list[SuClock]] = []
    # One that hardly shows is like several that differ: the one that shows best leads each group.
    for clock in sorted(clocks, key=lambda each: each.latency_sd):
        for group in groups:
            if _alike(clock, group[0]):
                group.append(clock)
                break
        else:
            groups.append([clock])
    return [_words(group) for group in groups]


def _alike(a: SuClock, b: SuClock) -> bool:
    """Whether two SUs may have one clock."""
    latency = max(_LEAST[0], _ALIKE * (a.latency_sd + b.latency_sd))
    drift = max(_LEAST[1], _ALIKE * (a.drift_sd + b.drift_sd))
    return abs(a.latency - b.latency) <= latency and abs(a.drift - b.drift) <= drift


def _words(group: Sequence[SuClock]) -> str:
    """Latency and drift of a group, of its first SU, which shows them best."""
    best = group[0]
    whose = f"the clocks of {shortened([clock.su for clock in group], 4)} are"
    if len(group) == 1:
        whose = f"the clock of {best.su} is"
    elif any((clock.latency, clock.drift) != (best.latency, best.drift) for clock in group):
        whose = f"{whose} alike as far as each shows, and that of {best.su}, which shows best, is"
    return f"{whose} {_off(best, '')}"


def _off(clock: SuClock | JointClock, others: str) -> str:
    """By how much a clock is off that of the joints, or of others."""
    sense = "late" if clock.latency >= 0 else "early"
    pace = "fast" if clock.drift >= 0 else "slow"
    against = f"the {others} joints'" if others else "the joints'"
    return (
        f"{number(abs(clock.latency) * 1e3)} ms {sense} against {against} "
        f"(sd {number(clock.latency_sd * 1e3)} ms) and {number(abs(clock.drift) * 1e6)} ppm too "
        f"{pace} (sd {number(clock.drift_sd * 1e6)} ppm)"
    )
