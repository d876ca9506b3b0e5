"""An activity matrix with labels on all four sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skin2urdf.arrays import Bool
from skin2urdf.report.canvas import Canvas, Point, text_width
from skin2urdf.report.style import ACCENT, FAINT, FILL, GRID, INK, SMALL

_GAP = 0.05


@dataclass(frozen=True, eq=False)
class MatrixPanel:
    """A matrix of R rows and C columns; a label is an identification number and words.

    Attributes:
        matrix: (R, C) entries.
        rows: R IDs and the words beside them, left of the rows.
        columns: C IDs and the words beside them, above the columns, from bottom to top.
        right: R labels right of the rows; empty for none.
        below: C labels below the columns; empty for none.
        accent: (R, C) entries to emphasize, where they are 1; None for none.
        cell: side of a cell [in].
        least_top: room above the cells at least, so that panels side by side line up [in].
    """

    matrix: Bool
    rows: tuple[tuple[str, str], ...]
    columns: tuple[tuple[str, str], ...]
    right: tuple[str, ...] = ()
    below: tuple[str, ...] = ()
    accent: Bool | None = None
    cell: float = 0.15
    least_top: float = 0.0

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [in]."""
        left, top = self._origin
        R, C = self.matrix.shape
        right = _widest(self.right) + (_GAP if self.right else 0.0)
        below = _widest(self.below) + (_GAP if self.below else 0.0)
        return left + C * self.cell + right, top + R * self.cell + below

    @property
    def top(self) -> float:
        """Room above the cells [in]."""
        return max(self.least_top, _room(self.columns))

    @property
    def _origin(self) -> Point:
        """Upper left corner of the cells in the panel."""
        return _room(self.rows), self.top

    def draw(self, canvas: Canvas, corner: Point) -> None:
        """Draw with the upper left corner at a point of the page [in]."""
        x, y = corner[0] + self._origin[0], corner[1] + self._origin[1]
        R, C = self.matrix.shape
        cell = self.cell
        right, bottom = x + C * cell, y + R * cell
        for r in range(R + 1):
            canvas.line([(x, y + r * cell), (right, y + r * cell)], color=GRID, width=0.5)
        for c in range(C + 1):
            canvas.line([(x + c * cell, y), (x + c * cell, bottom)], color=GRID, width=0.5)
        plain = self.matrix if self.accent is None else self.matrix & ~self.accent
        canvas.cells((x, y), cell, plain, FILL)
        if self.accent is not None:
            canvas.cells((x, y), cell, self.matrix & self.accent, ACCENT)
        row_ids = _widest([number for number, _ in self.rows])
        for r, (number, words) in enumerate(self.rows):
            middle = y + (r + 0.5) * cell
            canvas.text((x - _GAP, middle), number, SMALL, color=INK, bold=True, align="right")
            at = (x - _GAP - row_ids - _GAP, middle)
            canvas.text(at, words, SMALL, color=FAINT, align="right")
        column_ids = _widest([number for number, _ in self.columns])
        for c, (number, words) in enumerate(self.columns):
            middle = x + (c + 0.5) * cell
            at = (middle, y - _GAP)
            canvas.text(at, number, SMALL, color=INK, bold=True, upright=True)
            at = (middle, y - _GAP - column_ids - _GAP)
            canvas.text(at, words, SMALL, color=FAINT, upright=True)
        for r, label in enumerate(self.right):
            canvas.text((right + _GAP, y + (r + 0.5) * cell), label, SMALL, color=INK, bold=True)
        for c, label in enumerate(self.below):
            at = (x + (c + 0.5) * cell, bottom + _GAP)
            canvas.text(at, label, SMALL, color=INK, bold=True, upright=True, align="right")


def _widest(labels: Sequence[str]) -> float:
    """Room that bold labels take across the edge of the matrix [in]."""
    return max((text_width(label, SMALL, bold=True) for label in labels), default=0.0)


def _room(labels: Sequence[tuple[str, str]]) -> float:
    """Room that IDs and words take across the edge of the matrix, gaps included [in]."""
    words = max((text_width(words, SMALL) for _, words in labels), default=0.0)
    return _widest([number for number, _ in labels]) + _GAP + (words + _GAP if words else 0.0)
