"""The table of trials: found, false alarms, and what a fault costs the rest of the robot."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

from faulty.trials import Trial

_HEAD = (
    ("re-", "cordings"), ("", "found"), ("false", "alarms"), ("good", "fair"), ("bad", "failed"),
    ("tree", "wrong"), ("others", "mm"), ("without", "fault"), ("ratio", ""),
    ("others", "deg"), ("without", "fault"), ("ratio", ""),
)  # fmt: skip
RATIO = 1.1
"""Error of the other SUs, over theirs without the fault, that may not be exceeded."""


def report(trials: Iterable[Trial]) -> str:
    """Tables per setting, and what was missed."""
    trials = list(trials)
    if not trials:
        return "No trials.\n"
    parts = [
        _table(words, [t for t in trials if t.case.setting.words == words])
        for words in dict.fromkeys(trial.case.setting.words for trial in trials)
    ]
    parts += [_LEGEND, _missed(trials)]
    codes = {trial.code for trial in trials}
    if len(codes) > 1:
        parts.append(f"These trials come from {len(codes)} states of the code.\n")
    return "\n".join(parts)


def complete(trials: Iterable[Trial]) -> bool:
    """Whether every fault was found, and nothing else."""
    return not any(_shortfall(trial) for trial in trials)


def _table(title: str, trials: Sequence[Trial]) -> str:
    kinds = dict.fromkeys(trial.case.kind for trial in trials)
    rows = {kind: _row([t for t in trials if t.case.kind == kind]) for kind in kinds}
    first = max(len(title), *map(len, rows))
    widths = [
        max(len(a), len(b), *(len(row[i]) for row in rows.values())) + 2
        for i, (a, b) in enumerate(_HEAD)
    ]
    lines = [
        title.ljust(first) + "".join(a.rjust(w) for (a, _), w in zip(_HEAD, widths, strict=True)),
        " " * first + "".join(b.rjust(w) for (_, b), w in zip(_HEAD, widths, strict=True)),
        "-" * (first + sum(widths)),
    ]
    lines += [
        kind.ljust(first) + "".join(c.rjust(w) for c, w in zip(row, widths, strict=True))
        for kind, row in rows.items()
    ]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _row(trials: Sequence[Trial]) -> tuple[str, ...]:
    of = Counter(trial.quality or "failed" for trial in trials)
    faulty = bool(trials[0].subjects)
    found = sum(trial.found for trial in trials)
    alarmed = sum(bool(trial.false_alarms) for trial in trials)
    position = _costs([(t.position_mm, t.position_clean_mm) for t in trials])
    turn = _costs([(t.orientation_deg, t.orientation_clean_deg) for t in trials])
    wrong = sum(not trial.tree_right for trial in trials)
    return (
        str(len(trials)),
        ("-" if not faulty else str(found)) + ("!" if faulty and found < len(trials) else ""),
        f"{alarmed}{'!' if alarmed else ''}",
        f"{of['good']}/{of['fair']}",
        f"{of['bad']}/{of['failed']}",
        f"{wrong}{'!' if wrong else ''}",
        *position,
        *turn,
    )


def _costs(pairs: Sequence[tuple[float | None, float | None]]) -> tuple[str, str, str]:
    """Root mean squares with the fault and without, and their ratio."""
    alone = [a for a, b in pairs if a is not None and b is None]
    both = [(a, b) for a, b in pairs if a is not None and b is not None]
    if not both:
        return (_rms_text(alone), "-", "-")
    with_, without = (math.sqrt(sum(p[i] ** 2 for p in both) / len(both)) for i in (0, 1))
    ratio = with_ / without if without > 0 else math.inf
    return f"{with_:.3g}", f"{without:.3g}", f"{ratio:.2f}{'!' if ratio > RATIO else ''}"


def _rms_text(values: Sequence[float]) -> str:
    return f"{math.sqrt(sum(v * v for v in values) / len(values)):.3g}" if values else "-"


_LEGEND = (
    "Found: the right kind of the right SU or joint, of all that have it. False alarms: recordings "
    "in which another fault\nwas named as well. Errors are root mean squares over recordings, the "
    "SUs without a fault and random configurations,\nwith the fault and without it on the same "
    f"seeds; at most {RATIO:g} times as large. ! marks what falls short.\n"
)


def _shortfall(trial: Trial) -> str:
    reasons = []
    if trial.problem:
        reasons.append(trial.problem)
    elif trial.subjects and not trial.found:
        named = "; ".join(f"{kind} {subject}" for kind, subject, _ in trial.faults) or "nothing"
        reasons.append(f"not found ({', '.join(trial.subjects)}: {trial.injected}); named: {named}")
    if trial.false_alarms:
        reasons.append(f"false alarm: {'; '.join(trial.false_alarms)}")
    if not trial.problem and not trial.tree_right:
        reasons.append("wrong tree")
    return "; ".join(reasons)


def _missed(trials: Sequence[Trial]) -> str:
    lines = [f"  {t.case.key}: {reason}" for t in trials if (reason := _shortfall(t))]
    if not lines:
        return f"Nothing was missed in {len(trials)} recordings.\n"
    return "\n".join([f"{len(lines)} of {len(trials)} recordings fell short:", *lines]) + "\n"
