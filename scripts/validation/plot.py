"""Three plots of all runs: error over bound, success, time."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from skin2urdf.errors import UsageError
from validation.records import Over, Run
from validation.summary import RATIO, converged


def save(runs: Iterable[Run], path: Path) -> None:
    """Write the plots into an image whose kind its suffix says.

    Args:
        runs: what to plot.
        path: image to write.

    Raises:
        UsageError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise UsageError("plots need matplotlib", "pip install matplotlib") from error
    matplotlib.use("Agg")
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator, NullFormatter, ScalarFormatter

    parts: dict[str, list[Run]] = {}
    for run in runs:
        of = run.case.circumstance
        parts.setdefault(f"{of.grade} {of.posture} {of.excite}", []).append(run)
    figure = Figure(figsize=(15, 4.5), layout="constrained")
    beyond, success, seconds = figure.subplots(1, 3)
    for i, (label, part) in enumerate(sorted(parts.items())):
        done = [run.figures for run in part if not run.failure]
        shift = 0.06 * (i - (len(parts) - 1) / 2)
        dofs = [figures.n_dofs + shift for figures in done]
        beyond.scatter(dofs, [_ratio(figures.determined) for figures in done], s=10, label=label)
        seconds.scatter(dofs, [f.calibration_seconds for f in done], s=10, label=label)
        good = [not run.failure and converged(run.figures) for run in part]
        success.barh(label, 100.0 * sum(good) / len(good), height=0.6)
        success.text(1.0, label, f"{sum(good)} of {len(good)}", va="center", color="white")
    beyond.axhline(1.0, color="grey", linewidth=0.8)
    beyond.axhline(RATIO, color="red", linewidth=0.8, linestyle="--")
    beyond.set(xlabel="DoFs", ylabel="SU position error over Cramer-Rao bound", yscale="log")
    success.set_ylim(-0.8, len(parts) - 0.2)
    success.set(xlabel="tree right and converged [%]", xlim=(0, 100))
    seconds.set(xlabel="DoFs", ylabel="time of a calibration [s]", ylim=(0, None))
    beyond.yaxis.set_major_formatter(ScalarFormatter())
    bottom, top = beyond.get_ylim()
    # Labels between powers of ten are needed within one of them, and in each other's way beyond.
    between = ScalarFormatter() if top < 10 * bottom else NullFormatter()
    beyond.yaxis.set_minor_formatter(between)
    for axes in (beyond, seconds):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    beyond.legend(fontsize="x-small")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    print(f"plots: {path}")


def _ratio(over: Over) -> float:
    """Position error over bound of one run; NaN where it has none."""
    if over.position_mm is None or not over.position_bound_mm:
        return float("nan")
    return over.position_mm / over.position_bound_mm
