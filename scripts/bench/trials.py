"""One recording with the defects of a row: what is stated of the result, and what is true."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

from batch.records import Record

from bench.measured import Figures, measured
from bench.rows import BASES, ROWS
from bench.tilting import on_a_tilting_base
from skin2urdf import CalibrationSettings
from skin2urdf.calibration.settings import Motion
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import RobotSpec, SimulationSettings, load_robot, simulate
from skin2urdf.simulation.defects import LocalGravity
from skin2urdf.simulation.robots import example_robot_data
from skin2urdf.simulation.settings import WITHOUT_PATTERNS, Excitation

TWO_ARMS = "two_arms"
"""The tree of the bench: Baxter's shoulders and elbows, two arms of four joints on one torso."""
_SIMULATED = SimulationSettings()


@dataclass(frozen=True)
class Case:
    """A recording to make and calibrate.

    Attributes:
        robot: name in robots/, or ``two_arms``.
        row: name of its defects.
        seed: of the recording.
        excite: pattern of its motion.
        poses: number of poses; without patterns the time counts.
        minutes: how long it moves without patterns [min].
        grade: sensor grade.
        motion: which samples the calibration takes.
        imu_rate: samples per second of each SU [Hz].
        effort: noise of the torques that joint states hold [N m]; None for joint states without.
        bits: steps of an encoder per turn, as a power of two.
    """

    robot: str
    row: str
    seed: int
    excite: Excitation = "one"
    poses: int = 8
    minutes: float = 3.0
    grade: str = "mems"
    motion: Motion = "all"
    imu_rate: float = _SIMULATED.imu_rate
    effort: float | None = None
    bits: int | None = _SIMULATED.encoder_bits

    @property
    def circumstance(self) -> str:
        """All but row and seed, in words."""
        length = f"{self.minutes:g}min" if self.excite in WITHOUT_PATTERNS else f"{self.poses}poses"
        words = [self.robot, self.grade, self.excite, length]
        if self.imu_rate != _SIMULATED.imu_rate:
            words.append(f"{self.imu_rate:g}Hz")
        if self.effort is not None:
            words.append(f"effort+-{self.effort:g}")
        if self.bits != _SIMULATED.encoder_bits:
            words.append(f"{self.bits} bits")
        if self.motion != "all":
            words.append(f"motion={self.motion}")
        return " ".join(words)

    @property
    def key(self) -> str:
        """Names the case."""
        return f"{self.circumstance} {self.row} seed{self.seed}"

    @property
    def settings(self) -> SimulationSettings:
        """Of the recording."""
        return SimulationSettings(
            n_poses=self.poses,
            excite=self.excite,
            minutes=self.minutes if self.excite in WITHOUT_PATTERNS else None,
            seed=self.seed,
            grade=self.grade,
            imu_rate=self.imu_rate,
            torque_noise=self.effort,
            encoder_bits=self.bits,
            defects=ROWS[self.row],
        )


Trial = Record[Case, Figures]
"""One line of the output."""


def robot(name: str) -> RobotSpec:
    """A robot of the package, or the bench's own."""
    if name != TWO_ARMS:
        return load_robot(name)
    baxter = load_robot(example_robot_data() / "baxter_description/urdf/baxter.urdf")
    return replace(baxter, name=name, moving=("left_[se]*", "right_[se]*"))


def calibration_settings(case: Case) -> CalibrationSettings:
    """Settings of a laboratory that knows its gravity, but where that is what the row is about."""
    told = not any(isinstance(each, LocalGravity) for each in case.settings.defects)
    settings = CalibrationSettings(motion=case.motion)
    return replace(settings, gravity_deviation=0.0) if told else settings


def perform(case: Case) -> Figures:
    """Do a case."""
    warnings.simplefilter("ignore")
    simulation = simulate(robot(case.robot), case.settings)
    truth, recording = simulation.truth, simulation.recording
    if case.row in BASES:
        recording = on_a_tilting_base(simulation, BASES[case.row], case.seed)
    recording = retimed(recording)
    del simulation
    return measured(recording, truth, calibration_settings(case))
