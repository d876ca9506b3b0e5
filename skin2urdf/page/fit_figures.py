"""Where the model explains the readings, and where it does not; who moves with whom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from skin2urdf.page import style
from skin2urdf.page.advice import chain_to, limb_by_limb
from skin2urdf.page.labels import in_words

_ROW = 19
"""Height of a bar [px]."""
_CELL = 18
"""Height of a cell of the activity matrix [px]."""
_LETTER = 9
"""Width of a letter of a name at most, on average over names [px]: plotly leaves no room for names
that are longer than the figure is high."""
_GAP = 10
"""Room beside axes and names [px]."""
_AROUND = 70
"""Room for axes and their titles [px]."""


def residual_figures(document: Mapping[str, Any]) -> dict[str, go.Figure]:
    """What is left of the readings, in multiples of noise: by SU, by pose, and by joint if known.

    Args:
        document: a calibration's JSON.
    """
    goodness = document["goodness"]
    order = _in_tree_order(document)
    sus = {name: goodness["by_su"][name] for name in order}
    figures = {"by_su": _bars(sus, "SU")}
    if goodness["by_pose"]:
        figures["by_pose"] = _poses(goodness["by_pose"], goodness["held_out"])
    # Logs without patterns show no joint's motion by itself.
    if any(part["per_dof"] is not None for part in goodness["by_joint"].values()):
        figures["by_joint"] = _bars(goodness["by_joint"], "joint")
    return figures


def activity_figure(document: Mapping[str, Any]) -> go.Figure:
    """The activity matrix in the order of the tree, with its evidence under the pointer.

    Args:
        document: a calibration's JSON.
    """
    activity = document["activity"]
    joints = limb_by_limb(document)
    columns = [*joints, *(name for name in activity["dofs"] if name not in joints)]
    inside = [name for name in _in_tree_order(document) if name in activity["sus"]]
    rows = [*inside, *(name for name in activity["sus"] if name not in inside)]
    at = np.ix_(
        [activity["sus"].index(name) for name in rows],
        [activity["dofs"].index(name) for name in columns],
    )
    matrix, static, dynamic = (
        np.array(activity[key], dtype=np.float64)[at] for key in ("matrix", "static", "dynamic")
    )
    if not activity["patterns_felt"]:
        # The evidence of single moves and patterns says little then; the tree rests on all motion.
        on = document["tree"]["sus"]
        chains = [chain_to(document, on.get(su)) for su in rows]
        matrix = np.array([[dof in chain for dof in columns] for chain in chains])
    words = [
        [
            f"{in_words(su)}, {in_words(dof)}: {'moves' if matrix[r, c] else 'does not move'}<br>"
            f"rests {_times(static[r, c])}, patterns {_times(dynamic[r, c])}"
            for c, dof in enumerate(columns)
        ]
        for r, su in enumerate(rows)
    ]
    above = _LETTER * max(map(len, columns), default=0) + _GAP
    figure = go.Figure(
        go.Heatmap(
            z=matrix.astype(np.int8),
            x=list(range(len(columns))),
            y=list(range(len(rows))),
            text=words,
            hoverinfo="text",
            colorscale=[[0.0, "#f5f7fa"], [1.0, style.FILL]],
            zmin=0,
            zmax=1,
            showscale=False,
            xgap=1,
            ygap=1,
        ),
        layout=_layout(_CELL * len(rows) + _AROUND + above, above),
    )
    figure.update_xaxes(
        tickvals=list(range(len(columns))), ticktext=[in_words(n) for n in columns],
        tickangle=-90, side="top", showgrid=False, zeroline=False,
    )  # fmt: skip
    figure.update_yaxes(
        tickvals=list(range(len(rows))), ticktext=[in_words(n) for n in rows],
        autorange="reversed", showgrid=False, zeroline=False,
    )  # fmt: skip
    return figure


def _times(evidence: float) -> str:
    """Evidence over the threshold, in words."""
    return f"{evidence:.2g} times the threshold" if np.isfinite(evidence) else "not recorded"


def _in_tree_order(document: Mapping[str, Any]) -> list[str]:
    """Names of the SUs from the base outwards."""
    joints = limb_by_limb(document)
    place = {None: -1} | {name: j for j, name in enumerate(joints)}
    sus = document["tree"]["sus"]
    return sorted(sus, key=lambda name: place[sus[name]])


def _left(part: Mapping[str, Any]) -> float:
    """What is left in multiples of noise; NaN where nothing was measured."""
    per_dof = part["per_dof"]
    return float("nan") if per_dof is None else float(np.sqrt(max(per_dof, 0.0)))


def _bars(parts: Mapping[str, Mapping[str, Any]], what: str) -> go.Figure:
    """A bar for each part, the first one on top."""
    names, left = list(parts), [_left(part) for part in parts.values()]
    odd = [bool(part.get("odd", False)) for part in parts.values()]
    words = [
        f"{in_words(name)}: {value:.2f} times noise"
        + (f", {part['dof']:.0f} degrees of freedom" if part["dof"] else "")
        + (", unlike the others" if strange else "")
        for (name, part), value, strange in zip(parts.items(), left, odd, strict=True)
    ]
    figure = go.Figure(
        go.Bar(
            x=left,
            y=list(range(len(names))),
            orientation="h",
            text=words,
            textposition="none",
            hoverinfo="text",
            marker_color=[style.WRONG if strange else style.FILL for strange in odd],
        ),
        layout=_layout(_ROW * len(names) + _AROUND),
    )
    figure.update_yaxes(
        tickvals=list(range(len(names))), ticktext=[in_words(n) for n in names],
        autorange="reversed", showgrid=False, zeroline=False, automargin=True,
    )  # fmt: skip
    figure.update_xaxes(title=f"by {what} [times noise]", rangemode="tozero")
    figure.add_vline(x=1.0, line={"color": style.INK, "width": 1, "dash": "dot"})
    return figure


def _poses(poses: Sequence[Mapping[str, Any]], held_out: Sequence[Mapping[str, Any]]) -> go.Figure:
    """A bar for each pose, and what is left of it where the estimate does not know it."""
    numbers = list(range(1, len(poses) + 1))
    left = [_left(pose) for pose in poses]
    figure = go.Figure(
        go.Bar(
            x=numbers,
            y=left,
            name="pose",
            text=[
                f"pose {n} of log {pose['log'] + 1}: {value:.2f} times noise"
                f"{', with a pattern' if pose['pattern'] else ', rest alone'}"
                for n, pose, value in zip(numbers, poses, left, strict=True)
            ],
            textposition="none",
            hoverinfo="text",
            marker_color=[style.WRONG if pose["odd"] else style.FILL for pose in poses],
        ),
        layout=_layout(300),
    )
    if len(held_out) == len(poses):
        out = [_left(pose) for pose in held_out]
        words = [f"pose {n} left out: {v:.2f}" for n, v in zip(numbers, out, strict=True)]
        figure.add_trace(
            go.Scatter(
                x=numbers, y=out, mode="markers", name="left out and predicted",
                text=words, hoverinfo="text",
                marker={"symbol": "diamond", "size": 7, "color": style.OTHER},
            )
        )  # fmt: skip
        figure.update_layout(legend={"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"})
    figure.update_xaxes(title="pose", showgrid=False)
    figure.update_yaxes(title="[times noise]", rangemode="tozero")
    figure.add_hline(y=1.0, line={"color": style.INK, "width": 1, "dash": "dot"})
    return figure


def _layout(height: int, above: int = _GAP) -> dict[str, Any]:
    """A figure of some height, with room above the axes [px]."""
    return {
        "height": height,
        "font": {"family": style.FONT, "color": style.INK, "size": 12},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "margin": {"l": 10, "r": 10, "t": above, "b": 40},
        "bargap": 0.25,
        "xaxis": {"gridcolor": style.GRID, "automargin": True, "fixedrange": True},
        "yaxis": {"gridcolor": style.GRID, "automargin": True, "fixedrange": True},
    }
