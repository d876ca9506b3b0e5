"""The robot in 3D: links, joints, SUs, how well they are known, and another robot laid over it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from skin2urdf.arrays import F64
from skin2urdf.page import style
from skin2urdf.page.contents import Contents
from skin2urdf.page.labels import in_space, in_words
from skin2urdf.scene.certainty import Cloud, OpenLine, clouds, magnification, open_lines
from skin2urdf.scene.overlay import alongside
from skin2urdf.scene.robot import Segment, along_axes, drum, plate, rods, thickness
from skin2urdf.scene.solids import Mesh, merged

_LINE = 0.12
"""Length of an open direction either way, over the robot's extent."""
_THICKEST = 1 / 70
"""Radius of links, over the robot's extent, beyond which they hide what they carry."""
_FORWARD = 8.0
"""How far names stand before their SUs, in radii of links: no link of usual size hides them, as it
would from where the figure is first seen."""
_BOX = 1.2
"""Diagonal of the box around the robot, in the units of the camera's distance."""
_HIGHEST = 0.8
"""Its height in the same units; figures are wider than high."""
_DIGITS = 5
"""Decimals of vertices [m]: a hundredth of a millimetre, less than a pixel."""


def robot_figure(contents: Contents) -> tuple[go.Figure, float]:
    """Draw the robot with all joints in the middle of their ranges.

    Args:
        contents: the calibration and another robot, if any.

    Returns:
        The figure, and how many times as large as one standard deviation ellipsoids are drawn; 0
        where there are none.
    """
    document, parts = contents.document, contents.segments
    frames = contents.frames()
    points = np.array([T[:3, 3] for T in frames.values()])
    extent = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    radius = min(thickness(parts), _THICKEST * extent)
    figure = go.Figure(layout=_layout())
    figure.add_trace(_links(parts, frames, radius))
    figure.add_trace(_drums(along_axes(contents.robot, frames), document["joints"], radius))
    figure.add_traces(_sus(document["sus"], frames, radius))
    figure.add_trace(_joint_labels(document["joints"], frames))
    unplaced = document["observability"]["positions_open"] is not None
    of_sus = [] if unplaced else clouds(frames, document["sus"])
    of_joints = [] if unplaced else clouds(frames, document["joints"])
    times = magnification([*of_sus, *of_joints], extent)
    for name, colour, found in (
        ("SU: 1 sd", style.CLOUD, of_sus),
        ("joint: 1 sd", style.AXIS_CLOUD, of_joints),
    ):
        if found:
            figure.add_trace(_ellipsoids(f"{name}, {times:g} times as large", colour, found, times))
    lines = [] if unplaced else open_lines(frames, document["observability"])
    for turn, words in ((False, "open: place along"), (True, "open: turn about")):
        chosen = [line for line in lines if line.turn is turn]
        if chosen:
            figure.add_trace(_open(words, chosen, _LINE * extent))
    figure.add_traces(_other(contents, frames, radius))
    seen_from = _view(figure)["camera"]["eye"]
    eye = np.array([seen_from[axis] for axis in "xyz"])
    forward = _FORWARD * radius * eye / np.linalg.norm(eye)
    figure.add_trace(_su_names(document["sus"], frames, forward))
    figure.update_layout(scene=_view(figure))
    return figure, times if of_sus or of_joints else 0.0


def _view(figure: go.Figure) -> dict[str, Any]:
    """Ranges that hold all that is drawn, to one scale, seen from the side where it is widest."""
    shown = [trace for trace in figure.data if len(trace.x)]
    points = np.concatenate([np.stack([t.x, t.y, t.z], axis=1) for t in shown])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    size = np.maximum(high - low, 0.1 * float(np.max(high - low)) + 1e-3)
    low, high = (0.5 * (low + high) + side * 0.52 * size for side in (-1, 1))
    x, y, z = size * min(_BOX / float(np.linalg.norm(size)), _HIGHEST / float(size[2]))
    across = 1.05 if size[0] > size[1] else 0.55
    eye = {"x": 1.6 - across, "y": -across, "z": 0.45}
    ranges = {
        f"{axis}axis": {"range": [float(a), float(b)]}
        for axis, a, b in zip("xyz", low, high, strict=True)
    }
    return {
        "aspectmode": "manual",
        "aspectratio": {"x": float(x), "y": float(y), "z": float(z)},
        "camera": {"eye": eye, "center": {"x": 0, "y": 0, "z": -0.05}},
        **ranges,
    }


def _layout() -> dict[str, Any]:
    axis = {
        "backgroundcolor": "#ffffff",
        "gridcolor": style.GRID,
        "zerolinecolor": "#9aa5b1",
        "showspikes": False,
        "tickfont": {"size": 10, "color": style.FAINT},
    }
    return {
        "font": {"family": style.FONT, "color": style.INK, "size": 13},
        "paper_bgcolor": "#ffffff",
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "legend": {"orientation": "h", "x": 0, "y": 0, "yanchor": "top", "itemsizing": "constant"},
        "scene": {
            "xaxis": {**axis, "title": {"text": "x [m]", "font": {"size": 11}}},
            "yaxis": {**axis, "title": {"text": "y [m]", "font": {"size": 11}}},
            "zaxis": {**axis, "title": {"text": "z [m]", "font": {"size": 11}}},
        },
    }


def _surface(mesh: Mesh, name: str, colour: str, **more: Any) -> go.Mesh3d:
    """A mesh as a trace; single precision is plenty."""
    x, y, z = np.round(mesh.vertices, _DIGITS).astype(np.float32).T
    i, j, k = mesh.faces.astype(np.int32).T
    return go.Mesh3d(
        x=x, y=y, z=z, i=i, j=j, k=k,
        name=name, color=colour, showlegend=True, hoverinfo="skip", flatshading=True,
        lighting={"ambient": 0.8, "diffuse": 0.45, "specular": 0.1, "roughness": 0.9},
        lightposition={"x": 10_000, "y": -20_000, "z": 20_000},
        **more,
    )  # fmt: skip


def _links(parts: Sequence[Segment], frames: Mapping[str, F64], radius: float) -> go.Mesh3d:
    meshes = [mesh.moved(frames[part.joint]) for part in parts for mesh in rods(part, radius)]
    return _surface(merged(meshes), "links", style.LINK)


def _drums(frames: Mapping[str, F64], joints: Mapping[str, Any], radius: float) -> go.Mesh3d:
    meshes = [drum(radius).moved(frames[name]) for name in joints]
    return _surface(merged(meshes), "joints", style.JOINT)


def _sus(
    sus: Mapping[str, Any], frames: Mapping[str, F64], radius: float
) -> list[go.BaseTraceType]:
    """Plates and labels of the SUs."""
    names = [name for name in sus if name in frames]
    meshes = merged([plate(frames[name], radius) for name in names])
    words = [_su_words(name, sus[name]) for name in names]
    return [
        _surface(meshes, "SUs", style.SU, legendgroup="sus"),
        _labels(
            "SUs", names, words, frames, style.SU,
            mode="markers", legendgroup="sus", showlegend=False,
        ),
    ]  # fmt: skip


def _su_names(sus: Mapping[str, Any], frames: Mapping[str, F64], forward: F64) -> go.BaseTraceType:
    """Names of the SUs, a little towards the eye [m]."""
    before = {name: frames[name].copy() for name in sus if name in frames}
    for T in before.values():
        T[:3, 3] += forward
    return _labels(
        "SUs", list(before), [""] * len(before), before, style.SU,
        mode="text", legendgroup="sus", showlegend=False, hoverinfo="skip",
    )  # fmt: skip


def _su_words(name: str, su: Mapping[str, Any]) -> str:
    """What a pointer on an SU shows."""
    x, y, z = (1e3 * su["T_joint_su"][i][3] for i in range(3))
    return "<br>".join(
        [
            f"<b>{in_words(name)}</b> on {in_words(su['joint'] or 'the base')}",
            f"at {x:.1f}, {y:.1f}, {z:.1f} mm in the joint's frame",
            in_words(su["verdict"]),
        ]
    )


def _joint_labels(joints: Mapping[str, Any], frames: Mapping[str, F64]) -> go.Scatter3d:
    words = [
        f"<b>{in_words(name)}</b>, {in_words(joint['type'])}<br>"
        f"on {in_words(joint['parent'] or 'the base')}<br>{in_words(joint['verdict'])}"
        for name, joint in joints.items()
    ]
    return _labels(
        "names of joints", list(joints), words, frames, style.JOINT, visible="legendonly"
    )


def _labels(
    title: str,
    names: Sequence[str],
    words: Sequence[str],
    frames: Mapping[str, F64],
    colour: str,
    **more: Any,
) -> go.Scatter3d:
    """Names in space, and words for the pointer."""
    x, y, z = np.array([frames[name][:3, 3] for name in names]).reshape(-1, 3).astype(np.float32).T
    usual = {
        "mode": "markers+text", "name": title,
        "text": [in_space(name) for name in names], "textposition": "top center",
        "textfont": {"size": 11, "color": colour, "family": "Arial, sans-serif"},
        "marker": {"size": 3, "color": colour},
        "hovertext": list(words), "hoverinfo": "text",
    }  # fmt: skip
    return go.Scatter3d(x=x, y=y, z=z, **{**usual, **more})


def _ellipsoids(title: str, colour: str, found: Sequence[Cloud], times: float) -> go.Mesh3d:
    meshes = merged([cloud.mesh(times) for cloud in found])
    return _surface(meshes, title, colour, opacity=0.6)


def _open(title: str, lines: Sequence[OpenLine], length: float) -> go.Scatter3d:
    """Open directions as lines with gaps between them."""
    ends = [
        [*(line.through - length * line.direction), *(line.through + length * line.direction)]
        for line in lines
    ]
    gap = np.full((len(lines), 1, 3), np.nan)
    points = np.concatenate([np.array(ends).reshape(-1, 2, 3), gap], axis=1)
    x, y, z = points.reshape(-1, 3).astype(np.float32).T
    words = [f"{title}: {in_words(line.name)}" for line in lines for _ in range(3)]
    dash = "dash" if lines[0].turn else "solid"
    return go.Scatter3d(
        x=x, y=y, z=z, mode="lines", name=title, hovertext=words, hoverinfo="text",
        line={"color": style.WRONG, "width": 5, "dash": dash},
    )  # fmt: skip


def _other(contents: Contents, frames: Mapping[str, F64], radius: float) -> list[go.BaseTraceType]:
    """The other robot, in whose base frame the estimate's limbs stand where they fit best."""
    laid = contents.other
    if laid is None:
        return []
    solids = []
    for part, T in alongside(laid.robot, contents.positions, frames):
        meshes = [*rods(part, 0.8 * radius), *(plate(su, 0.9 * radius) for su in part.sus.values())]
        solids += [mesh.moved(T) for mesh in meshes]
    return [_surface(merged(solids), in_words(laid.robot.path.name), style.OTHER, opacity=0.5)]
