"""The table of the bench: true and stated errors of every row, and what was said."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Sequence

from batch import figures
from batch.records import Failure
from montecarlo.normalised import summed

from bench.measured import Figures
from bench.rows import ROWS, SOUND
from bench.trials import Trial

LIMIT = 2.0
"""True error over the stated one that makes a result one that can not be believed."""

HEAD = (
    ("re-", "cordings"), ("true", "mm"), ("stated", "mm"), ("worst", "ratio"), ("true", "deg"),
    ("stated", "deg"), ("worst", "ratio"), ("known", "deg"), ("NEES", "mm"), ("", "deg"),
    ("good/fair", "/none"), ("SUs not", "known"), ("time", "s"), ("", "named, told or refused"),
)  # fmt: skip
LEGEND = (
    "True and stated errors are root mean squares over recordings, SUs and configurations. Ratio: "
    f"true over stated, the\nlargest of the recordings; ! beyond {LIMIT:g}. None: refused, or bad. "
    "SUs not known: stated to be not determined.\nKnown: true error of the others' orientations. "
    "NEES: squared errors over stated variances of the SUs' positions and\norientations, these "
    "without what is stated of rotations that cross-axis errors hide, per direction of all\n"
    "recordings of a row.\n"
)


def report(trials: Sequence[Trial]) -> str:
    """A table for every robot and circumstance, and what fell short."""
    if not trials:
        return "No recordings.\n"
    parts = []
    for words in dict.fromkeys(trial.case.circumstance for trial in trials):
        own = [trial for trial in trials if trial.case.circumstance == words]
        names = [name for name in ROWS if any(t.case.row == name for t in own)]
        rows = [(name, cells([t.outcome for t in own if t.case.row == name])) for name in names]
        parts.append(figures.table(words, HEAD, rows))
        ratios = [r for t in own if not t.failure and (r := t.figures.position_ratio) is not None]
        if ratios:
            median = statistics.median(ratios)
            parts.append(f"Median of true over stated: {median:.2f} (position).\n")
    found = [(trial.case.key, shortfalls(trial)) for trial in trials]
    return "\n".join([*parts, LEGEND, figures.missed(found, "fell short")])


def complete(trials: Sequence[Trial]) -> bool:
    """Whether every stated error can be believed."""
    return not any(shortfalls(trial) for trial in trials)


def shortfalls(trial: Trial) -> list[str]:
    """What is wrong with a result, in words."""
    if isinstance(trial.outcome, Failure):
        return [str(trial.outcome)]
    own = trial.outcome
    if own.refusal:
        return [own.refusal.splitlines()[0]]
    reasons = misstated(own)
    # No row hits a joint, moves an SU on its segment, or breaks one.
    reasons += [f"named {kind} {subject}" for kind, subject in own.named if kind in _FALSE]
    if trial.case.row == SOUND:
        told = [*(kind for kind, _ in own.named), *own.causes]
        reasons += [f"{what} told in a sound recording" for what in told]
    return reasons


def misstated(own: Figures) -> list[str]:
    """What of a result is false, in words: errors larger than stated, or the tree."""
    reasons = [
        f"{what} {ratio:.1f} times the stated error, {own.verdict}"
        for what, ratio in (
            ("position", own.position_ratio),
            ("orientation", own.orientation_ratio),
        )
        if ratio is not None and not ratio <= LIMIT
    ]
    return reasons if own.tree_right else [*reasons, "wrong tree"]


_FALSE = frozenset(
    {"contact", "loose", "dead", "frozen", "saturated", "swapped", "mirrored", "encoder jump",
     "encoder sign", "encoder scale"}
)  # fmt: skip


def cells(outcomes: Sequence[Figures | Failure]) -> tuple[str, ...]:
    """The cells of a row of the table."""
    done = [each for each in outcomes if not isinstance(each, Failure)]
    verdicts = Counter(
        f.verdict if f.verdict in ("good", "fair") and not f.refusal else "none" for f in done
    )
    told = ({kind for kind, _ in f.named} | set(f.causes) for f in done)
    kinds = Counter(kind for each in told for kind in sorted(each))
    said = [f"{kind} {n}" for kind, n in kinds.most_common()]
    said += sorted({f.refusal.splitlines()[0][:60] for f in done if f.refusal})
    return (
        figures.count(len(done), len(outcomes)),
        figures.short(figures.rms(f.position_mm for f in done)),
        figures.short(figures.rms(f.position_stated_mm for f in done)),
        figures.short(_largest([f.position_ratio for f in done]), LIMIT),
        figures.short(figures.rms(f.orientation_deg for f in done)),
        figures.short(figures.rms(f.orientation_stated_deg for f in done)),
        figures.short(_largest([f.orientation_ratio for f in done]), LIMIT),
        figures.short(figures.rms(f.known_deg for f in done)),
        figures.short(_nees(done, "SU position")),
        figures.short(_nees(done, "SU orientation, felt")),
        f"{verdicts['good']}/{verdicts['fair']}/{verdicts['none']}",
        str(sum(f.n_undetermined for f in done)),
        figures.short(figures.rms(f.seconds for f in done)),
        "; ".join(said),
    )


def _nees(done: Sequence[Figures], name: str) -> float | None:
    """Squared error over stated variance per direction; None where there is none."""
    whole = summed(f.blocks[name] for f in done if name in f.blocks)
    return whole.squared / whole.dimensions if whole.dimensions else None


def _largest(values: Sequence[float | None]) -> float | None:
    return max((v for v in values if v is not None and not math.isnan(v)), default=None)
