"""Panels: parts of a figure that know their size before they are drawn."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import Protocol

from skin2urdf.report.canvas import Canvas, Point, line_height, text_width
from skin2urdf.report.labels import wrapped
from skin2urdf.report.style import FAINT, HEADING, INK, NORMAL

_GAP = 0.1
"""Between a note and what it is about [in]."""
_LEAST_WIDTH = 2.6
"""Of a note [in]."""


class Panel(Protocol):
    """A part of a figure."""

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [in]."""

    def draw(self, canvas: Canvas, corner: Point) -> None:
        """Draw with the upper left corner at a point of the page [in]."""


@dataclass(frozen=True)
class Text:
    """Lines of text.

    Attributes:
        lines: the lines.
        color: their colour.
        points: size of the type [pt].
        bold: True for bold type.
    """

    lines: tuple[str, ...]
    color: str = INK
    points: float = NORMAL
    bold: bool = False

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [in]."""
        width = max((text_width(x, self.points, self.bold) for x in self.lines), default=0.0)
        return width, len(self.lines) * line_height(self.points)

    def draw(self, canvas: Canvas, corner: Point) -> None:
        """Draw with the upper left corner at a point of the page [in]."""
        x, y = corner
        for k, line in enumerate(self.lines):
            at = (x, y + (k + 0.5) * line_height(self.points))
            canvas.text(at, line, self.points, color=self.color, bold=self.bold)


@dataclass(frozen=True)
class Column:
    """Panels below each other, left edges in line.

    Attributes:
        panels: from top to bottom.
        gap: between them [in].
    """

    panels: tuple[Panel, ...]
    gap: float

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [in]."""
        widths, heights = zip(*(p.size for p in self.panels), strict=True)
        return max(widths), sum(heights) + self.gap * (len(heights) - 1)

    def draw(self, canvas: Canvas, corner: Point) -> None:
        """Draw with the upper left corner at a point of the page [in]."""
        steps = accumulate((p.size[1] + self.gap for p in self.panels), initial=corner[1])
        for panel, y in zip(self.panels, steps, strict=False):
            panel.draw(canvas, (corner[0], y))


@dataclass(frozen=True)
class Row:
    """Panels beside each other, upper edges in line.

    Attributes:
        panels: from left to right.
        gap: between them [in].
    """

    panels: tuple[Panel, ...]
    gap: float

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [in]."""
        widths, heights = zip(*(p.size for p in self.panels), strict=True)
        return sum(widths) + self.gap * (len(widths) - 1), max(heights)

    def draw(self, canvas: Canvas, corner: Point) -> None:
        """Draw with the upper left corner at a point of the page [in]."""
        steps = accumulate((p.size[0] + self.gap for p in self.panels), initial=corner[0])
        for panel, x in zip(self.panels, steps, strict=False):
            panel.draw(canvas, (x, corner[1]))


@dataclass(frozen=True, eq=False)
class Headed:
    """A panel under a letter, a title and a note that is wrapped to the panel's width.

    Attributes:
        letter: by which the panel is called.
        title: its title.
        note: how to read it.
        panel: the panel.
        least_lines: lines that the note takes at least, so that panels side by side line up.
    """

    letter: str
    title: str
    note: str
    panel: Panel
    least_lines: int = 0

    @property
    def note_lines(self) -> tuple[str, ...]:
        """The note, wrapped."""
        least = max(_LEAST_WIDTH, text_width(self._heading, HEADING, bold=True))
        return tuple(wrapped(self.note, NORMAL, max(self.panel.size[0], least)))

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [in]."""
        return self._column.size

    def draw(self, canvas: Canvas, corner: Point) -> None:
        """Draw with the upper left corner at a point of the page [in]."""
        self._column.draw(canvas, corner)

    @property
    def _heading(self) -> str:
        return f"{self.letter}  {self.title}"

    @property
    def _column(self) -> Column:
        lines = self.note_lines
        lines += ("",) * (self.least_lines - len(lines))
        head = Text((self._heading,), points=HEADING, bold=True)
        return Column((Column((head, Text(lines, color=FAINT)), 0.02), self.panel), _GAP)
