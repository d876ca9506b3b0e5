"""One recording: simulate, calibrate without the truth, hold against it."""

from __future__ import annotations

from validation.measure import code_digest

from montecarlo.normalised import blocks_of
from montecarlo.records import Case, Run
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, load_robot, simulate

LAG = 0.03
"""Largest lag of an SU's clock [s]."""


def perform(case: Case) -> Run:
    """Run a case; whatever goes wrong becomes part of the result, so that a batch outlives it."""
    settings = SimulationSettings(
        n_poses=case.poses, excite=case.excite, seed=case.seed, grade=case.grade, lag=LAG
    )
    try:
        simulation = simulate(load_robot(case.robot), settings)
        found = calibrate(retimed(simulation.recording))
        blocks = blocks_of(found, simulation.truth)
    except Exception as error:
        return Run(case, {}, failure=f"{type(error).__name__}: {error}", code=code_digest())
    return Run(case, blocks, float(found.estimate.cost_per_dof), code=code_digest())


def died(case: Case, words: str) -> Run:
    """The run of a case whose process died."""
    return Run(case, {}, failure=f"its process died: {words}", code=code_digest())
