"""The kinematic tree: segments as boxes, joints as circles on the lines between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from skin2urdf.paper.exploration.records import Exploration
from skin2urdf.report.canvas import Canvas, Point, line_height, text_width
from skin2urdf.report.labels import joint_id, segment_id, shortened
from skin2urdf.report.style import (
    ACCENT,
    FAINT,
    FILL,
    INK,
    INNER,
    LEAF,
    NORMAL,
    PAPER,
    SMALL,
    WARNING,
)

_RADIUS = 0.14
_STUB = 0.12
"""Line between a box and what is beside it [in]."""
_AIR = 0.1
"""Beside the names of a joint's DoFs [in]."""
_CLEARANCE = 0.12
"""Between the limbs [in]."""
_MAX_LINES = 8
_LEGEND_HEIGHT = 0.36


@dataclass(frozen=True, eq=False)
class TreePanel:
    """The kinematic tree of an exploration, from the RS on the left to the end effectors.

    Attributes:
        exploration: what was found; it must be a tree.
        least_width: width that it takes at least, with longer lines between the boxes [in].
    """

    exploration: Exploration
    least_width: float = 0.0

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [in]."""
        above, below = self._extent[0]
        width = self._left[-1] + self._box_width[-1]
        return max(width, _legend_width()), above + below + _LEGEND_HEIGHT

    def draw(self, canvas: Canvas, corner: Point) -> None:
        """Draw with the upper left corner at a point of the page [in]."""
        x, y = corner[0], corner[1]
        for joint, (parent, child) in enumerate(self.exploration.connectivity):
            self._draw_joint(canvas, (x, y), joint, int(parent), int(child))
        for segment in range(self.exploration.n_segments):
            self._draw_segment(canvas, (x, y), segment)
        above, below = self._extent[0]
        _draw_legend(canvas, (x, y + above + below + 0.5 * _LEGEND_HEIGHT))

    def _draw_segment(self, canvas: Canvas, corner: Point, segment: int) -> None:
        depth = self._depth[segment]
        lines = self._su_lines[segment]
        width, height = self._box_width[depth], _box_height(lines)
        x, y = corner[0] + self._left[depth], corner[1] + self._y[segment]
        face, edge, ink, line = PAPER, INK, INK, 0.8
        if segment == 0:
            face, ink = INK, "white"
        elif segment in self.exploration.true_end_effectors:
            edge, line = LEAF, 1.8
        elif segment in self.exploration.false_end_effectors:
            edge, line = INNER, 1.8
        bare = not self.exploration.segments[segment]
        if bare:
            face, ink = "white", WARNING
        canvas.box(
            (x, y - 0.5 * height),
            width,
            height,
            face=face,
            edge=edge,
            line=line,
            radius=0.05,
            dashed=bare,
        )
        name = segment_id(segment) + (" (RS)" if segment == 0 else "")
        top = y - 0.5 * height + 0.04
        middle = x + 0.5 * width
        at = (middle, top + 0.5 * line_height(NORMAL))
        canvas.text(at, name, NORMAL, color=ink, bold=True, align="center")
        for k, text in enumerate(lines):
            at = (middle, top + line_height(NORMAL) + (k + 0.5) * line_height(SMALL))
            canvas.text(at, text, SMALL, color=ink, align="center")

    def _draw_joint(
        self, canvas: Canvas, corner: Point, joint: int, parent: int, child: int
    ) -> None:
        depth = self._depth[child]
        y = corner[1] + self._y[child]
        y_parent = corner[1] + self._y[parent]
        start = corner[0] + self._left[depth - 1] + self._box_width[depth - 1]
        bend = start + _STUB
        middle = bend + 0.5 * (self._left[depth] - _STUB - (bend - corner[0]))
        end = corner[0] + self._left[depth]
        points = [(start, y_parent), (bend, y_parent), (bend, y), (end, y)]
        canvas.line(points, color=INK, width=1.0)
        canvas.circle((middle, y), _RADIUS, face="white", edge=ACCENT, line=1.6)
        canvas.text((middle, y), joint_id(joint), SMALL, color=INK, bold=True, align="center")
        for k, text in enumerate(self._dof_lines[joint]):
            at = (middle, y + _RADIUS + 0.03 + (k + 0.5) * line_height(SMALL))
            canvas.text(at, text, SMALL, color=FAINT, align="center")

    @cached_property
    def _children(self) -> tuple[tuple[int, ...], ...]:
        pairs = self.exploration.connectivity
        return tuple(
            tuple(int(c) for c in pairs[pairs[:, 0] == s, 1])
            for s in range(self.exploration.n_segments)
        )

    @cached_property
    def _depth(self) -> tuple[int, ...]:
        return tuple(len(sequence) for sequence in self.exploration.sequences)

    @cached_property
    def _su_lines(self) -> tuple[tuple[str, ...], ...]:
        """Lines in the box of each segment."""
        names = self.exploration.su_names
        return tuple(
            tuple(shortened([names[u] for u in sus], _MAX_LINES)) if sus else ("no SU",)
            for sus in self.exploration.segments
        )

    @cached_property
    def _dof_lines(self) -> tuple[tuple[str, ...], ...]:
        """Lines under the circle of each joint."""
        names = self.exploration.dof_names
        return tuple(
            tuple(shortened([names[d] for d in dofs], _MAX_LINES))
            for dofs in self.exploration.joints
        )

    @cached_property
    def _box_width(self) -> tuple[float, ...]:
        """Width of the boxes at each depth."""
        width = np.full(max(self._depth) + 1, 0.4)
        for s, lines in enumerate(self._su_lines):
            name = text_width(segment_id(s) + (" (RS)" if s == 0 else ""), NORMAL, bold=True)
            widest = max(name, *(text_width(line, SMALL) for line in lines)) + 0.14
            width[self._depth[s]] = max(width[self._depth[s]], widest)
        return tuple(width.tolist())

    @cached_property
    def _left(self) -> tuple[float, ...]:
        """Left edge of the boxes at each depth."""
        room = np.zeros(len(self._box_width))
        for joint, lines in enumerate(self._dof_lines):
            widest = max(2 * _RADIUS, *(text_width(line, SMALL) for line in lines))
            depth = self._depth[joint + 1]
            room[depth] = max(room[depth], widest + 2 * _AIR)
        left = [0.0]
        for depth in range(1, len(self._box_width)):
            left.append(left[-1] + self._box_width[depth - 1] + 2 * _STUB + float(room[depth]))
        spare = max(0.0, self.least_width - left[-1] - self._box_width[-1])
        return tuple(x + spare * depth / max(1, len(left) - 1) for depth, x in enumerate(left))

    @cached_property
    def _extent(self) -> tuple[tuple[float, float], ...]:
        """Room that each segment and all beyond it take above and below its own middle."""
        extent: list[tuple[float, float]] = [(0.0, 0.0)] * self.exploration.n_segments
        for s in reversed(range(self.exploration.n_segments)):
            above = below = 0.5 * _box_height(self._su_lines[s])
            if s > 0:
                above = max(above, _RADIUS)
                text = len(self._dof_lines[s - 1]) * line_height(SMALL)
                below = max(below, _RADIUS + 0.03 + text)
            if self._children[s]:
                first = extent[self._children[s][0]][0]
                last = extent[self._children[s][-1]][1]
                spread = self._spread(s, extent)
                above = max(above, first + 0.5 * spread)
                below = max(below, last + 0.5 * spread)
            extent[s] = above, below
        return tuple(extent)

    def _spread(self, segment: int, extent: list[tuple[float, float]]) -> float:
        """Distance between the middles of a segment's first and last child."""
        children = self._children[segment]
        return sum(extent[a][1] + _CLEARANCE + extent[b][0] for a, b in pairwise(children))

    @cached_property
    def _y(self) -> tuple[float, ...]:
        """Middle of each segment, from the top of the panel."""
        y = [self._extent[0][0]] * self.exploration.n_segments
        extent = list(self._extent)
        for s, children in enumerate(self._children):
            at = y[s] - 0.5 * self._spread(s, extent)
            for k, child in enumerate(children):
                if k:
                    at += extent[children[k - 1]][1] + _CLEARANCE + extent[child][0]
                y[child] = at
        return tuple(y)


def _box_height(lines: tuple[str, ...]) -> float:
    return line_height(NORMAL) + len(lines) * line_height(SMALL) + 0.08


_LEGEND = (
    ("reference segment (RS)", INK, INK, 0.8),
    ("segment", PAPER, INK, 0.8),
    ("true end effector", PAPER, LEAF, 1.8),
    ("false end effector", PAPER, INNER, 1.8),
    ("joint, with its DoFs", "white", ACCENT, 1.6),
)
_SAMPLE = 0.24


def _legend_width() -> float:
    return sum(_SAMPLE + 0.06 + text_width(words, SMALL) + 0.2 for words, *_ in _LEGEND)


def _draw_legend(canvas: Canvas, at: Point) -> None:
    """Draw what the shapes mean in a line whose left end is at a point."""
    x, y = at
    for words, face, edge, line in _LEGEND:
        if edge == ACCENT:
            canvas.circle((x + 0.5 * _SAMPLE, y), 0.07, face=face, edge=edge, line=line)
        else:
            canvas.box((x, y - 0.07), _SAMPLE, 0.14, face=face, edge=edge, line=line, radius=0.03)
        canvas.text((x + _SAMPLE + 0.06, y), words, SMALL, color=FILL)
        x += _SAMPLE + 0.06 + text_width(words, SMALL) + 0.2
