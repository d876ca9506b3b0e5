"""Plain tables: columns that line up, without colour or trailing spaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

Align = Literal["<", ">"]


def table(
    head: Sequence[str], rows: Sequence[Sequence[str]], align: Sequence[Align] | str
) -> list[str]:
    """Lines of a table with a rule under its head.

    Args:
        head: column titles.
        rows: cells, as many in each row as there are titles.
        align: per column ``<`` for left or ``>`` for right.

    Returns:
        Lines of text.
    """
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    lines = [
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(row, align, widths, strict=True)
        )
        for row in (head, *rows)
    ]
    rule = "-" * (sum(widths) + 2 * (len(widths) - 1))
    return [line.rstrip() for line in (lines[0], rule, *lines[1:])]


def number(value: float, digits: int = 2) -> str:
    """A number with a fixed number of digits, a dash where there is none."""
    # Adding 0 turns -0 into 0.
    return f"{round(value, digits) + 0.0:.{digits}f}" if np.isfinite(value) else "-"


def span(low: float, high: float, digits: int = 0) -> str:
    """A range, as ``-90 .. 45``."""
    return f"{number(low, digits)} .. {number(high, digits)}"


def bullets(title: str, items: Sequence[str]) -> list[str]:
    """A titled list after an empty line; nothing where there are no items."""
    return ["", f"{title}:", *(f"  - {item}" for item in items)] if items else []
