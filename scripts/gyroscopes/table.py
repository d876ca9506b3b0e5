"""The tables: errors with gyroscopes and without, and errors over stated variances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from batch import figures

from gyroscopes.trials import Judged, Trial

_HEAD = (
    ("re-", "cordings"), ("trees", "right"), ("position", "true mm"), ("", "stated"),
    ("orientation", "true deg"), ("", "stated"), ("axes", "true deg"), ("SUs not", "known"),
    ("good/fair", "/none"),
)  # fmt: skip
_LEGEND = (
    "Root mean squares over recordings, SUs whose placement is determined and configurations; axes "
    "over all joints.\nSUs not known: stated to be not determined, of all recordings together.\n"
)


def report(trials: Sequence[Trial]) -> str:
    """A table for every robot and motion, and one of squared errors over stated variances."""
    if not trials:
        return "No recordings.\n"
    rows = []
    for group in dict.fromkeys(trial.case.group for trial in trials):
        own = [t for t in trials if t.case.group == group]
        done = [t.figures for t in own if not t.failure]
        rows.append((group, _row([f.listening for f in done], len(own))))
        rows.append(("  --no-gyro", _row([f.deaf for f in done], len(own))))
    parts = [figures.table("with gyroscopes", _HEAD, rows), _LEGEND]
    normalised = _normalised(trials)
    if normalised:
        head = (("with", "gyro"), ("", "--no-gyro"), ("direc-", "tions"))
        parts.append(figures.table("squared errors over stated variances", head, normalised))
    found = [(trial.case.key, shortfalls(trial)) for trial in trials]
    return "\n".join([*parts, figures.missed(found, "fell short")])


def shortfalls(trial: Trial) -> list[str]:
    """What is wrong with the result that listens to gyroscopes."""
    if trial.failure:
        return [str(trial.failure)]
    own = trial.figures.listening
    if own.refusal:
        return [own.refusal.splitlines()[0]]
    return [] if own.tree_right else ["wrong tree"]


def complete(trials: Sequence[Trial]) -> bool:
    """Whether every recording came to the right tree."""
    return not any(shortfalls(trial) for trial in trials)


def _row(done: Sequence[Judged], n: int) -> tuple[str, ...]:
    verdicts = Counter("none" if f.refusal else f.verdict for f in done)
    right = [f for f in done if f.tree_right]
    return (
        figures.count(len(done), n),
        str(len(right)),
        figures.short(figures.rms(f.position_mm for f in right)),
        figures.short(figures.rms(f.position_stated_mm for f in right)),
        figures.short(figures.rms(f.orientation_deg for f in right)),
        figures.short(figures.rms(f.orientation_stated_deg for f in right)),
        figures.short(figures.rms(f.axis_deg for f in right)),
        str(sum(f.n_undetermined for f in done)),
        f"{verdicts['good']}/{verdicts['fair']}/{verdicts['none']}",
    )


def _normalised(trials: Sequence[Trial]) -> list[tuple[str, tuple[str, ...]]]:
    """Rows of NEES per direction over all recordings whose first axis is not vertical."""
    done = [t.figures for t in trials if not t.failure]
    names = dict.fromkeys(name for f in done for name in f.listening.blocks)
    rows = []
    for name in names:
        both = [
            [b for j in judged if (b := j.blocks.get(name)) is not None and b.dimensions]
            for judged in ([f.listening for f in done], [f.deaf for f in done])
        ]
        ratios = [
            figures.short(sum(b.squared for b in blocks) / sum(b.dimensions for b in blocks))
            if blocks
            else "-"
            for blocks in both
        ]
        rows.append((name, (*ratios, str(sum(b.dimensions for b in both[0])))))
    return rows
