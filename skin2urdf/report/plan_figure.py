"""A picture of a plan: where each joint goes within its limits, and what it uses of the others."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skin2urdf.planning.records import Plan
from skin2urdf.report.canvas import sheet
from skin2urdf.report.style import ACCENT, FAINT, FILL, GRID, INK, NORMAL, SMALL, TITLE, WARNING

_ROW = 0.78
_WIDTH = 11.0
_ABOVE, _BELOW = 0.75, 0.55
_LEFT, _RIGHT = 2.1, 0.35
_STEP = 0.04
_SHADES = {"pattern": "#fdf0d5", "structural": "#e3eef5"}
_WORDS = {"pattern": "pattern around a pose", "structural": "one joint at a time"}


def draw_plan(plan: Plan, path: str | Path) -> None:
    """Draw a plan: a row per joint, and one for the share of limits that is used.

    Args:
        plan: the plan.
        path: where to write; .svg, .pdf or .png.

    Raises:
        UsageError: another ending, or nothing can be written there.
    """
    limits, trajectory = plan.limits, plan.trajectory
    time = np.arange(0.0, trajectory.duration + _STEP, _STEP)
    q, *rates = trajectory.at(time)
    rows = limits.n_joints + 1
    height = rows * _ROW + _ABOVE + _BELOW
    with sheet(path, _WIDTH, height) as figure:
        grid = figure.add_gridspec(
            rows,
            1,
            left=_LEFT / _WIDTH,
            right=1 - _RIGHT / _WIDTH,
            top=1 - _ABOVE / height,
            bottom=_BELOW / height,
            hspace=0.28,
        )
        figure.text(
            0.3 / _WIDTH,
            1 - 0.32 / height,
            f"Motion to record: {len(plan.poses)} poses, {trajectory.duration:.0f} s",
            fontsize=TITLE,
            fontweight="bold",
            color=INK,
            va="center",
        )
        shown = [kind for kind in _SHADES if any(phase.kind == kind for phase in plan.phases)]
        for i, kind in enumerate(shown):
            x = (5.6 + 2.4 * i) / _WIDTH
            box = (x, 1 - 0.39 / height, 0.22 / _WIDTH, 0.14 / height)
            swatch = figure.add_axes(box, facecolor=_SHADES[kind], xticks=(), yticks=())
            for side in swatch.spines.values():
                side.set_color(GRID)
            figure.text(
                x + 0.3 / _WIDTH, 1 - 0.32 / height, _WORDS[kind],
                fontsize=NORMAL, color=INK, va="center",
            )  # fmt: skip
        for row in range(rows):
            axes = figure.add_subplot(grid[row])
            for phase in plan.phases:
                if phase.kind in _SHADES:
                    axes.axvspan(phase.start, phase.end, color=_SHADES[phase.kind], lw=0)
            axes.set_xlim(0.0, trajectory.duration)
            axes.tick_params(labelsize=SMALL, colors=FAINT, length=2)
            for side in axes.spines.values():
                side.set_color(GRID)
            last = row == rows - 1
            if last:
                uses = (limits.velocity, limits.acceleration, limits.jerk)
                shades = (FILL, ACCENT, "#b3589a")
                words = ("speed", "acceleration", "jerk")
                for rate, most, colour, word in zip(rates, uses, shades, words, strict=True):
                    share = 100 * (np.abs(rate) / most).max(axis=1)
                    axes.plot(time, share, lw=0.6, color=colour, label=word)
                axes.axhline(100.0, color=WARNING, lw=0.8)
                axes.set_ylim(0.0, 145.0)
                axes.legend(
                    loc="upper right", fontsize=SMALL, ncols=3, frameon=True, framealpha=0.9
                )
                label = "of limits [%]"
                axes.set_xlabel("time [s]", fontsize=NORMAL, color=INK)
            else:
                axes.plot(time, q[:, row], lw=0.8, color=FILL)
                both = (float(limits.lower[row]), float(limits.upper[row]))
                ends = [end for end in both if np.isfinite(end)]
                for end in ends:
                    axes.axhline(end, color=WARNING, lw=0.8)
                low = min([float(q[:, row].min()), *ends])
                high = max([float(q[:, row].max()), *ends])
                room = 0.06 * (high - low)
                axes.set_ylim(low - room, high + room)
                axes.set_xticklabels([])
                unit = "m" if limits.prismatic[row] else "rad"
                label = f"{_short(limits.joint_names[row])} [{unit}]"
            figure.text(
                (_LEFT - 0.42) / _WIDTH,
                0.5 * (axes.get_position().y0 + axes.get_position().y1),
                label,
                fontsize=NORMAL,
                color=INK,
                ha="right",
                va="center",
            )


def _short(name: str) -> str:
    return name if len(name) <= 20 else f"{name[:9]}..{name[-9:]}"
