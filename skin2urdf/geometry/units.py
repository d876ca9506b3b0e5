"""Units of acceleration: the one gravity of the package, and what is given in parts of it."""

from __future__ import annotations

GRAVITY = 9.81
"""Magnitude of gravity [m/s^2] where the user gives no other, and the size of 1 g in data sheets
and in the readings of sensors that report g."""

MILLI_G = 1e-3 * GRAVITY
"""A thousandth of it [m/s^2]."""
