"""Trajectories as files: ``trajectory_msgs/JointTrajectory`` as YAML, and tables as CSV."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import UnreadableInputError
from skin2urdf.planning.records import Limits
from skin2urdf.planning.trajectory import JointTrajectory

_NANO = 1_000_000_000
_DIGITS = (9, 8, 7)
"""Decimals of positions, velocities and accelerations. Rounding them disturbs the acceleration of
polynomials through points 20 ms apart by less than 1e-4 rad/s^2."""
_PEAKS = (1.875, 5.774, 60.0)
"""Largest speed, acceleration and jerk of a polynomial of fifth order from rest to rest, over way
and time, its square and its cube."""
_ENDLESS = 2 * np.pi
"""Way that a joint without limits may be from the start [rad or m]."""


def approach_time(start: F64, limits: Limits) -> float:
    """Time in which the start is reached from anywhere within the limits without leaving them [s].

    A controller makes the way from where the robot is to the first point by a polynomial of fifth
    order.

    Args:
        start: (D,) first positions [rad or m].
        limits: what the joints may do.
    """
    way = np.maximum(np.abs(start - limits.lower), np.abs(limits.upper - start))
    way = np.where(np.isfinite(way), way, _ENDLESS)
    needed = [
        (peak * way / most) ** (1 / (n + 1))
        for n, (peak, most) in enumerate(
            zip(_PEAKS, (limits.velocity, limits.acceleration, limits.jerk), strict=True)
        )
    ]
    return float(np.ceil(np.max(needed)))


def rounded(trajectory: JointTrajectory) -> JointTrajectory:
    """The trajectory as files have it: whole nanoseconds, and so many decimals."""
    return JointTrajectory(
        trajectory.joint_names,
        np.round(trajectory.time * _NANO) / _NANO,
        np.round(trajectory.position, _DIGITS[0]),
        np.round(trajectory.velocity, _DIGITS[1]),
        np.round(trajectory.acceleration, _DIGITS[2]),
    )


def as_yaml(trajectory: JointTrajectory, comment: str = "") -> str:
    """A trajectory as ``trajectory_msgs/msg/JointTrajectory``.

    Args:
        trajectory: the trajectory.
        comment: lines to begin with.
    """
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    names = ", ".join(json.dumps(name) for name in trajectory.joint_names)
    lines += [
        "header:",
        "  stamp: {sec: 0, nanosec: 0}",
        "  frame_id: ''",
        f"joint_names: [{names}]",
        "points:",
    ]
    parts = (trajectory.position, trajectory.velocity, trajectory.acceleration)
    columns = ("positions", "velocities", "accelerations")
    for k, time in enumerate(trajectory.time):
        sec, nano = divmod(round(float(time) * _NANO), _NANO)
        for i, (name, values, digits) in enumerate(zip(columns, parts, _DIGITS, strict=True)):
            row = ", ".join(_number(value, digits) for value in values[k])
            lines.append(f"{'-' if i == 0 else ' '} {name}: [{row}]")
        lines.append("  effort: []")
        lines.append(f"  time_from_start: {{sec: {sec}, nanosec: {nano}}}")
    return "\n".join(lines) + "\n"


def as_csv(trajectory: JointTrajectory) -> str:
    """A trajectory as a table: time, and position, velocity and acceleration of each joint."""
    names = trajectory.joint_names
    head = [f"{what} {name}" for what in ("position", "velocity", "acceleration") for name in names]
    rows = [",".join(["time", *(_quoted(column) for column in head)])]
    parts = (trajectory.position, trajectory.velocity, trajectory.acceleration)
    for k, time in enumerate(trajectory.time):
        cells = [
            _number(value, digits)
            for values, digits in zip(parts, _DIGITS, strict=True)
            for value in values[k]
        ]
        rows.append(",".join([_number(time, 9), *cells]))
    return "\n".join(rows) + "\n"


def read_trajectory(path: str | Path) -> JointTrajectory:
    """A trajectory from YAML: a JointTrajectory, or a goal of FollowJointTrajectory around one.

    Args:
        path: the file.

    Raises:
        UnreadableInputError: it can not be read, or is no trajectory with accelerations.
    """
    import yaml

    try:
        text = Path(path).read_text(encoding="utf-8")
        loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        data = yaml.load(text, Loader=loader)  # noqa: S506 - a safe loader, either of them
    except OSError as error:
        raise UnreadableInputError(
            str(path), f"can not be read: {error.strerror or error}", "check the path"
        ) from error
    except (yaml.YAMLError, ValueError) as error:
        raise _no_trajectory(path, f"is not YAML: {' '.join(str(error).split())}") from error
    if isinstance(data, dict) and isinstance(data.get("trajectory"), dict):
        data = data["trajectory"]
    try:
        names = tuple(str(name) for name in data["joint_names"])
        points = data["points"]
        time = np.array(
            [
                int(p["time_from_start"]["sec"]) + int(p["time_from_start"]["nanosec"]) / _NANO
                for p in points
            ]
        )
        rows = [
            np.array([p[key] for p in points], dtype=np.float64)
            for key in ("positions", "velocities", "accelerations")
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise _no_trajectory(
            path, f"is no JointTrajectory with velocities and accelerations: {error!r}"
        ) from error
    if len(time) < 2 or not names or any(x.shape != (len(time), len(names)) for x in rows):
        raise _no_trajectory(path, "needs two points or more, with a number for every joint")
    if len(set(names)) < len(names):
        raise _no_trajectory(path, "names a joint twice")
    if not (np.isfinite(rows).all() and (np.diff(time) > 0).all()):
        raise _no_trajectory(path, "has times that do not grow, or numbers that are none")
    return JointTrajectory(names, time, *rows)


def _number(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}".rstrip("0")
    text = text + "0" if text.endswith(".") else text
    return text[1:] if text in ("-0.0",) else text


def _quoted(cell: str) -> str:
    return '"' + cell.replace('"', '""') + '"' if set(cell) & set(',"\n') else cell


def _no_trajectory(path: str | Path, what: str) -> UnreadableInputError:
    return UnreadableInputError(str(path), what, "give a file that skin2urdf plan wrote")
