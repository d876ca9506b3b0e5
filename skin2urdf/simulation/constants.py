"""Constants of the simulated world."""

GRAVITY = 9.81
"""Gravity in the simulated world, and the size of 1 g in a sensor's data sheet [m/s^2]."""
