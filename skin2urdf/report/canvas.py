"""A page to draw on in inches, over matplotlib, with the same bytes out for the same drawing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.errors import UsageError
from skin2urdf.files import check_target

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Point = tuple[float, float]
Align = Literal["left", "center", "right"]

FORMATS = (".svg", ".pdf", ".png")
_POINTS_PER_INCH = 72.0
_PNG_DPI = 160
_MOST_PIXELS = 30_000
"""Longest side of a PNG; a renderer takes 65,535 at most."""
_STYLE: Any = {
    "font.family": "sans-serif",
    # The first comes with matplotlib: the same widths everywhere. A viewer of SVG that lacks it
    # takes the second, which is nearly as wide.
    "font.sans-serif": ["DejaVu Sans", "Verdana"],
    "svg.fonttype": "none",
    "svg.hashsalt": "skin2urdf",
    "pdf.fonttype": 42,
    "path.simplify": False,
}
_METADATA: dict[str, dict[str, Any]] = {
    # Neither dates nor versions, which would make each day's or each machine's file another one.
    ".svg": {"Date": None, "Creator": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    ".png": {"Software": None},
}


def check_picture(path: str | Path) -> Path:
    """Make sure that a picture can be written at ``path``, before the work that it shows.

    Args:
        path: file to be written; the ending says the format (.svg, .pdf, .png).

    Returns:
        The absolute path, symbolic links resolved.

    Raises:
        UsageError: another ending, or nothing can be written there.
    """
    kind = Path(path).suffix.lower()
    if kind not in FORMATS:
        raise UsageError(
            f"{path}: pictures are not written as {kind or 'a file without ending'}",
            f"use a name that ends in {', '.join(FORMATS)}",
        )
    return check_target(path)


@contextmanager
def sheet(path: str | Path, width: float, height: float) -> Iterator[Figure]:
    """Open an empty figure; what was drawn is saved when the context ends without an error.

    Args:
        path: where to save; the ending says the format (.svg, .pdf, .png).
        width: width of the page [in].
        height: height of the page [in].

    Raises:
        UsageError: an ending that is none of the three, or nothing can be written there.
    """
    target = check_picture(path)
    # matplotlib takes half a second to import, and nothing but pictures needs it.
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), facecolor="white")
        yield figure
        dpi = min(_PNG_DPI, _MOST_PIXELS / max(width, height))
        kind = Path(path).suffix.lower()
        drawn = BytesIO()
        figure.savefig(drawn, format=kind[1:], dpi=dpi, metadata=_METADATA[kind])
    try:
        target.write_bytes(drawn.getvalue())
    except OSError as error:
        raise UsageError(
            f"can not write {path}: {error.strerror or error}", "give another output path"
        ) from error


@contextmanager
def page(path: str | Path, width: float, height: float) -> Iterator[Canvas]:
    """Open a page to draw on in inches; arguments and errors as of :func:`sheet`."""
    with sheet(path, width, height) as figure:
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), frameon=False)
        axes.set(xlim=(0.0, width), ylim=(height, 0.0), xticks=(), yticks=())
        yield Canvas(axes)


@lru_cache(maxsize=4096)
def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width of a line of text [in].

    Args:
        text: one line.
        size: size of the type [pt].
        bold: True for bold type.
    """
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    properties = FontProperties(
        family="DejaVu Sans", size=size, weight="bold" if bold else "normal"
    )
    width, _, _ = text_to_path.get_text_width_height_descent(text, properties, ismath=False)
    return float(width) / _POINTS_PER_INCH


def line_height(size: float) -> float:
    """Distance of the base lines of a paragraph [in], for a size of the type [pt]."""
    return 1.25 * size / _POINTS_PER_INCH


class Canvas:
    """Primitives in inches from the top left corner of the page, y downwards."""

    def __init__(self, axes: Axes) -> None:
        self._axes = axes

    def text(
        self,
        at: Point,
        text: str,
        size: float,
        *,
        color: str = "black",
        bold: bool = False,
        align: Align = "left",
        upright: bool = False,
    ) -> None:
        """Write a line of text, centred on its point in the direction across the line.

        Args:
            at: left end, middle or right end of the line, as ``align`` says [in].
            text: one line.
            size: size of the type [pt].
            color: its colour.
            bold: True for bold type.
            align: which part of the line is at the point.
            upright: True to read from bottom to top; "left" is then the lower end.
        """
        vertical = {"left": "bottom", "center": "center", "right": "top"}[align]
        self._axes.text(
            *at,
            text,
            fontsize=size,
            color=color,
            weight="bold" if bold else "normal",
            ha="center" if upright else align,
            va=vertical if upright else "center_baseline",
            rotation=90 if upright else 0,
            parse_math=False,
        )

    def line(
        self, points: Sequence[Point], *, color: str, width: float = 1.0, dashed: bool = False
    ) -> None:
        """Draw a line through points [in], ``width`` in pt."""
        x, y = zip(*points, strict=True)
        self._axes.plot(
            x,
            y,
            color=color,
            linewidth=width,
            linestyle=(0, (3, 2)) if dashed else "-",
            solid_capstyle="round",
            solid_joinstyle="round",
            zorder=1,
        )

    def box(
        self,
        corner: Point,
        width: float,
        height: float,
        *,
        face: str = "none",
        edge: str = "none",
        line: float = 1.0,
        radius: float = 0.0,
        dashed: bool = False,
    ) -> None:
        """Draw a box from its upper left corner [in], rounded by ``radius`` [in]."""
        from matplotlib.patches import FancyBboxPatch

        style = f"round,pad=0,rounding_size={radius}" if radius else "square,pad=0"
        patch = FancyBboxPatch(
            corner,
            width,
            height,
            boxstyle=style,
            facecolor=face,
            edgecolor=edge,
            linewidth=line,
            linestyle=(0, (3, 2)) if dashed else "-",
            zorder=2,
        )
        self._axes.add_patch(patch)

    def circle(self, center: Point, radius: float, *, face: str, edge: str, line: float) -> None:
        """Draw a circle [in]."""
        from matplotlib.patches import Circle

        self._axes.add_patch(
            Circle(center, radius, facecolor=face, edgecolor=edge, linewidth=line, zorder=2)
        )

    def cells(self, corner: Point, size: float, mask: Bool, color: str) -> None:
        """Fill the cells of a grid where a mask is True.

        Args:
            corner: upper left corner of the grid [in].
            size: side of a cell [in].
            mask: (R, C) cells to fill.
            color: with what.
        """
        from matplotlib.collections import PolyCollection

        rows, columns = np.nonzero(mask)
        if not len(rows):
            return
        gap = 0.06 * size
        low, high = gap, size - gap
        outline = np.array([(low, low), (high, low), (high, high), (low, high)])
        corners = np.stack([corner[0] + columns * size, corner[1] + rows * size], axis=1)
        self._axes.add_collection(
            PolyCollection(corners[:, None] + outline, facecolor=color, linewidth=0.0, zorder=2),
            autolim=False,
        )
