"""Clocks of SUs that run differently from the joints', in words."""

from __future__ import annotations

from collections.abc import Sequence

from skin2urdf.recording.naming import shortened
from skin2urdf.report.tables import number
from skin2urdf.signals.records import SuClock

_ALIKE = 4.0
"""Standard deviations within which clocks are told as one."""
_LEAST = 1e-3, 1e-5
"""Latency [s] and drift [s/s] by which clocks differ at least to be told apart."""


def clock_notes(logs: Sequence[Sequence[SuClock]]) -> list[str]:
    """What was found of the clocks of each log, SUs with the same clock in one sentence.

    Args:
        logs: by log, the clocks that are off.
    """
    names = [f" in log {i + 1}" if len(logs) > 1 else "" for i in range(len(logs))]
    return [
        f"{words}{name}; the samples were set right"
        for clocks, name in zip(logs, names, strict=True)
        for words in _of_one_log(clocks)
    ]


def _of_one_log(clocks: Sequence[SuClock]) -> list[str]:
    """SUs with the same clock in one sentence."""
    groups: list[list[SuClock]] = []
    for clock in clocks:
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
    """Latency and drift of a group, of the SU that shows them best."""
    best = min(group, key=lambda clock: clock.latency_sd)
    whose = f"the clocks of {shortened([clock.su for clock in group], 4)} are"
    if len(group) == 1:
        whose = f"the clock of {best.su} is"
    sense = "late" if best.latency >= 0 else "early"
    pace = "fast" if best.drift >= 0 else "slow"
    return (
        f"{whose} {number(abs(best.latency) * 1e3)} ms {sense} against the joints' "
        f"(sd {number(best.latency_sd * 1e3)} ms) and {number(abs(best.drift) * 1e6)} ppm too "
        f"{pace} (sd {number(best.drift_sd * 1e6)} ppm)"
    )
