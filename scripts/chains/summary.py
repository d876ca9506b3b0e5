"""What became of many chains, in a table and in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from batch.figures import NONE

from chains.judge import Judged, Outcome, outcome_of

_SHOWN = 20


def report(records: Sequence[Judged]) -> str:
    """A table by number of DoFs and by kind, and the failures by seed."""
    outcomes = [outcome_of(record) for record in records]
    if not outcomes:
        return "No chains.\n"
    head = (
        f"{'':<22}{'chains':>8}{'optimum':>9}{'share':>10}{'median':>9}{'p99':>8}"
        f"{'structure':>11}{'unseen':>8}"
    )
    units = f"{'':<22}{'':>8}{'found':>9}{'%':>10}{'s':>9}{'s':>8}{'found %':>11}{'told %':>8}"
    lines = [head, units, "-" * len(head)]
    groups: tuple[Callable[[Outcome], str], ...] = (
        lambda o: f"{o.dofs} DoFs",
        lambda o: f"first axis {o.kind[0]}",
        lambda o: f"SUs: {o.kind[1]}",
        lambda o: f"measured: {o.kind[2]}",
        lambda _: "all",
    )
    for group in groups:
        names = sorted({group(o) for o in outcomes})
        lines += [_row(name, [o for o in outcomes if group(o) == name]) for name in names]
        lines.append("")
    return "\n".join(lines + _failures(outcomes)) + "\n"


def _row(name: str, some: Sequence[Outcome]) -> str:
    found = sum(not o.failed for o in some)
    seconds = np.array([o.seconds for o in some])
    looked = [o.tree for o in some if o.tree is not None]
    structure = f"{100 * sum(looked) / len(looked):.1f}" if looked else NONE
    hidden = [o.told >= o.open for o in some if not o.error]
    told = f"{100 * sum(hidden) / len(hidden):.1f}" if hidden else NONE
    return (
        f"{name:<22}{len(some):>8}{found:>9}{100 * found / len(some):>10.3f}"
        f"{np.median(seconds):>9.3f}{np.quantile(seconds, 0.99):>8.2f}{structure:>11}{told:>8}"
    )


def _failures(outcomes: Sequence[Outcome]) -> list[str]:
    failed = [o for o in outcomes if o.failed]
    hidden = [o for o in failed if not o.recognised]
    lines = [
        f"{len(failed)} of {len(outcomes)} chains are not at the global optimum; "
        f"{len(failed) - len(hidden)} of these have a cost that says so, or are refused in words."
    ]
    lines += [f"  chain {o.seed}: {shortfall(o)}" for o in failed[:_SHOWN]]
    if len(failed) > _SHOWN:
        lines.append(f"  and {len(failed) - _SHOWN} others")
    return lines


def shortfall(outcome: Outcome) -> str:
    """What is wrong with a chain that failed."""
    cost = f"cost per degree of freedom {outcome.cost_per_dof:.2f}"
    return (
        f"{outcome.dofs} DoFs, {outcome.sus} SUs, {', '.join(outcome.kind)}: "
        + (outcome.error or f"{cost}, normalised error {outcome.agreement:.1f}")
        + ("" if outcome.recognised else "  NOT RECOGNISED")
    )
