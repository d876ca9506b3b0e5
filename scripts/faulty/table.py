"""The table of trials: found, false alarms, and what a fault costs the rest of the robot."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Sequence

from batch.figures import NONE, cell, count, missed, pairs, ratio, rms, short, table

from faulty.trials import INJECTIONS, Trial

_HEAD = (
    ("re-", "cordings"), ("", "found"), ("false", "alarms"), ("good", "fair"), ("bad", "failed"),
    ("tree", "wrong"), ("others", "mm"), ("without", "fault"), ("ratio", ""),
    ("others", "deg"), ("without", "fault"), ("ratio", ""), ("time", "median"), ("", "most"),
)  # fmt: skip
RATIO = 1.1
"""Error of the other SUs, over theirs without the fault, that may not be exceeded."""
TIMES = 5.0
"""Processor time of a calibration, over that without the fault, that may not be exceeded."""


def report(trials: Iterable[Trial]) -> str:
    """Tables per setting, and what was missed."""
    trials = list(trials)
    if not trials:
        return "No trials.\n"
    parts = [
        _table(words, [t for t in trials if t.case.setting.words == words])
        for words in dict.fromkeys(trial.case.setting.words for trial in trials)
    ]
    found = [(trial.case.key, shortfalls(trial)) for trial in trials]
    return "\n".join([*parts, _LEGEND, missed(found, "fell short")])


def complete(trials: Iterable[Trial]) -> bool:
    """Whether every fault was found, and nothing else."""
    return not any(shortfalls(trial) for trial in trials)


def _table(title: str, trials: Sequence[Trial]) -> str:
    kinds = dict.fromkeys(trial.case.kind for trial in trials)
    rows = [(kind, _row([t for t in trials if t.case.kind == kind])) for kind in kinds]
    return table(title, _HEAD, rows)


def _row(trials: Sequence[Trial]) -> tuple[str, ...]:
    done = [trial.figures for trial in trials if not trial.failure]
    of = Counter(figures.quality or "failed" for figures in done)
    of["failed"] += len(trials) - len(done)
    faulty = trials[0].case.kind in INJECTIONS
    alarmed = sum(bool(figures.false_alarms) for figures in done)
    wrong = len(trials) - sum(figures.tree_right for figures in done)
    found = sum(figures.found for figures in done)
    return (
        str(len(trials)),
        count(found, len(trials)) if faulty else NONE,
        f"{alarmed}{'!' if alarmed else ''}",
        f"{of['good']}/{of['fair']}",
        f"{of['bad']}/{of['failed']}",
        f"{wrong}{'!' if wrong else ''}",
        *_costs([(figures.position_mm, figures.position_clean_mm) for figures in done]),
        *_costs([(figures.orientation_deg, figures.orientation_clean_deg) for figures in done]),
        *_times([(figures.seconds, figures.seconds_clean) for figures in done]),
    )


def _costs(rows: Sequence[tuple[float | None, float | None]]) -> tuple[str, str, str]:
    """Root mean squares with the fault and without, and their ratio."""
    if not (both := pairs(rows)):
        return (short(rms(a for a, b in rows if b is None)), NONE, NONE)
    with_, without = rms(a for a, _ in both), rms(b for _, b in both)
    return short(with_), short(without), cell(ratio(both), 2, RATIO)


def _times(rows: Sequence[tuple[float | None, float | None]]) -> tuple[str, str]:
    """Processor time with the fault over that without: the median and the most."""
    times = [a / b for a, b in pairs(rows) if b > 0]
    if not times:
        return NONE, NONE
    return cell(statistics.median(times), 1, TIMES), cell(max(times), 1, TIMES)


_LEGEND = (
    "Found: the right kind of the right SU or joint, of all that have it. False alarms: recordings "
    "in which another fault\nwas named as well. Errors are root mean squares over recordings, the "
    "SUs without a fault and random configurations,\nwith the fault and without it on the same "
    f"seeds; at most {RATIO:g} times as large. Time: that of the processor, over that without the "
    f"fault; at most {TIMES:g}.\n! marks what falls short.\n"
)


def shortfalls(trial: Trial) -> list[str]:
    """What is wrong with a trial, in words; empty where nothing is."""
    if trial.failure:
        return [str(trial.failure)]
    figures, reasons = trial.figures, []
    if figures.problem:
        reasons.append(figures.problem)
    elif figures.subjects and not figures.found:
        named = "; ".join(f"{kind} {subject}" for kind, subject, _ in figures.faults) or "nothing"
        who = ", ".join(figures.subjects)
        reasons.append(f"not found ({who}: {figures.injected}); named: {named}")
    if figures.false_alarms:
        reasons.append(f"false alarm: {'; '.join(figures.false_alarms)}")
    if not figures.problem and not figures.tree_right:
        reasons.append("wrong tree")
    return reasons
