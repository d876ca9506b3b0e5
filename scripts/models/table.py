"""The table of trials on given models, and what falls short of what must be reached."""

from __future__ import annotations

from collections.abc import Sequence

from batch.figures import cell, count, missed, rms, table
from batch.records import Failure

from models.trials import KINDS, Found, Run

RATIO = 1.5
"""True error over the stated one that must not be passed."""
WITHIN = 0.95
"""Share of a specimen's deviations that must be within two standard deviations."""
BEYOND = 22.46 / 6
"""Squared difference of six numbers over its covariance, over 6, that chance exceeds in one of a
thousand."""
TILT = 1.0
"""By how much a mount may be told wrong [deg]."""

_HEAD = (
    ("", "trials"), ("as it", "should"), ("right", "link"), ("position", "mm"), ("stated", "mm"),
    ("over", "stated"), ("orient.", "deg"), ("stated", "deg"), ("over", "stated"), ("NEES", "/6"),
    ("within", "2 sd"), ("left", ""), ("time", "s"),
)  # fmt: skip


def shortfalls(run: Run) -> list[str]:
    """What of one trial is not as it should be."""
    found, kind = run.outcome, run.case.kind
    if isinstance(found, Failure):
        return [str(found)]
    out = []
    if kind in ("sound", "specimen", "mount", "flange"):
        if found.named:
            out.append(f"names {', '.join(found.joints) or found.error}")
        if found.right_link is not None and found.right_link < 1:
            out.append(f"{found.right_link:.0%} of the SUs on their links")
        if found.turned is not (kind == "mount"):
            out.append("a mount named as turned" if found.turned else "a turned mount not named")
        if kind == "flange" and found.nees is not None and found.nees > BEYOND:
            out.append("two recordings contradict each other")
        if found.tilt_deg is not None and abs(found.tilt_deg - found.true_tilt_deg) > TILT:
            out.append(f"a mount off by {found.tilt_deg:.0f} deg, not {found.true_tilt_deg:.0f}")
    elif kind == "robot":
        if not found.error:
            out.append("another robot was taken for this one")
    elif found.joints != found.expected:
        out.append(f"names {', '.join(found.joints) or 'nothing'}, not {found.expected[0]}")
    return out


def report(runs: Sequence[Run]) -> str:
    """A row for each kind of model, and the trials that fell short."""
    if not runs:
        return "No trials.\n"
    rows = []
    for kind in KINDS:
        mine = [run for run in runs if run.case.kind == kind]
        if mine:
            rows.append((kind, _row(mine)))
    found = [(run.case.key, shortfalls(run)) for run in runs]
    return table("model", _HEAD, rows) + missed(found, "are not as they should be")


def _row(runs: Sequence[Run]) -> tuple[str, ...]:
    done = [run.outcome for run in runs if not isinstance(run.outcome, Failure)]
    good = sum(not shortfalls(run) for run in runs)
    links = [f.right_link for f in done if f.right_link is not None]
    n, within = sum(f.n_corrections for f in done), sum(f.n_within for f in done)
    place = _over(done, "position_mm"), _over(done, "position_stated_mm")
    turn = _over(done, "orientation_deg"), _over(done, "orientation_stated_deg")
    nees = [(f.nees, f.n_sus) for f in done if f.nees is not None]
    total = sum(k for _, k in nees)
    return (
        str(len(runs)),
        count(good, len(runs)),
        cell(sum(links) / len(links), 3) if links else cell(None, 3),
        cell(place[0], 3),
        cell(place[1], 3),
        cell(_ratio(*place), 2, RATIO),
        cell(turn[0], 4),
        cell(turn[1], 4),
        cell(_ratio(*turn), 2, RATIO),
        cell(sum(v * k for v, k in nees) / total if total else None, 2),
        cell(within / n if n else None, 3),
        cell(_mean([f.left for f in done]), 2),
        cell(_mean([f.seconds for f in done]), 1),
    )


def _over(done: Sequence[Found], name: str) -> float | None:
    """Root mean square over all determined SUs."""
    return rms(getattr(f, name) for f in done for _ in range(f.n_sus))


def _ratio(a: float | None, b: float | None) -> float | None:
    return a / b if a is not None and b else None


def _mean(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return sum(known) / len(known) if known else None
