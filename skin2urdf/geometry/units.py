"""Units: the one gravity of the package, what is given in parts of it, and those of positions."""

from __future__ import annotations

import math

GRAVITY = 9.81
"""Magnitude of gravity [m/s^2] where the user gives no other, and the size of 1 g in data sheets
and in the readings of sensors that report g."""

MILLI_G = 1e-3 * GRAVITY
"""A thousandth of it [m/s^2]."""

FORCE_UNITS = {
    "m/s^2": 1.0, "g": GRAVITY, "mg": MILLI_G, "mm/s^2": 1e-3, "cm/s^2": 1e-2, "ft/s^2": 0.3048
}  # fmt: skip
"""Units of specific force [m/s^2]."""

JOINT_UNITS = {
    "rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180, "rev": 2 * math.pi, "m": 1.0, "mm": 1e-3
}  # fmt: skip
"""Units of positions of joints [rad or m]."""

IN_UNITS = (
    "record positions in rad and m (REP 103), or write a log with these by `skin2urdf convert LOG "
    "OUT.mcap --joint-unit deg`, or --joint-unit NAME=mm"
)
"""What to do about logs whose joints are in other units, in words."""
