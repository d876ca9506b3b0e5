"""The table of drawn circumstances: errors of all recordings that have something in common."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from batch import figures
from batch.records import Failure
from bench.measured import Figures
from bench.table import HEAD, LEGEND, cells, misstated

from drawn.trials import Outcome, Trial

SLOW = 10.0
"""Time for a sample over the median of all recordings that is one to be looked into."""
_TRUE = {
    "intermittent": ("Lost", "Bursts", "OwnRates", "OnArrival", "Stalls"),
    "noisy": ("Spikes", "Vibration"),
}
"""Faults that have what a user would call so behind them, and the defects that are it."""


def report(trials: Sequence[Trial]) -> str:
    """A row for every kind of circumstance, and what is false."""
    if not trials:
        return "No recordings.\n"
    every = sorted({word for t in trials if not t.failure for word in t.figures.words})
    rows = [("anything", cells([_plain(t) for t in trials]))]
    for word in every:
        own = [t for t in trials if not t.failure and word in t.figures.words]
        rows.append((word, cells([_plain(t) for t in own])))
    found = [(t.case.key, [*shortfalls(t), *_slow(t, trials)]) for t in trials]
    return "\n".join(
        [figures.table("recordings with", HEAD, rows), LEGEND, figures.missed(found, "are false")]
    )


def complete(trials: Sequence[Trial]) -> bool:
    """Whether nothing false is stated, in about the same time."""
    return not any([*shortfalls(t), *_slow(t, trials)] for t in trials)


def shortfalls(trial: Trial) -> list[str]:
    """What of a result is false, in words; that nothing is stated is nothing false."""
    if trial.failure:
        return [str(trial.failure)]
    own = trial.figures
    if own.figures.refusal or own.figures.verdict == "bad":
        return []
    named = [f"named {kind} {who}" for kind, who in own.figures.named if not _true(own, kind, who)]
    return [*misstated(own.figures), *named]


def _true(own: Outcome, kind: str, who: str) -> bool:
    """Whether what is named is there: no joint is hit, and no SU slips or breaks."""
    if kind == "saturated":
        return who in own.clipped
    return any(defect in own.words for defect in _TRUE.get(kind, ()))


def _slow(trial: Trial, among: Sequence[Trial]) -> list[str]:
    done = [t for t in among if not t.failure and t.figures.figures.verdict]
    if trial.failure or len(done) < SLOW:
        return []
    usual = statistics.median(t.figures.figures.seconds / t.figures.samples for t in done)
    times = trial.figures.figures.seconds / trial.figures.samples / usual
    return [f"took {times:.0f} times as long as others"] if times > SLOW else []


def _plain(trial: Trial) -> Figures | Failure:
    return trial.failure or trial.figures.figures
