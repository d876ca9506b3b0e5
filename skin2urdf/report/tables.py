"""Plain tables: columns that line up, without colour or trailing spaces."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import zip_longest
from typing import Literal

import numpy as np

Align = Literal["<", ">"]

_WIDTH: ContextVar[int | None] = ContextVar("width", default=None)
_NARROWEST = 8
"""Characters that a column of words keeps at least."""


@contextmanager
def fitting(width: int | None) -> Iterator[None]:
    """Lay tables out for so many columns of a terminal; for None, as wide as they are.

    Args:
        width: characters in a line.
    """
    before = _WIDTH.set(width)
    try:
        yield
    finally:
        _WIDTH.reset(before)


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
    width = _WIDTH.get()
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    if width is None or sum(widths) + 2 * (len(widths) - 1) <= width:
        return _laid_out([head, *rows], [1] * (len(rows) + 1), widths, align, "  ")
    return _fitted(head, rows, align, width)


def _laid_out(
    cells: Sequence[Sequence[str]],
    heights: Sequence[int],
    widths: Sequence[int],
    align: Sequence[Align] | str,
    gap: str,
) -> list[str]:
    """Lines of cells that fit their columns, with a rule under those of the first row."""
    lines = [
        gap.join(
            f"{cell:{side}{width}}" for cell, side, width in zip(row, align, widths, strict=True)
        ).rstrip()
        for row in cells
    ]
    rule = "-" * (sum(widths) + len(gap) * (len(widths) - 1))
    return [*lines[: heights[0]], rule, *lines[heights[0] :]]


def _fitted(
    head: Sequence[str], rows: Sequence[Sequence[str]], align: Sequence[Align] | str, width: int
) -> list[str]:
    """Lines of a table that is too wide: titles and words are wrapped, then columns are parted.

    Every part begins with the first column, by which rows are known.
    """
    sides = list(align)
    widths = [
        max(
            max((len(piece) for piece in _pieces(title)), default=0),
            max((len(row[i]) for row in rows), default=0),
        )
        for i, title in enumerate(head)
    ]
    words = [i for i, side in enumerate(sides) if side == "<"]
    while sum(widths) + len(widths) - 1 > width:
        widest = max(words, key=lambda i: widths[i], default=None)
        if widest is None or widths[widest] <= _NARROWEST:
            break
        widths[widest] -= 1
    if sum(widths) + len(widths) - 1 > width and len(widths) > 2:
        room = np.cumsum([widths[0], *(w + 1 for w in widths[1:])])
        first = max(2, int(np.searchsorted(room, width, side="right")))
        parts = [list(range(first)), [0, *range(first, len(widths))]]
        chosen = [
            ([line[i] for i in part], [[row[i] for i in part] for row in rows], part)
            for part in parts
            for line in [head]
        ]
        blocks = [_fitted(h, r, [sides[i] for i in part], width) for h, r, part in chosen]
        return [*blocks[0], "", *blocks[1]]
    cells: list[Sequence[str]] = []
    heights = []
    for row in (head, *rows):
        wrapped = [_broken(cell, size) for cell, size in zip(row, widths, strict=True)]
        lines = list(zip_longest(*wrapped, fillvalue=""))
        cells += lines
        heights.append(len(lines))
    return _laid_out(cells, heights, widths, align, " ")


def _pieces(text: str) -> list[str]:
    """The parts of a text that stay whole: it may be broken at spaces, and behind / _ and -."""
    return re.findall(r"[^\s/_-]*[/_-]|[^\s/_-]+", text)


def _broken(text: str, width: int) -> list[str]:
    """A cell in lines of at most some width."""
    if len(text) <= width:
        return [text]
    lines = [""]
    for token in re.findall(r"\s+|[^\s/_-]*[/_-]|[^\s/_-]+", text):
        if len(lines[-1] + token.rstrip()) <= width:
            lines[-1] += token
            continue
        rest = token.strip()
        while rest:
            lines.append(rest[:width])
            rest = rest[width:]
    return [line.strip() for line in lines if line.strip()]


def number(value: float, digits: int = 2) -> str:
    """A number with a fixed number of digits, a dash where there is none."""
    # Adding 0 turns -0 into 0.
    return f"{round(value, digits) + 0.0:.{digits}f}" if np.isfinite(value) else "-"


def count(n: int, noun: str) -> str:
    """So many of something, as ``1 SU`` or ``2 SUs``."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def span(low: float, high: float, digits: int = 0) -> str:
    """A range, as ``-90 .. 45``."""
    return f"{number(low, digits)} .. {number(high, digits)}"


def bullets(title: str, items: Sequence[str]) -> list[str]:
    """A titled list after an empty line; nothing where there are no items."""
    return ["", f"{title}:", *(f"  - {item}" for item in items)] if items else []
