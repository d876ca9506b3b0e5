"""Runs taken together: figures per robot and circumstance, what must be reached, what missed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from batch.figures import ratio, rms, short

from validation.records import Figures, Over, Run

CONVERGED = 2.0
"""Cost per degree of freedom below which a run has converged."""
RATIO = 1.5
"""Largest error over its bound, both rms over seeds."""
OUTLIER = 2.5
"""Error over bound beyond which a single run is looked at."""


@dataclass(frozen=True)
class Target:
    """What must be reached with a grade, base tilted and 17-bit encoders; None for no target.

    Attributes:
        position_mm: SU position [mm].
        orientation_deg: SU orientation [deg].
        axis_angle_deg: joint axes [deg].
    """

    position_mm: float | None = None
    orientation_deg: float | None = None
    axis_angle_deg: float | None = None


TARGETS: Mapping[str, Target] = {
    "mems": Target(position_mm=0.5, orientation_deg=0.05),
    "bma150": Target(position_mm=1.5, orientation_deg=0.6, axis_angle_deg=0.1),
}


def target_of(run: Run) -> Target:
    """What a run must reach."""
    of = run.case.circumstance
    demanding = of.posture == "tilted" and of.encoder_bits in (17, None)
    return TARGETS.get(of.grade, Target()) if demanding else Target()


@dataclass(frozen=True)
class Group:
    """Runs of one kind taken together; None where no run tells.

    Attributes:
        label: words that name the group.
        target: what it must reach.
        n_dofs: fewest and most DoFs of a robot; None where no run finished.
        n_sus: the same for the SUs that are compared.
        n_runs: number of runs.
        n_tree: with the right tree.
        n_converged: with the right tree and a cost per degree of freedom below ``CONVERGED``.
        cost_per_dof: median.
        position_mm: rms over runs and SUs that are determined [mm].
        position_all_mm: over all SUs, as far as observable [mm].
        position_ratio: rms error over rms bound, over SUs that are determined.
        orientation_deg: over SUs that are determined [deg].
        orientation_all_deg: over all SUs, as far as observable [deg].
        orientation_ratio: rms error over rms bound, the bound with the sensor's own rotation.
        beside_floor_deg: orientation with the sensor's own rotation taken out [deg].
        beside_floor_ratio: its ratio, the bound without that rotation.
        axis_angle_deg: joint axes [deg].
        axis_distance_mm: their lines [mm].
        n_open: most directions of the joints that a log leaves open.
        seconds: median time of a calibration [s].
    """

    label: tuple[str, ...]
    target: Target
    n_dofs: tuple[int, int] | None
    n_sus: tuple[int, int] | None
    n_runs: int
    n_tree: int
    n_converged: int
    cost_per_dof: float | None
    position_mm: float | None
    position_all_mm: float | None
    position_ratio: float | None
    orientation_deg: float | None
    orientation_all_deg: float | None
    orientation_ratio: float | None
    beside_floor_deg: float | None
    beside_floor_ratio: float | None
    axis_angle_deg: float | None
    axis_distance_mm: float | None
    n_open: int | None
    seconds: float | None


def converged(figures: Figures) -> bool:
    """Whether a run found the right tree and a model that explains its data."""
    cost = figures.cost_per_dof
    return figures.tree_right and cost is not None and cost < CONVERGED


def grouped(runs: Iterable[Run], label: Callable[[Run], tuple[str, ...]]) -> list[Group]:
    """Groups of the runs with equal labels, in the order of their first run."""
    parts: dict[tuple[str, ...], list[Run]] = {}
    for run in runs:
        parts.setdefault(label(run), []).append(run)
    return [_group(name, part) for name, part in parts.items()]


def _group(label: tuple[str, ...], runs: Sequence[Run]) -> Group:
    done = [run.figures for run in runs if not run.failure]
    right = [figures for figures in done if figures.tree_right]
    every = [figures.every for figures in right]
    determined = [figures.determined for figures in right]
    targets = {target_of(run) for run in runs}
    costs = [f.cost_per_dof for f in done if f.cost_per_dof is not None]
    return Group(
        label=label,
        target=targets.pop() if len(targets) == 1 else Target(),
        n_dofs=_span(f.n_dofs for f in done),
        n_sus=_span(f.every.n for f in done),
        n_runs=len(runs),
        n_tree=len(right),
        n_converged=sum(map(converged, done)),
        cost_per_dof=median(costs) if costs else None,
        position_mm=rms(o.position_mm for o in determined),
        position_all_mm=rms(o.position_mm for o in every),
        position_ratio=_ratio(determined, "position_mm", "position_bound_mm"),
        orientation_deg=rms(o.orientation_deg for o in determined),
        orientation_all_deg=rms(o.orientation_deg for o in every),
        orientation_ratio=_ratio(determined, "orientation_deg", "orientation_bound_deg"),
        beside_floor_deg=rms(o.orientation_beside_floor_deg for o in determined),
        beside_floor_ratio=_ratio(
            determined, "orientation_beside_floor_deg", "orientation_bound_beside_floor_deg"
        ),
        axis_angle_deg=rms(f.axis_angle_deg for f in right),
        axis_distance_mm=rms(f.axis_distance_mm for f in right),
        n_open=max((f.n_open for f in right), default=None),
        seconds=median(f.calibration_seconds for f in done) if done else None,
    )


def _span(numbers: Iterable[int]) -> tuple[int, int] | None:
    """Smallest and largest of some numbers."""
    numbers = tuple(numbers)
    return (min(numbers), max(numbers)) if numbers else None


def _ratio(overs: Iterable[Over], error: str, bound: str) -> float | None:
    """Rms of an error over rms of its bound, over runs that have both."""
    return ratio((getattr(over, error), getattr(over, bound)) for over in overs)


def shortfalls(run: Run) -> list[str]:
    """What is wrong with a run, in words; empty where nothing is."""
    if run.failure:
        return [str(run.failure)]
    figures = run.figures
    if not figures.tree_right:
        return ["the tree is wrong: " + "; ".join(figures.tree_differences)]
    if not converged(figures):
        return [f"cost per degree of freedom {short(figures.cost_per_dof)}"]
    over, target = figures.determined, target_of(run)
    checks = (
        ("position", "mm", over.position_mm, target.position_mm),
        ("orientation", "deg", over.orientation_deg, target.orientation_deg),
        ("axes", "deg", figures.axis_angle_deg, target.axis_angle_deg),
    )
    words = [
        f"{name} {value:.3g} {unit} where {limit:g} {unit} must be reached"
        for name, unit, value, limit in checks
        if value is not None and limit is not None and value > limit
    ]
    ratios = (
        ("position", _ratio([over], "position_mm", "position_bound_mm")),
        (
            "orientation",
            _ratio([over], "orientation_beside_floor_deg", "orientation_bound_beside_floor_deg"),
        ),
    )
    words += [
        f"{name} {times:.1f} times its bound"
        for name, times in ratios
        if times is not None and times > OUTLIER
    ]
    return words
