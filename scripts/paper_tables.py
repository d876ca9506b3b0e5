"""The tables and sentences that `reproduce_paper.py` prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from paper_errors import (
    LENGTHS,
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
from skin2urdf.paper import case
from skin2urdf.paper.method import PaperSettings
from skin2urdf.paper.placements import DhTable

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


def parameter_tables(one: Run) -> list[Table]:
    """DoF-DoF and DoF-SU transformation parameters, as the paper arranges them."""
    tables = []
    for links in (True, False):
        true = case.TRUE_LINKS if links else case.TRUE_SUS
        scanned = case.PRINTED_LINKS if links else case.PRINTED_SUS
        columns: list[F64 | None] = [scanned]
        for table in (one.paper_table, one.default_table):
            values = None if table is None else (table.links[1:] if links else table.sus)
            columns.append(values)
        rows: list[tuple[str, ...]] = []
        for n in range(len(true)):
            if n:
                rows.append(())
            rows += _rows_of_one(n, links, true[n], [None if c is None else c[n] for c in columns])
        title = f"{'DoF-DoF' if links else 'DoF-SU'} transformation parameters [rad, m]"
        tables.append(Table(title, _PARAMETER_HEAD, tuple(rows)))
    return tables


_PARAMETER_HEAD = (
    "", "true", "paper", "error", "ours, paper's method", "error", "ours, default", "error", "",
)  # fmt: skip


def _rows_of_one(
    n: int, links: bool, true: F64, columns: Sequence[F64 | None]
) -> list[tuple[str, ...]]:
    """Rows of one transform; near-parallel SUs get the sums that mean something."""
    names = LINK_NAMES if links else SU_NAMES
    where = f"DoF {n + 1}-{n + 2}" if links else f"DoF {n + 1} - SU {n + 1}"
    parallel = not links and abs(np.sin(true[3])) < PARALLEL
    rows = []
    for i, name in enumerate(names):
        arbitrary = n == 0 and name in (("theta0", "d") if links else ("d",))
        ambiguous = parallel and name in ("theta0", "d", "theta_acc", "d_acc")
        note = "arbitrary" if arbitrary else "ambiguous" if ambiguous else ""
        gauge = n == 0 and name == "theta0" and not note
        values = [None if c is None else float(c[i]) for c in columns]
        row = _row(f"{where} {name}", float(true[i]), values, name not in LENGTHS, note)
        rows.append((*row[:3], "-", *row[4:-1], "paper: with theta0_1 = 0") if gauge else row)
    if parallel:
        for name, i, k in (("theta0 + theta_acc", 0, 4), ("d + d_acc", 1, 5)):
            values = [None if c is None else float(c[i] + c[k]) for c in columns]
            rows.append(_row(f"{where} {name}", float(true[i] + true[k]), values, i == 0, ""))
    return rows


def _row(
    label: str, true: float, values: Sequence[float | None], angle: bool, note: str
) -> tuple[str, ...]:
    """One parameter: the scanned number with 3 digits, ours with 4, and errors unless noted."""
    cells, remark = [label, f"{true:.3f}"], note
    for n, value in enumerate(values):
        if value is None:
            cells += ["-", "-"]
            continue
        digits = 4 if n else 3
        error = float(wrapped(np.array(value - true))) if angle else value - true
        cells += [f"{value:.{digits}f}", "-" if note else f"{error:+.{digits}f}"]
        if n == 0 and not note and abs(error) > SUSPECT:
            remark = "scan?"
    return (*cells, remark)


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
    rows: list[tuple[str, ...]] = []
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
        )
    )


def step_table(one: Run) -> Table:
    """Optimization steps; the paper's columns as the scan shows them, one of seven is lost."""
    rows: list[tuple[str, ...]] = []
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


def printed(values: F64, length: Sequence[bool]) -> F64:
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
            found.bound_unknown_sensors,
        )
    ]
    rows: list[tuple[str, ...]] = []
    for i, parameter in enumerate(names):
        scanned, ours, default, bound, unknown = (float(c[i]) for c in columns)
        unit = "mm" if parameter.length else "deg"
        rows.append(
            (
                f"{parameter.name} [{unit}]", f"{scanned:+.2f}",
                f"{ours:.3f}" if np.isfinite(ours) else "-", f"{default:.3f}",
                f"{bound:.3f}", f"{default / bound:.2f}", f"{unknown:.3f}",
            )
        )  # fmt: skip
    head = (
        "", "paper's error", "paper's method", "default", "bound", "default/bound",
        "bound, sensors unknown",
    )  # fmt: skip
    return Table(f"Root mean square errors over {found.seeds} seeds", head, tuple(rows))


def summary(found: Statistics) -> list[str]:
    """Success and time in words."""
    n, default = found.seeds, found.default_seconds
    names = parameters()
    ratio = found.default_rms / found.bound
    link = np.array([p.link for p in names])
    shape = np.array([p.link and p.name.split()[-1] in ("a", "alpha") for p in names])
    unknown = found.default_rms / found.bound_unknown_sensors
    lines = [
        f"default: global optimum in {found.default_optimum} of {n}; time median "
        f"{np.median(default):.3f} s, mean {default.mean():.3f} s, max {default.max():.3f} s "
        f"(processor time median {np.median(found.default_cpu):.3f} s)",
        f"default rms over its bound: link lengths and twists {ratio[shape].min():.2f} to "
        f"{ratio[shape].max():.2f}, all link parameters up to {ratio[link].max():.2f}",
        f"SU placements: up to {ratio[~link].max():.2f} times the bound for ideal sensors, "
        f"{unknown[~link].max():.2f} times that for sensors with unknown bias and scale",
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
            f"parameters in which the default's rms is larger than the paper's method's: "
            f"{worse} of {len(names)}",
        ]
    return lines
