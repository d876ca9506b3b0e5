"""Figures over records, and how they stand in a table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

NONE = "-"
"""What a cell shows where there is no figure."""


def rms(values: Iterable[float | None]) -> float | None:
    """Root mean square of the finite values; None where there is none."""
    squares = [v * v for v in values if v is not None and math.isfinite(v)]
    return math.sqrt(sum(squares) / len(squares)) if squares else None


def pairs(rows: Iterable[tuple[float | None, float | None]]) -> list[tuple[float, float]]:
    """Those rows that have both figures, finite."""
    return [
        (a, b)
        for a, b in rows
        if a is not None and b is not None and math.isfinite(a) and math.isfinite(b)
    ]


def ratio(rows: Iterable[tuple[float | None, float | None]]) -> float | None:
    """Root mean square of the first figures over that of the second, over rows that have both.

    A mean of ratios would be ruled by the rows whose second figure is smallest.
    """
    both = pairs(rows)
    above, below = rms(a for a, _ in both), rms(b for _, b in both)
    return above / below if above is not None and below else None


def cell(value: float | None, digits: int, limit: float | None = None) -> str:
    """A figure with so many decimals, and ``!`` where it exceeds a limit."""
    if value is None or math.isnan(value):
        return NONE
    return f"{value:.{digits}f}" + ("!" if limit is not None and value > limit else "")


def short(value: float | None, limit: float | None = None) -> str:
    """A figure with three digits that count, and ``!`` where it exceeds a limit."""
    if value is None or math.isnan(value):
        return NONE
    return f"{value:.3g}" + ("!" if limit is not None and value > limit else "")


def count(n: int, of: int) -> str:
    """How many of all, with ``!`` where it is not all."""
    return str(n) if n == of else f"{n}!"


def table(
    title: str, heads: Sequence[tuple[str, str]], rows: Sequence[tuple[str, Sequence[str]]]
) -> str:
    """Lines of a table.

    Args:
        title: above the labels.
        heads: two lines of words above each column.
        rows: label and cells of each row.
    """
    first = max(len(title), *(len(label) for label, _ in rows), 0)
    widths = [
        max(len(above), len(below), *(len(cells[i]) for _, cells in rows), 0) + 2
        for i, (above, below) in enumerate(heads)
    ]

    def line(label: str, cells: Iterable[str]) -> str:
        aligned = (text.rjust(width) for text, width in zip(cells, widths, strict=True))
        return (label.ljust(first) + "".join(aligned)).rstrip()

    lines = [
        line(title, (above for above, _ in heads)),
        line("", (below for _, below in heads)),
        "-" * (first + sum(widths)),
        *(line(label, cells) for label, cells in rows),
    ]
    return "\n".join(lines) + "\n"


def missed(found: Sequence[tuple[str, Sequence[str]]], what: str) -> str:
    """Lines on the runs that fell short.

    Args:
        found: key and shortfalls of every run.
        what: what those that have any do, behind "3 of 4 runs".
    """
    lines = [f"  {key}: {'; '.join(reasons)}" for key, reasons in found if reasons]
    if not lines:
        return f"No run of {len(found)} missed anything.\n"
    return "\n".join([f"{len(lines)} of {len(found)} runs {what}:", *lines]) + "\n"
