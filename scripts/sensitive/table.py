"""What each constant decides, in one line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from sensitive.trials import Trial

NOTHING = 0.1
"""Change of positions, over what is stated of them, that nobody needs to know."""


def report(trials: Iterable[Trial]) -> str:
    """A line for each constant and value: the largest changes, and in which recordings."""
    groups: dict[tuple[str, str], list[Trial]] = {}
    for trial in trials:
        groups.setdefault((trial.case.module, trial.case.name), []).append(trial)
    lines = [f"{module:36s} {name:24s} {changes(of)}" for (module, name), of in groups.items()]
    return "\n".join([*lines, ""]) if lines else "No trials.\n"


def changes(trials: Sequence[Trial]) -> str:
    """Words for what the values of one constant change, as ``0.5 and 2: nothing changes``."""
    factors = dict.fromkeys(trial.case.factor for trial in trials)
    told = {f: _words([t for t in trials if t.case.factor == f]) for f in factors}
    if len(set(told.values())) == 1:
        times = " and ".join(f"{factor:g}" for factor in factors)
        return f"{times} times: {next(iter(told.values()))}"
    return "; ".join(f"{factor:g} times: {words}" for factor, words in told.items())


def _words(trials: Sequence[Trial]) -> str:
    told: dict[str, list[str]] = {}
    shift = 0.0
    for trial in trials:
        for words in _of(trial):
            told.setdefault(words, []).append(trial.case.log)
        if not trial.failure:
            shift = max(shift, trial.figures.shift or 0.0)
    parts = [f"{words} ({', '.join(logs)})" for words, logs in told.items()]
    if shift > NOTHING:
        parts.append(f"positions by {shift:.1f} sd")
    return ", ".join(parts) or "nothing changes"


def _of(trial: Trial) -> Iterable[str]:
    if trial.failure:
        return ["fails"]
    figures = trial.figures
    if figures.refusal:
        return ["refused"]
    kept = (figures.tree, figures.verdict, figures.named)
    words = ("another tree", "another verdict", "other faults")
    return [word for word, same in zip(words, kept, strict=True) if not same]
