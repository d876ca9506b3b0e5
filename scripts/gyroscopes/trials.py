"""One recording of a robot with gyroscopes, calibrated with them and without."""

from __future__ import annotations

import tempfile
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from batch.figures import rms
from batch.records import Record
from montecarlo.normalised import blocks_of, normalised, summed
from montecarlo.records import Block
from validation.measure import sensor_rotations, truth_as_felt

from skin2urdf import Calibration, CalibrationSettings, calibrate, compare, save
from skin2urdf.arrays import F64
from skin2urdf.errors import Skin2UrdfError
from skin2urdf.estimation.solve.spread import DETERMINED
from skin2urdf.estimation.trajectory.gyro import gyro_deviations
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.recording.records import Recording
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, Truth, load_robot, simulate
from skin2urdf.simulation.sensors import GYROS
from skin2urdf.simulation.settings import Excitation

Posture = Literal["tilted", "upright"]
CONFIGURATIONS = 60
_DEG = float(np.rad2deg(1.0))


@dataclass(frozen=True)
class Case:
    """A recording to make, and to calibrate with gyroscopes and without.

    Attributes:
        robot: name in robots/.
        posture: of its base.
        seed: of the recording.
        excite: pattern of its motion.
        poses: number of poses; without patterns the time counts.
        minutes: how long it moves without patterns [min].
        grade: of the accelerometers.
        gyro: noise of the gyroscopes [deg/s], or their grade.
    """

    robot: str
    posture: Posture
    seed: int
    excite: Excitation = "all"
    poses: int = 8
    minutes: float = 2.0
    grade: str = "mems"
    gyro: str = "0.1"

    @property
    def group(self) -> str:
        """All but the seed, in words."""
        length = f"{self.minutes:g} min" if self.excite == "none" else f"{self.poses} poses"
        return f"{self.robot} {self.grade} {self.excite} {length} gyro {self.gyro} {self.posture}"

    @property
    def key(self) -> str:
        """Names the case."""
        return f"{self.group} seed{self.seed}"

    @property
    def settings(self) -> SimulationSettings:
        """Of the recording."""
        return SimulationSettings(
            n_poses=self.poses,
            excite=self.excite,
            minutes=self.minutes if self.excite == "none" else None,
            seed=self.seed,
            grade=self.grade,
            upright=self.posture == "upright",
            gyro=self.gyro if self.gyro in GYROS else float(self.gyro),
        )


@dataclass(frozen=True)
class Judged:
    """One calibration of a recording; None where there is no figure.

    Attributes:
        position_mm: true error of the SUs' positions, rms over SUs and configurations [mm].
        position_stated_mm: the same as the calibration states it [mm].
        orientation_deg: true error of their orientations [deg].
        orientation_stated_deg: as stated [deg].
        axis_deg: true error of the joints' directions [deg].
        verdict: of the calibration.
        refusal: its words where it gave no result.
        tree_right: whether the tree is right.
        n_undetermined: SUs that are stated to be not determined.
        seconds: time of the calibration [s].
        blocks: squared errors over stated variances, where the first axis is not vertical.
    """

    position_mm: float | None = None
    position_stated_mm: float | None = None
    orientation_deg: float | None = None
    orientation_stated_deg: float | None = None
    axis_deg: float | None = None
    verdict: str = ""
    refusal: str = ""
    tree_right: bool = False
    n_undetermined: int = 0
    seconds: float = 0.0
    blocks: Mapping[str, Block] = field(default_factory=dict)


@dataclass(frozen=True)
class Figures:
    """What came of a recording, with gyroscopes and without."""

    listening: Judged
    deaf: Judged


Trial = Record[Case, Figures]
"""One line of the output."""


def perform(case: Case) -> Figures:
    """Do a case."""
    warnings.simplefilter("ignore")
    simulation = simulate(load_robot(case.robot), case.settings)
    truth, recording = simulation.truth, retimed(simulation.recording)
    del simulation
    tilted = case.posture == "tilted"
    return Figures(*(_judged(recording, truth, gyro, tilted) for gyro in (True, False)))


def _judged(recording: Recording, truth: Truth, gyro: bool, tilted: bool) -> Judged:
    """Calibrate and compare; that the package refuses a recording is part of it."""
    begin = time.perf_counter()
    settings = CalibrationSettings(gravity_deviation=0.0, gyro=gyro)
    try:
        found = calibrate(recording, settings)
    except Skin2UrdfError as error:
        return Judged(refusal=f"{type(error).__name__}: {error}")
    plain = Judged(
        verdict=found.quality,
        n_undetermined=sum(v != "determined" for v in found.observability.su_verdict),
        seconds=time.perf_counter() - begin,
    )
    with tempfile.TemporaryDirectory() as folder:
        try:
            plain = _compared(plain, found, truth, Path(folder))
        except Skin2UrdfError as error:
            return replace(plain, refusal=f"not comparable: {error}")
    if not (plain.tree_right and tilted):
        return plain
    patterned = {} if found.features is None else blocks_of(found, truth)
    return replace(plain, blocks={**patterned, **_of_gyros(found, truth)})


def _compared(plain: Judged, found: Calibration, truth: Truth, folder: Path) -> Judged:
    """The figures with those of a comparison with the truth."""
    tree, seen = found.model.tree, found.observability
    urdf, _ = save(found, folder / "estimate.urdf", visuals=False)
    true = folder / "truth.urdf"
    felt = truth_as_felt(truth, sensor_rotations(truth.sensor_matrix))
    true.write_text(felt, encoding="utf-8")
    verdicts = zip(tree.su_names, seen.su_verdict, strict=True)
    comparison = compare(
        urdf, true,
        unobservable=dict(zip(tree.su_names, seen.su_unobservable, strict=True)),
        anchors=[name for name, verdict in verdicts if verdict == "determined"],
        open_directions=found.open_directions, sus=[su.name for su in truth.sus],
        n_configurations=CONFIGURATIONS, rng=np.random.default_rng(0),
    )  # fmt: skip
    span = np.random.default_rng(0).uniform(size=(CONFIGURATIONS, tree.n_joints))
    q = found.limits[:, 0] + span * (found.limits[:, 1] - found.limits[:, 0])
    position, orientation = aligned_deviations(found.estimate, seen, q)
    row = {name: u for u, name in enumerate(tree.su_names)}
    # The SUs whose placement is determined, as for the tables of arms.
    known = {n for n, v in zip(tree.su_names, seen.su_verdict, strict=True) if v == "determined"}
    sus = [su for su in comparison.sus if su.name in known and su.position and su.orientation]
    rows = [row[su.name] for su in sus]
    return replace(
        plain,
        position_mm=_scaled(rms(su.position.rms for su in sus if su.position), 1e3),
        position_stated_mm=_scaled(rms(position[rows]), 1e3),
        orientation_deg=_scaled(rms(su.orientation.rms for su in sus if su.orientation), _DEG),
        orientation_stated_deg=_scaled(rms(orientation[rows]), _DEG),
        axis_deg=comparison.axis_angle.rms * _DEG,
        tree_right=comparison.tree_equal,
    )


def _of_gyros(found: Calibration, truth: Truth) -> dict[str, Block]:
    """Errors of the gyroscopes' biases and sensitivities over what is stated, where data tell."""
    gyros = found.along.gyros if found.along else None
    if gyros is None:
        return {}
    names = [su.name for su in truth.sus]
    # An SU's frame is its accelerometer's, as cross-axis errors turn it.
    felt = sensor_rotations(truth.sensor_matrix)
    parts: dict[str, list[Block]] = {"gyro bias": [], "gyro scale": [], "gyro axes": []}
    prior = gyro_deviations(0.0)
    off_diagonal = ~np.eye(3, dtype=bool)

    def errors(error: F64, sd: F64, before: float) -> Block:
        told = sd**2 < DETERMINED * before**2
        return normalised(error[told], np.diag(sd[told] ** 2))

    for u, name in enumerate(found.model.tree.su_names):
        if not gyros.used[u]:
            continue
        true = truth.gyros[names.index(name)]
        E = true.matrix @ felt[names.index(name)].T - np.eye(3)
        bias = gyros.bias[0, u] - true.bias
        parts["gyro bias"].append(errors(bias, gyros.bias_sd[0, u], prior[-1]))
        scale = gyros.scale[u] - np.diag(E)
        parts["gyro scale"].append(errors(scale, gyros.scale_sd[u], prior[0]))
        tilt = gyros.misalignment[u] - E[off_diagonal]
        parts["gyro axes"].append(errors(tilt, gyros.misalignment_sd[u], prior[1]))
    return {name: summed(blocks) for name, blocks in parts.items()}


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else float(value * scale)
