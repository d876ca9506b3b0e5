"""The table of plans: one row a robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from batch import figures

from planned.trials import ROUNDING, Trial

_LATE = 0.1
"""By how much a plan may be longer or shorter than asked [s]."""
_HEAD = (
    ("", "joints"), ("", "plans"), ("re-", "fused"), ("", "poses"), ("", "min"),
    ("largest", "pos."),
    ("share of", "speed"), ("limits:", "acc."), ("", "jerk"), ("pairs", "apart"),
    ("instants", "looked at"), ("", "touching"), ("not", "alone"), ("CPU", "s"),
)  # fmt: skip


def report(trials: Sequence[Trial]) -> str:
    """The table, and why there are no plans where there are none."""
    if not trials:
        return "No plans.\n"
    robots = sorted({t.case.robot for t in trials})
    rows = [(robot, _row([t for t in trials if t.case.robot == robot])) for robot in robots]
    rows.append(("all", _row(trials)))
    why = Counter(
        (t.case.robot, t.figures.refused) for t in trials if not t.failure and t.figures.refused
    )
    refusals = [f"  {robot}: {words} ({n} times)" for (robot, words), n in sorted(why.items())]
    found = [(t.case.key, shortfalls(t)) for t in trials]
    return "\n".join(
        [figures.table("plans", _HEAD, rows), *refusals, figures.missed(found, "fell short")]
    )


def shortfalls(trial: Trial) -> list[str]:
    """What is wrong with a plan; that there is none, in words, is not."""
    if trial.failure:
        return [str(trial.failure)]
    own = trial.figures
    if own.refused:
        return []
    words = []
    if own.strain > 1 + ROUNDING:
        words.append(f"a limit is left by a factor of {own.strain:.6f}")
    if own.touching:
        words.append(f"bodies touch at {own.touching} of {own.instants} instants")
    if own.late > _LATE:
        words.append(f"{own.late:.2f} s longer or shorter than asked")
    return words


def complete(trials: Sequence[Trial]) -> bool:
    """Whether every plan is as it should be."""
    return not any(shortfalls(trial) for trial in trials)


def _row(trials: Sequence[Trial]) -> tuple[str, ...]:
    done = [t.figures for t in trials if not t.failure]
    made = [f for f in done if not f.refused]
    if not made:
        return ("", "0", str(len(done) - len(made)), *[""] * 11)
    pairs = [f.pairs for f in made if f.pairs is not None]

    def span(values: Sequence[float], digits: int = 0) -> str:
        low, high = (f"{x:.{digits}f}" for x in (min(values), max(values)))
        return low if low == high else f"{low}-{high}"

    return (
        span([f.joints for f in made]),
        figures.count(len(made) + len(done) - len(made), len(trials)),
        str(len(done) - len(made)),
        span([f.poses for f in made]),
        span([f.minutes for f in made], 1),
        *(f"{max(values):.4f}" for values in zip(
            *((f.position, f.speed, f.acceleration, f.jerk) for f in made), strict=True
        )),
        span(pairs) if pairs else figures.NONE,
        str(sum(f.instants for f in made)),
        str(sum(f.touching for f in made)),
        str(sum(f.left_out for f in made)),
        span([f.seconds for f in made], 1),
    )  # fmt: skip
