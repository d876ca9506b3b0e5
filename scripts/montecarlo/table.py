"""The table: are errors as large as stated, and small enough where observable?"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from batch.figures import NONE, cell

from montecarlo.normalised import summed
from montecarlo.records import BLOCKS, Block, Figures, Run
from skin2urdf.geometry.units import MILLI_G

NEES = (0.9, 1.1)
"""Where the mean normalised squared error is to lie."""
COVERAGE = (93.0, 97.0)
"""Where the share of coordinates within two standard deviations is to lie [%]."""
ACCURACY = {
    "bias": (1 / MILLI_G, "mg", 1.0),
    "scale": (100.0, "%", 0.1),
    "latency": (1e3, "ms", 0.2),
}
"""Of what is observable: unit, its name, and the rms error to be reached."""


def report(runs: Iterable[Run]) -> str:
    """All groups of runs, one under the other; misses are marked by an exclamation mark."""
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(run.case.group, []).append(run)
    return "\n".join(_group(name, members) for name, members in groups.items()) or "No runs.\n"


def nees(blocks: Sequence[Block]) -> tuple[float, float]:
    """Normalised squared error per direction over recordings, and its standard error.

    Recordings are independent of each other; what is in one is not.
    """
    squared = np.array([b.squared for b in blocks])
    dimensions = np.array([b.dimensions for b in blocks], dtype=np.float64)
    mean = float(squared.sum() / max(dimensions.sum(), 1.0))
    scatter = float(np.sqrt(np.sum((squared - mean * dimensions) ** 2)))
    return mean, scatter / max(float(dimensions.sum()), 1.0)


def _group(name: str, runs: Sequence[Run]) -> str:
    good = [run.figures for run in runs if not run.failure]
    lines = [f"{name}: {len(good)} recordings, cost per degree of freedom {_cost(good)}"]
    lines += [f"  {run.case.key}: {run.failure}" for run in runs if run.failure]
    lines.append(f"{'':24}{'NEES':>6}{'':10}{'in 2 sigma':>12}{'rms where observable':>24}")
    for name in BLOCKS if good else ():
        lines.append(_line(name, [one.blocks[name] for one in good if name in one.blocks]))
    return "\n".join(lines) + "\n"


def _cost(good: Sequence[Figures]) -> str:
    return cell(float(np.mean([figures.cost_per_dof for figures in good])), 2) if good else NONE


def _line(name: str, blocks: Sequence[Block]) -> str:
    whole = summed(blocks)
    if not whole.dimensions:
        return f"{name:24}{NONE:>6}"
    mean, error = nees(blocks)
    inside = 100 * whole.inside / whole.coordinates
    text = f"{name:24}{mean:6.2f}{_mark(mean, NEES)}+- {error:4.2f}"
    text += f"{inside:11.1f} %{_mark(inside, COVERAGE)}"
    if name in ACCURACY and whole.observable:
        factor, unit, largest = ACCURACY[name]
        error = factor * float(np.sqrt(np.mean(whole.observable)))
        text += f"{error:12.4f} {unit}{'!' if error > largest else ''} ({len(whole.observable)})"
    return text


def _mark(value: float, target: tuple[float, float]) -> str:
    return " " if target[0] <= value <= target[1] else "!"
