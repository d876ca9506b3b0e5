"""The summary as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from validation.records import Run
from validation.summary import (
    CONVERGED,
    OUTLIER,
    RATIO,
    TARGETS,
    Group,
    grouped,
    misses,
)

_HEAD = (
    ("", "DoFs"), ("", "SUs"),
    ("", "runs"), ("tree", "right"), ("con-", "verged"), ("cost", "per dof"),
    ("position", "mm"), ("all SUs", "mm"), ("over", "bound"),
    ("orient.", "deg"), ("all SUs", "deg"), ("over", "bound"),
    ("no floor", "deg"), ("over", "bound"),
    ("axes", "deg"), ("axes", "mm"), ("open", ""), ("time", "s"),
)  # fmt: skip


def report(runs: Iterable[Run]) -> str:
    """Tables per robot and in total, and the runs that missed."""
    runs = sorted(runs, key=lambda run: (run.case.robot, run.case.circumstance.words))
    if not runs:
        return "No runs.\n"
    parts = [
        _table("robot and circumstance", grouped(runs, _by_robot)),
        _table("all robots", grouped(_by_kind(runs), _by_circumstance)),
        _legend(),
        _missed(runs),
    ]
    codes = {run.code for run in runs if run.code}
    if len(codes) > 1:
        parts.append(
            f"These runs come from {len(codes)} states of the code; give a fresh --output to "
            "measure one.\n"
        )
    return "\n".join(parts)


def _by_robot(run: Run) -> tuple[str, ...]:
    return (run.case.robot, *run.case.circumstance.words)


def _by_circumstance(run: Run) -> tuple[str, ...]:
    return run.case.circumstance.words


def _by_kind(runs: Iterable[Run]) -> list[Run]:
    return sorted(runs, key=_by_circumstance)


def _table(title: str, groups: Sequence[Group]) -> str:
    """Lines of a table, one row per group; `!` marks what falls short."""
    shared = set.intersection(*(set(group.label) for group in groups))
    if len(groups) == 1:
        shared = set()
    labels = [" ".join(word for word in group.label if word not in shared) for group in groups]
    rows = [_row(group) for group in groups]
    width = max(len(title), *map(len, labels))
    widths = [
        max(len(a), len(b), *(len(row[i]) for row in rows)) + 2 for i, (a, b) in enumerate(_HEAD)
    ]
    heads = [
        title.ljust(width) + "".join(a.rjust(w) for (a, _), w in zip(_HEAD, widths, strict=True)),
        " " * width + "".join(b.rjust(w) for (_, b), w in zip(_HEAD, widths, strict=True)),
    ]
    body = [
        label.ljust(width) + "".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True))
        for label, row in zip(labels, rows, strict=True)
    ]
    lines = [*heads, "-" * max(map(len, heads)), *body]
    if shared:
        common = " ".join(word for word in groups[0].label if word in shared)
        lines.append(f"(all of them: {common})")
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _row(g: Group) -> tuple[str, ...]:
    t = g.target
    return (
        _span(g.n_dofs),
        _span(g.n_sus),
        str(g.n_runs),
        _count(g.n_tree, g.n_runs),
        _count(g.n_converged, g.n_runs),
        _cell(g.cost_per_dof, CONVERGED, 2),
        _cell(g.position_mm, t.position_mm, 3),
        _cell(g.position_all_mm, None, 3),
        _cell(g.position_ratio, RATIO, 2),
        _cell(g.orientation_deg, t.orientation_deg, 4),
        _cell(g.orientation_all_deg, None, 4),
        _cell(g.orientation_ratio, RATIO, 2),
        _cell(g.beside_floor_deg, None, 4),
        _cell(g.beside_floor_ratio, RATIO, 2),
        _cell(g.axis_angle_deg, t.axis_angle_deg, 4),
        _cell(g.axis_distance_mm, None, 3),
        "-" if g.n_open is None else str(g.n_open),
        _cell(g.seconds, None, 2),
    )


def _span(numbers: tuple[int, int] | None) -> str:
    if numbers is None:
        return "-"
    low, high = numbers
    return str(low) if low == high else f"{low} to {high}"


def _count(n: int, of: int) -> str:
    return str(n) if n == of else f"{n}!"


def _cell(value: float | None, limit: float | None, digits: int) -> str:
    if value is None:
        return "-"
    return f"{value:.{digits}f}" + ("!" if limit is not None and value > limit else "")


def _legend() -> str:
    targets = "; ".join(
        f"{grade}: "
        + ", ".join(
            f"{what} {limit:g} {unit}"
            for what, unit, limit in (
                ("position", "mm", t.position_mm),
                ("orientation", "deg", t.orientation_deg),
                ("axes", "deg", t.axis_angle_deg),
            )
            if limit is not None
        )
        for grade, t in TARGETS.items()
    )
    return (
        "Root mean squares over seeds, SUs and random configurations, of runs with the right tree; "
        "limbs aligned by their\ndetermined SUs, unobservable directions left out. Position and "
        "orientation are over the SUs whose placement is\ndetermined, in the column beside over "
        "all as far as observable. Over bound: rms error over rms Cramer-Rao bound\nat the noise "
        "of the residuals, determined SUs. The floor is the rotation inside a sensor's cross-axis "
        "errors, which\nno log can tell: it counts in the bound of "
        '"orient.", and is taken out of the error in "no floor". Open: directions of the\njoints '
        "that a log leaves open, at most. Cost and time are medians; time is of the calibration "
        "alone. To be reached\n(base tilted, 17 bit): "
        f"{targets}.\nIn all: every tree right, cost per dof below {CONVERGED:g}, errors within "
        f"{RATIO:g} times their bound. ! marks what is not.\n"
    )


def _missed(runs: Sequence[Run]) -> str:
    found = misses(runs)
    if not found:
        return f"No run of {len(runs)} missed anything.\n"
    lines = [f"  {miss.key}: {'; '.join(miss.reasons)}" for miss in found]
    head = f"{len(found)} of {len(runs)} runs failed, missed a target, or lie beyond "
    return "\n".join([f"{head}{OUTLIER:g} times their bound:", *lines]) + "\n"
