"""One recording of drawn circumstances: what is stated of the result, and what is true."""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from batch.records import Record
from bench.measured import Figures, measured

from drawn.circumstances import drawn
from skin2urdf import CalibrationSettings
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import Simulation, SimulationSettings, simulate


@dataclass(frozen=True)
class Case:
    """A recording to make and calibrate.

    Attributes:
        seed: what everything is drawn from.
        most_joints: that move.
    """

    seed: int
    most_joints: int = 7

    @property
    def key(self) -> str:
        """Names the case."""
        return f"seed{self.seed} joints{self.most_joints}"


@dataclass(frozen=True)
class Outcome:
    """What came of it.

    Attributes:
        robot: its name.
        words: kinds of what was drawn.
        defects: with their sizes.
        samples: of all SUs.
        clipped: SUs whose readings really were cut off at the end of their range.
        figures: of the calibration.
    """

    robot: str
    words: tuple[str, ...]
    defects: tuple[str, ...]
    samples: int
    clipped: tuple[str, ...]
    figures: Figures


Trial = Record[Case, Outcome]
"""One line of the output."""


def perform(case: Case) -> Outcome:
    """Do a case."""
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        circumstances = drawn(case.seed, case.most_joints, Path(folder))
        simulation = simulate(circumstances.robot, circumstances.settings)
    settings = CalibrationSettings()
    if circumstances.gravity_told:
        settings = replace(settings, gravity_deviation=0.0)
    clipped = _clipped(simulation, circumstances.settings)
    truth, recording = simulation.truth, retimed(simulation.recording)
    del simulation
    return Outcome(
        circumstances.robot.name,
        circumstances.words,
        tuple(map(repr, circumstances.settings.defects)),
        sum(len(su.time) for su in recording.sus),
        clipped,
        measured(recording, truth, settings),
    )


def _clipped(simulation: Simulation, settings: SimulationSettings) -> tuple[str, ...]:
    grade = settings.sensor_grade
    if grade.full_scale is None:
        return ()
    end = grade.full_scale * grade.unit - 1.5 * grade.step
    sus = simulation.recording.sus
    return tuple(su.name for su in sus if np.abs(su.specific_force).max() >= end)
