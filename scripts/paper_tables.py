"""The tables and sentences that `reproduce_paper.py` prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from paper_errors import (
    LINK_NAMES,
    SU_NAMES,
    Run,
    Statistics,
    errors,
    in_true_gauge,
    model_of,
    parameters,
    su_errors,
    wrapped,
)

from skin2urdf.arrays import F64
from skin2urdf.estimation.paper_method import PaperSettings
from skin2urdf.estimation.paper_placements import DhTable
from skin2urdf.simulation import paper_case as case

SUSPECT = 0.1
"""Deviation [m or rad] from the truth that the paper highlights."""
PARALLEL = 0.1
"""Sine of an SU's alpha below which theta0 and theta_acc, d and d_acc are one sum each."""


@dataclass(frozen=True)
class Table:
    """A table of text; the first column is left-aligned, all others right-aligned.

    Attributes:
        title: a line above it.
        head: names of the columns.
        rows: cells; an empty row is a rule.
    """

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def plain(self) -> str:
        """Aligned with spaces."""
        cells = [self.head, *(row for row in self.rows if row)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(self.head))]

        def line(row: tuple[str, ...]) -> str:
            first = f"{row[0]:<{widths[0]}}"
            rest = (f"{c:>{w}}" for c, w in zip(row[1:], widths[1:], strict=True))
            return "  ".join((first, *rest)).rstrip()

        rule = "-" * (sum(widths) + 2 * (len(widths) - 1))
        body = [line(row) if row else rule for row in self.rows]
        return "\n".join([self.title, rule, line(self.head), rule, *body, rule])

    def markdown(self) -> str:
        """As a Markdown table."""

        def line(row: Sequence[str]) -> str:
            return "| " + " | ".join(row) + " |"

        marks = ("---", *("---:" for _ in self.head[1:]))
        body = [line(row) for row in self.rows if row]
        return "\n".join([f"**{self.title}**", "", line(self.head), line(marks), *body])


def parameter_tables(one: Run, truth: DhTable) -> list[Table]:
    """DoF-DoF and DoF-SU transformation parameters, as the paper arranges them."""
    shown = in_true_gauge(model_of(case.PRINTED_LINKS, case.PRINTED_SUS, case.TILT))
    head = (
        "",
        "true",
        "paper",
        "error",
        "ours, paper's method",
        "error",
        "ours, default",
        "error",
        "",
    )
    tables = []
    for links in (True, False):
        names = LINK_NAMES if links else SU_NAMES
        true = truth.links[1:] if links else truth.sus
        scanned = case.PRINTED_LINKS if links else case.PRINTED_SUS
        printed_error = (shown.links[1:] if links else shown.sus) - true
        ours = [
            None if t is None else (t.links[1:] if links else t.sus)
            for t in (one.paper_table, one.default_table)
        ]
        rows: list[tuple[str, ...]] = []
        for n in range(len(true)):
            rows += [()] if n else []
            for i, name in enumerate(names):
                open_ = n == 0 and (name == "d" or (links and name == "theta0"))
                ambiguous = not links and abs(np.sin(true[n, 3])) < PARALLEL
                ambiguous &= name in ("theta0", "d", "theta_acc", "d_acc")
                angle = name not in ("d", "a", "d_acc")
                where = f"DoF {n + 1}-{n + 2}" if links else f"DoF {n + 1} - SU {n + 1}"
                cells = [f"{where} {name}", f"{true[n, i]:.3f}", f"{scanned[n, i]:.3f}"]
                difference = float(wrapped(printed_error)[n, i] if angle else printed_error[n, i])
                cells.append("-" if open_ else f"{difference:+.3f}")
                for values in ours:
                    if values is None:
                        cells += ["-", "-"]
                        continue
                    error = values[n, i] - true[n, i]
                    error = float(wrapped(error)) if angle else float(error)
                    cells += [f"{values[n, i]:.4f}", "-" if open_ else f"{error:+.4f}"]
                note = "arbitrary" if open_ else "sum only" if ambiguous else ""
                if not note and abs(difference) > SUSPECT:
                    note = "scan?"
                rows.append((*cells, note))
        title = "DoF-DoF" if links else "DoF-SU"
        tables.append(Table(f"{title} transformation parameters [rad, m]", head, tuple(rows)))
    return tables


def placement_table(one: Run, truth: DhTable, settings: PaperSettings) -> Table:
    """SU parameters as placements, and what error function values the printed numbers have."""
    shown = in_true_gauge(model_of(case.PRINTED_LINKS, case.PRINTED_SUS, case.TILT))
    corrected = case.PRINTED_LINKS.copy()
    corrected[1, 1] *= -1.0
    tables = (shown, one.paper_table, one.default_table)
    cells = []
    for table in tables:
        if table is None:
            cells.append([("-", "-")] * case.N_DOFS)
            continue
        position, turn = (np.linalg.norm(e, axis=1) for e in su_errors(table, truth))
        digits = 0 if table is shown else 1
        cells.append(
            [
                (f"{1e3 * p:.{digits}f}", f"{np.rad2deg(r):.2f}")
                for p, r in zip(position, turn, strict=True)
            ]
        )
    rows = []
    for u in range(case.N_DOFS):
        e_T = (
            f"{printed_error(one, links, u, settings):.3f}"
            for links in (case.PRINTED_LINKS, corrected)
        )
        rows.append((f"SU {u + 1}", *(c for column in cells for c in column[u]), *e_T))
    head = ("", "paper mm", "deg", "paper's method mm", "deg", "default mm", "deg",
            "e_T of print", "with d_2 > 0")  # fmt: skip
    return Table("SU placements on their DoF: errors", head, tuple(rows))


def printed_error(one: Run, links: F64, u: int, settings: PaperSettings) -> float:
    """e_T [g^2] of the paper's printed numbers for SU u on this run's training data."""
    t, pattern = one.training, settings.pattern
    return sum(
        case.error_parts(
            links[:u],
            case.PRINTED_SUS[u],
            t.q[:, : u + 1],
            t.gravity[:, u],
            t.acceleration[:, u, : u + 1],
            settings.last_dofs,
            pattern.amplitude,
            pattern.frequency,
        )  # fmt: skip
    )


def step_table(one: Run) -> Table:
    """Optimization steps; the paper's columns as the scan shows them, one of seven is lost."""
    rows = []
    steps = one.paper.steps if one.paper else ()
    for n, step in enumerate(steps):
        scanned = case.PRINTED_STEPS[n] if n < len(case.PRINTED_STEPS) else None
        paper = (
            (f"{scanned[0]}", f"{scanned[1]:.3f}", f"{scanned[2]:.3f}") if scanned else ("?",) * 3
        )
        rows.append(
            (f"{n + 1}", *paper, f"{step.n_parameters}", f"{step.iterations}",
             f"{step.seconds:.3f}", f"{step.e_total:.3f}", f"{step.attempts}")
        )  # fmt: skip
    total = (f"{sum(s.iterations for s in steps)}", f"{sum(s.seconds for s in steps):.3f}")
    rows.append(())
    rows.append(
        ("total", f"{case.PAPER_ITERATIONS}", f"{case.PAPER_SECONDS:.0f}", "", "", *total, "", "")
    )
    head = ("step", "paper: iterations", "time [s]", "e_T", "ours: parameters", "iterations",
            "time [s]", "e_T [g^2]", "searches")  # fmt: skip
    return Table("Optimization steps (paper's method)", head, tuple(rows))


def printed(values: Sequence[float], length: Sequence[bool]) -> F64:
    """Values in mm and deg from m and rad."""
    return np.asarray(values) * np.where(np.asarray(length), 1e3, np.rad2deg(1.0))


def statistics_table(found: Statistics) -> Table:
    """Rms of every parameter beside its bound, and success and time."""
    names = parameters()
    length = [p.length for p in names]
    truth = in_true_gauge(model_of(case.TRUE_LINKS, case.TRUE_SUS, case.TILT))
    shown = in_true_gauge(model_of(case.PRINTED_LINKS, case.PRINTED_SUS, case.TILT))
    columns = [
        printed(values, length)
        for values in (
            errors(shown, truth),
            found.paper_rms,
            found.default_rms,
            found.bound,
            found.bound_known_sensors,
        )
    ]
    rows: list[tuple[str, ...]] = []
    for i, parameter in enumerate(names):
        one, ours, default, bound, known = (float(c[i]) for c in columns)
        unit = "mm" if parameter.length else "deg"
        rows.append(
            (f"{parameter.name} [{unit}]", f"{one:+.2f}", f"{ours:.3f}", f"{default:.3f}",
             f"{bound:.3f}", f"{default / bound:.2f}", f"{known:.3f}")
        )  # fmt: skip
    head = ("", "paper's error", "paper's method", "default", "bound", "default/bound",
            "bound, ideal sensors")  # fmt: skip
    return Table(f"Root mean square errors over {found.seeds} seeds", head, tuple(rows))


def summary(found: Statistics) -> list[str]:
    """Success and time in words."""
    n, default = found.seeds, found.default_seconds
    names = parameters()
    ratio = found.default_rms / found.bound
    link = np.array([p.link for p in names])
    shape = np.array([p.link and p.name.split()[-1] in ("a", "alpha") for p in names])
    lines = [
        f"default: global optimum in {found.default_optimum} of {n}; time median "
        f"{np.median(default):.3f} s, mean {default.mean():.3f} s, max {default.max():.3f} s",
        f"default rms over its bound: link lengths and twists {ratio[shape].min():.2f} to "
        f"{ratio[shape].max():.2f}, all link parameters up to {ratio[link].max():.2f}, "
        f"SU placements up to {ratio[~link].max():.2f}",
    ]
    if np.isfinite(found.paper_seconds).any():
        seconds = found.paper_seconds
        worse = int(np.sum(found.default_rms > found.paper_rms))
        lines += [
            f"paper's method: e_T below its stop in {found.paper_converged} of {n}; time median "
            f"{np.median(seconds):.2f} s, mean {seconds.mean():.2f} s, max {seconds.max():.2f} s "
            f"(paper: {case.PAPER_SECONDS:.0f} s)",
            f"ratio of times: median {np.median(seconds / default):.1f}, of means "
            f"{seconds.mean() / default.mean():.1f}; the paper's {case.PAPER_SECONDS:.0f} s over "
            f"our default {case.PAPER_SECONDS / np.median(default):.0f}",
            f"parameters in which the default's rms is larger than the paper's method's: {worse} of "
            f"{len(names)}",
        ]
    return lines
