"""The page as text: figures and tables in a template, with everything it needs inside."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.page.contents import Contents
from skin2urdf.page.on_model import is_on_model
from skin2urdf.report.tables import number

_NEEDED = ("plotly", "jinja2")


def check_libraries() -> None:
    """Make sure that pages can be made, before the work that they show.

    Raises:
        UsageError: a library is missing.
    """
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        raise UsageError(
            f"a report needs {' and '.join(missing)}", "pip install 'skin2urdf[report]'"
        )


def as_page(contents: Contents) -> str:
    """The whole page.

    Args:
        contents: what it shows.

    Returns:
        HTML without any reference to another file; the same contents give the same text.

    Raises:
        UsageError: a library is missing.
        UnreadableInputError: the JSON lacks what a page shows.
    """
    check_libraries()
    try:
        return _render(contents)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        beside = contents.urdf.with_suffix(".json")
        raise UnreadableInputError(
            str(beside),
            f"lacks what a report shows ({type(error).__name__}: {error})",
            "calibrate again with this version",
        ) from error


def _render(contents: Contents) -> str:
    """The page, from a document that is whole."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from plotly.offline import get_plotlyjs

    from skin2urdf.page.advice import advice, never_known
    from skin2urdf.page.fit_figures import activity_figure, residual_figures
    from skin2urdf.page.robot_figure import robot_figure

    document = contents.document
    robot, times = robot_figure(contents)
    figures = {"robot": robot, "activity": activity_figure(document), **residual_figures(document)}
    environment = Environment(
        loader=PackageLoader("skin2urdf.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = _number
    library, own = get_plotlyjs(), _file("page.js")
    laid = contents.other
    return environment.get_template("page.html").render(
        document=document,
        on_model=is_on_model(document),
        name=contents.robot.model.name,
        urdf=contents.urdf.name,
        beside=contents.urdf.with_suffix(".json").name,
        advice=advice(document),
        never=never_known(document),
        tree=_tree(document),
        times=times,
        shown=set(figures),
        limbs=len(contents.limbs),
        traces=bool(contents.traces),
        replayed=contents.replayed,
        other=laid.robot.path.name if laid else "",
        why_not=laid.why if laid else "",
        errors=_errors(contents),
        data=_script_safe(
            {
                "figures": {name: json.loads(f.to_json()) for name, f in figures.items()},
                "traces": [_trace(trace) for trace in contents.traces],
            }
        ),
        style=_file("page.css"),
        library=library,
        own=own,
        hashes=[_hash(library), _hash(own)],
    )


def _file(name: str) -> str:
    """A file beside the template."""
    return (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")


def _hash(script: str) -> str:
    """By what a browser knows a script that may run."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode()}"


def _script_safe(value: Any) -> str:
    """JSON that can not end the script element it stands in."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _trace(trace: Any) -> dict[str, Any]:
    """One trace in single precision."""
    return {
        "log": trace.log,
        "su": trace.su,
        "rms": trace.rms,
        "time": _packed(trace.time),
        "reading": [_packed(axis) for axis in trace.reading.T],
        "predicted": [_packed(axis) for axis in trace.predicted.T],
    }


def _packed(values: F64) -> str:
    """Numbers as base64 of little-endian float32."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def _number(value: float | None, digits: int = 2) -> str:
    """A number for a table, a dash where there is none."""
    return number(float("nan") if value is None else float(value), digits)


def _tree(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Joints and SUs from the base outwards, indented where the tree forks.

    A single chain needs no deeper indent for every joint.
    """
    joints, sus = document["tree"]["joints"], document["tree"]["sus"]
    parent_of = {joint["name"]: joint["parent"] for joint in joints}
    after: dict[str | None, list[Mapping[str, Any]]] = {}
    for joint in joints:
        after.setdefault(joint["parent"], []).append(joint)
    rows: list[dict[str, Any]] = []
    todo: list[tuple[str | None, str, int]] = [(None, "", 0)]
    while todo:
        name, kind, depth = todo.pop()
        carried = [su for su, on in sus.items() if on == name]
        row = {"name": name, "type": kind, "depth": depth, "sus": carried, "branch": False}
        rows.append(row)
        children = after.get(name, [])
        deeper = depth + (len(children) > 1)
        todo += [(child["name"], child["type"], deeper) for child in reversed(children)]
    for before, row in pairwise(rows):
        row["branch"] = row["depth"] and parent_of.get(row["name"]) != before["name"]
    return rows


def _errors(contents: Contents) -> dict[str, Any]:
    """Errors against the other robot [mm, deg]; empty where there is nothing to compare."""
    laid = contents.other
    if laid is None or laid.comparison is None:
        return {}
    return laid.comparison.to_dict()
