"""One recording: simulate, calibrate without the truth, hold against it."""

from __future__ import annotations

from montecarlo.normalised import blocks_of
from montecarlo.records import Case, Figures
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.simulation import SimulationSettings, load_robot, simulate

LAG = 0.03
"""Largest lag of an SU's clock [s]."""


def perform(case: Case) -> Figures:
    """Run a case.

    Raises:
        Skin2UrdfError: there is no calibration.
        ValueError: its tree is not the true one.
    """
    settings = SimulationSettings(
        n_poses=case.poses, excite=case.excite, seed=case.seed, grade=case.grade, lag=LAG
    )
    simulation = simulate(load_robot(case.robot), settings)
    found = calibrate(simulation.recording, CalibrationSettings(gravity_deviation=0.0))
    blocks = blocks_of(found, simulation.truth)
    return Figures(blocks, float(found.estimate.cost_per_dof))
