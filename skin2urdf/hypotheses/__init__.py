"""Faults that show in a fit: recognised, mended, and the calibration done again."""
