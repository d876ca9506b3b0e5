"""Figures of a calibration of which nothing is wrong, as benches keep them."""

from bench.measured import Figures

GOOD = Figures(
    position_mm=0.05,
    position_stated_mm=0.04,
    orientation_deg=0.003,
    orientation_stated_deg=0.004,
    verdict="good",
    tree_right=True,
    n_sus=8,
    seconds=1.0,
)
