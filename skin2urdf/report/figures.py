"""Pictures of what was found (paper Figs. 2 and 5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from skin2urdf.paper.exploration.records import Exploration, Group, Violation
from skin2urdf.report.canvas import page
from skin2urdf.report.labels import joint_id, numbers, segment_id, wrapped
from skin2urdf.report.matrix_panel import MatrixPanel
from skin2urdf.report.panels import Column, Headed, Panel, Row, Text
from skin2urdf.report.style import FAINT, INK, NORMAL, TITLE, WARNING
from skin2urdf.report.tree_panel import TreePanel

_MARGIN = 0.35
_GAP = 0.45
_WIDEST_GAP = 1.5
_NONE = "\N{EN DASH}"
_CELL = 0.15
_LARGE_CELL = 0.2
_LARGEST_CELL = 0.36
"""Side of cells that fill a page which the tree makes large [in]."""
_FINER = 0.02
_FEW = 16
"""Up to so many SUs and DoFs the cells are large."""
_MAX_RUNS = 6
_MAX_VIOLATIONS = 12
_LEAST_WIDTH = 7.0
_MERGED = (
    "Identical rows are one segment, identical columns one joint. Beside S and J: the numbers of "
    "their SUs and DoFs."
)
_SORTED = (
    "Strictly lower triangular. Each entry of the secondary diagonal is a joint; it connects two "
    "segments whose rows are otherwise identical."
)
_UNSORTED = "As near to a triangle as it can be sorted: no kinematic tree has this matrix."


def draw_exploration(exploration: Exploration, path: str | Path) -> None:
    """Draw the steps of the structural exploration: three activity matrices and the tree.

    The page grows with the robot, so that labels have the same size for any number of DoFs. The
    same exploration gives the same bytes.

    Args:
        exploration: what Algorithm 1 found.
        path: where to write; .svg, .pdf or .png.

    Raises:
        UsageError: another ending, or nothing can be written there.
    """
    figure = _figure(exploration)
    width, height = figure.size
    with page(path, width + 2 * _MARGIN, height + 2 * _MARGIN) as canvas:
        figure.draw(canvas, (_MARGIN, _MARGIN))


def _figure(exploration: Exploration) -> Panel:
    """All panels, in the arrangement that takes the smaller page, with cells that fill it."""
    least = _LARGE_CELL if max(exploration.raw.shape) <= _FEW else _CELL
    arrangements: list[Panel] = [Row(_matrices(exploration, least), _GAP)]
    if exploration.is_tree:
        arrangements = [_above(exploration, least), _beside(exploration, least)]
    body = max(arrangements, key=_filled)
    notes = _violations(exploration.violations, max(body.size[0], _LEAST_WIDTH))
    title = Text(("Structural exploration",), points=TITLE, bold=True)
    return Column((title, body, *notes), _GAP - 0.15)


def _tree(exploration: Exploration, least_width: float = 0.0) -> Headed:
    """The tree under its heading."""
    panel = TreePanel(exploration, least_width)
    return Headed("d", "Kinematic tree", _tree_note(exploration), panel)


def _above(exploration: Exploration, least: float) -> Column:
    """The matrices in a row above the tree, both as wide as the wider one."""
    width = _tree(exploration).size[0]
    cell = _largest_cell(
        least, lambda cell: Row(_matrices(exploration, cell), _GAP).size[0] <= width
    )
    matrices = _matrices(exploration, cell)
    tree = _tree(exploration, Row(matrices, _GAP).size[0])
    spare = 0.5 * (tree.size[0] - Row(matrices, 0.0).size[0])
    gap = float(np.clip(spare, _GAP, _WIDEST_GAP))
    return Column((Row(matrices, gap), tree), _GAP)


def _beside(exploration: Exploration, least: float) -> Row:
    """The first matrix beside the others and the tree, all as high as the higher side."""
    width = _tree(exploration).size[0]
    cell = _largest_cell(
        least, lambda cell: Row(_matrices(exploration, cell)[1:], _GAP).size[0] <= width
    )
    steps = Row(_matrices(exploration, cell)[1:], _GAP)
    right = Column((steps, _tree(exploration, steps.size[0])), _GAP)
    height = right.size[1]
    cell = _largest_cell(least, lambda cell: _matrices(exploration, cell)[0].size[1] <= height)
    return Row((_matrices(exploration, cell)[0], right), _GAP)


def _filled(panel: Panel) -> float:
    """Part of its rectangle that an arrangement fills."""
    return _area(panel) / (panel.size[0] * panel.size[1])


def _area(panel: Panel) -> float:
    """Area of all that stands in rows and columns [in^2]."""
    if isinstance(panel, Row | Column):
        return sum(map(_area, panel.panels))
    return panel.size[0] * panel.size[1]


def _largest_cell(least: float, fits: Callable[[float], bool]) -> float:
    """The largest side of a cell that fits, or the least [in]."""
    sides = np.arange(_LARGEST_CELL, least, -_FINER)
    return float(next((side for side in sides if fits(side)), least))


def _matrices(exploration: Exploration, cell: float) -> tuple[Headed, ...]:
    """The three activity matrices, with their cells in line."""
    raw, merged, ordered = _raw(exploration), _merged(exploration), _sorted(exploration)
    top = max(merged.top, ordered.top)
    panels = (
        Headed("a", "Activity matrix", _raw_note(exploration), replace(raw, cell=cell)),
        Headed("b", "Merged", _MERGED, replace(merged, cell=cell, least_top=top)),
        Headed(
            "c",
            "Sorted",
            _SORTED if exploration.is_tree else _UNSORTED,
            replace(ordered, cell=cell, least_top=top),
        ),
    )
    lines = max(len(panel.note_lines) for panel in panels)
    return tuple(replace(panel, least_lines=lines) for panel in panels)


def _raw(e: Exploration) -> MatrixPanel:
    segment = _place(e.segments)
    joint = _place(e.joints)
    return MatrixPanel(
        e.raw,
        tuple((str(u + 1), name) for u, name in enumerate(e.su_names)),
        tuple((str(d + 1), name) for d, name in enumerate(e.dof_names)),
        tuple(segment_id(segment[u]) if u in segment else _NONE for u in range(len(e.su_names))),
        tuple(joint_id(joint[d]) if d in joint else _NONE for d in range(len(e.dof_names))),
    )


def _raw_note(e: Exploration) -> str:
    return (
        f"{_count(len(e.su_names), 'SU')} (rows), {_count(len(e.dof_names), 'DoF')} (columns). "
        "Filled: the SU moves with the DoF. Right and below: their segments and joints."
    )


def _merged(e: Exploration) -> MatrixPanel:
    segment = _place(e.segments)
    joint = _place(e.joints)
    return MatrixPanel(
        e.merged,
        tuple((segment_id(segment[g[0]]), numbers(g, _MAX_RUNS)) for g in e.merged_sus),
        tuple(
            (joint_id(joint[g[0]]) if g[0] in joint else _NONE, numbers(g, _MAX_RUNS))
            for g in e.merged_dofs
        ),
    )


def _sorted(e: Exploration) -> MatrixPanel:
    diagonal = np.eye(e.n_segments, e.n_joints, k=-1, dtype=bool)
    return MatrixPanel(
        e.triangular,
        tuple((segment_id(s), _role(e, s)) for s in range(e.n_segments)),
        tuple((joint_id(n), "") for n in range(e.n_joints)),
        accent=diagonal if e.is_tree else None,
    )


def _role(e: Exploration, segment: int) -> str:
    if not e.is_tree:
        return ""
    role = (
        {0: "RS"}
        | dict.fromkeys(e.true_end_effectors, "end")
        | dict.fromkeys(e.false_end_effectors, "false end")
    )
    bare = "" if e.segments[segment] else "no SU"
    return ", ".join(word for word in (role.get(segment, ""), bare) if word)


def _place(groups: tuple[Group, ...]) -> dict[int, int]:
    """Index of the group that each member is in."""
    return {member: place for place, group in enumerate(groups) for member in group}


def _tree_note(e: Exploration) -> str:
    parts = [
        _count(e.n_segments, "segment"),
        _count(e.n_joints, "joint"),
        f"{_count(len(e.limbs), 'limb')} from the reference segment to an end effector",
    ]
    if e.sub_limbs:
        parts.append(_count(len(e.sub_limbs), "sub-limb"))
    return f"{', '.join(parts)}."


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _violations(violations: tuple[Violation, ...], width: float) -> list[Panel]:
    """What is wrong and what to do about it, wrapped to a width [in]."""
    found: list[Panel] = []
    for violation in violations[:_MAX_VIOLATIONS]:
        words = violation.words
        what = wrapped(words[:1].upper() + words[1:] + ".", NORMAL, width)
        remedy = violation.remedy
        then = wrapped(remedy[:1].upper() + remedy[1:] + ".", NORMAL, width)
        found.append(Column((Text(tuple(what), WARNING), Text(tuple(then), INK)), 0.01))
    if len(violations) > _MAX_VIOLATIONS:
        left = len(violations) - _MAX_VIOLATIONS
        found.append(Text((f"and {left} more",), FAINT))
    return [Column((Text(("Violated constraints",), bold=True), *found), 0.08)] if found else []
