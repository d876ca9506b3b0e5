"""Columns of a table by their headers: what they hold, and in which unit.

A header is ``NAME [UNIT]``. One column is the time; a joint has one column, and one more of its
name where its torque was measured; an SU has three, whose names end in ``.x``, ``.y`` and ``.z``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from skin2urdf.errors import Unreadable
from skin2urdf.geometry.units import FORCE_UNITS, JOINT_UNITS

TIME_UNITS = {"s": 1e9, "ms": 1e6, "us": 1e3, "µs": 1e3, "μs": 1e3, "ns": 1.0}
"""Nanoseconds in each."""
EFFORT_UNITS = ("Nm", "N m", "N*m", "N")
_SQUARES = "^2", "²", "2", "**2"
_FORCE_UNITS = {
    unit.removesuffix("^2") + square: factor
    for unit, factor in FORCE_UNITS.items()
    for square in (_SQUARES if unit.endswith("^2") else ("",))
}
_HEADER = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]")
_AXES = "xyz"


class BadColumnsError(ValueError):
    """Headers that are not those of a log.

    Attributes:
        why: what is wrong with them.
    """

    def __init__(self, why: Unreadable, what: str) -> None:
        super().__init__(what)
        self.why = why


@dataclass(frozen=True)
class Columns:
    """What the columns of a table hold.

    Attributes:
        time: number of the column of times.
        time_unit: nanoseconds in its unit.
        joints: name, number of the column and factor to rad or m of each joint.
        efforts: number of the column of each joint whose torque or force was measured, by name.
        sus: name, numbers of the three columns and factors to m/s^2 of each SU.
        unused: headers that say nothing that is used.
    """

    time: int
    time_unit: float
    joints: tuple[tuple[str, int, float], ...]
    efforts: Mapping[str, int]
    sus: tuple[tuple[str, tuple[int, ...], tuple[float, ...]], ...]
    unused: tuple[str, ...]


def columns_of(headers: Sequence[str]) -> Columns:
    """Tell what columns hold.

    Args:
        headers: the first line of a table.

    Raises:
        BadColumnsError: they are not those of a log.
    """
    times: list[tuple[int, float]] = []
    joints: dict[str, tuple[int, float]] = {}
    efforts: dict[str, int] = {}
    axes: dict[str, dict[str, tuple[int, float]]] = {}
    unused: list[str] = []
    for k, header in enumerate(headers):
        found = _HEADER.fullmatch(header.strip())
        name, unit = (found["name"], found["unit"].strip()) if found else (header.strip(), "")
        stem, _, axis = name.rpartition(".")
        if name.lower() in ("time", "stamp", "timestamp", "t"):
            if unit not in TIME_UNITS:
                what = f"the column {header.strip()!r} lacks a unit: write `time [s]` or `[ns]`"
                raise BadColumnsError("no unit", what)
            times.append((k, TIME_UNITS[unit]))
        elif unit in _FORCE_UNITS and stem and axis.lower() in _AXES and axis:
            if axes.setdefault(stem, {}).setdefault(axis.lower(), (k, _FORCE_UNITS[unit]))[0] != k:
                raise BadColumnsError("same column", f"two columns are called {header.strip()!r}")
        elif unit in JOINT_UNITS and name:
            if joints.setdefault(name, (k, JOINT_UNITS[unit]))[0] != k:
                raise BadColumnsError("same column", f"two columns are called {header.strip()!r}")
        elif unit in EFFORT_UNITS and name:
            if efforts.setdefault(name, k) != k:
                raise BadColumnsError("same column", f"two columns are called {header.strip()!r}")
        else:
            unused.append(header.strip())
    if not times:
        raise BadColumnsError("no times", "there is no column of times")
    if len(times) > 1:
        raise BadColumnsError("several times", "there are several columns of times")
    for stem, found_axes in axes.items():
        missing = [axis for axis in _AXES if axis not in found_axes]
        if missing:
            raise BadColumnsError("missing axis", f"the SU {stem!r} lacks {' and '.join(missing)}")
    unused += [headers[k].strip() for name, k in efforts.items() if name not in joints]
    if not joints and not axes:
        raise BadColumnsError("nothing usable", "no column is a joint or an SU")
    return Columns(
        *times[0],
        tuple((name, *place) for name, place in joints.items()),
        MappingProxyType({name: k for name, k in efforts.items() if name in joints}),
        tuple(
            (name, tuple(found[a][0] for a in _AXES), tuple(found[a][1] for a in _AXES))
            for name, found in axes.items()
        ),
        tuple(unused),
    )
