"""The summary as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from batch.figures import NONE, cell, count, missed, table

from validation.records import Run
from validation.summary import CONVERGED, OUTLIER, RATIO, TARGETS, Group, grouped, shortfalls

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
    return "\n".join(
        [
            _table("robot and circumstance", grouped(runs, _by_robot)),
            _table("all robots", grouped(_by_kind(runs), _by_circumstance)),
            _legend(),
            _missed(runs),
        ]
    )


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
    text = table(title, _HEAD, list(zip(labels, map(_row, groups), strict=True)))
    if shared:
        text += f"(all of them: {' '.join(word for word in groups[0].label if word in shared)})\n"
    return text


def _row(g: Group) -> tuple[str, ...]:
    t = g.target
    return (
        _span(g.n_dofs),
        _span(g.n_sus),
        str(g.n_runs),
        count(g.n_tree, g.n_runs),
        count(g.n_converged, g.n_runs),
        cell(g.cost_per_dof, 2, CONVERGED),
        cell(g.position_mm, 3, t.position_mm),
        cell(g.position_all_mm, 3),
        cell(g.position_ratio, 2, RATIO),
        cell(g.orientation_deg, 4, t.orientation_deg),
        cell(g.orientation_all_deg, 4),
        cell(g.orientation_ratio, 2, RATIO),
        cell(g.beside_floor_deg, 4),
        cell(g.beside_floor_ratio, 2, RATIO),
        cell(g.axis_angle_deg, 4, t.axis_angle_deg),
        cell(g.axis_distance_mm, 3),
        NONE if g.n_open is None else str(g.n_open),
        cell(g.seconds, 2),
    )


def _span(numbers: tuple[int, int] | None) -> str:
    if numbers is None:
        return NONE
    low, high = numbers
    return str(low) if low == high else f"{low} to {high}"


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
    return missed(
        [(run.case.key, shortfalls(run)) for run in runs],
        f"failed, missed a target, or lie beyond {OUTLIER:g} times their bound",
    )
