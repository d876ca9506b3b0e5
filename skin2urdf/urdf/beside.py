"""The JSON beside an estimated URDF, and what it says the log could not tell."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from skin2urdf.arrays import F64
from skin2urdf.model.records import OpenDirection
from skin2urdf.urdf.directions import load_determined, load_open, load_ranges, load_unobservable


@dataclass(frozen=True, eq=False)
class Untold:
    """What the log behind an estimated URDF does not tell.

    Attributes:
        path: the JSON that says so.
        unobservable: per SU name (k, 6) twists along which it may be displaced; None where the
            file says nothing of it.
        determined: names of the SUs that are determined; None likewise.
        open_directions: ways in which branches may sit elsewhere relative to each other.
        ranges: lower and upper end of what the log saw of each joint [rad or m].
    """

    path: Path
    unobservable: Mapping[str, F64] | None
    determined: frozenset[str] | None
    open_directions: tuple[OpenDirection, ...]
    ranges: Mapping[str, tuple[float, float]]


def document_beside(urdf: str | Path) -> Path | None:
    """The JSON that was written together with a URDF.

    Args:
        urdf: a URDF, which may have been changed or replaced since.

    Returns:
        Path of the JSON; None where there is none or where it belongs to another URDF.
    """
    path = Path(urdf)
    beside = path.with_suffix(".json")
    try:
        belongs = json.loads(beside.read_bytes())["urdf"]["sha256"]
        same = belongs == hashlib.sha256(path.read_bytes()).hexdigest()
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return beside if same else None


def untold_beside(urdf: str | Path) -> Untold | None:
    """What the JSON beside a URDF says that its log could not tell.

    Args:
        urdf: an estimated URDF.

    Returns:
        None where there is no JSON of this very file.

    Raises:
        UnreadableInputError: the JSON holds directions that are none.
    """
    path = document_beside(urdf)
    if path is None:
        return None
    return Untold(
        path, load_unobservable(path), load_determined(path), load_open(path), load_ranges(path)
    )
