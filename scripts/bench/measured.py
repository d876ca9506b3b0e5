"""What is stated of the result of a calibration, and what is true."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from batch.figures import rms
from montecarlo.normalised import blocks_of
from montecarlo.records import Block
from validation.measure import sensor_rotations, truth_as_felt

from skin2urdf import Calibration, CalibrationSettings, calibrate, compare, save
from skin2urdf.arrays import F64
from skin2urdf.errors import Skin2UrdfError
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.recording.records import Recording
from skin2urdf.report.findings import is_to_repair
from skin2urdf.report.notes import note_words
from skin2urdf.simulation import Truth

CONFIGURATIONS = 60
NORMALISED = (
    "SU position", "SU orientation", "SU orientation, felt", "joint axis, offset",
    "joint axis, direction",
)  # fmt: skip
"""Blocks whose errors are held against stated variances. Sensors' own errors and clocks are not
among them: some defects are about these."""


@dataclass(frozen=True)
class Figures:
    """What came of it; None where there is no figure.

    Attributes:
        position_mm: true error of the SUs' positions, rms over SUs and configurations [mm].
        position_stated_mm: the same as the calibration states it [mm].
        orientation_deg: true error of their orientations [deg].
        orientation_stated_deg: as stated [deg].
        known_deg: true error of the orientations of SUs that are stated to be determined [deg].
        blocks: squared errors over stated variances of what :data:`NORMALISED` names, where the
            tree is right.
        verdict: of the calibration; empty where it refused.
        exit_status: of the command line.
        refusal: its words where it gave no result.
        named: kind and subject of all that was said to be wrong.
        causes: what was added to a rigid robot with steady sensors, as joints that yield.
        notes: of the calibration.
        cost_per_dof: of the calibration.
        tree_right: whether the tree is right.
        n_sus: number of SUs.
        n_undetermined: SUs that are stated to be not determined.
        seconds: time of the calibration [s].
    """

    position_mm: float | None = None
    position_stated_mm: float | None = None
    orientation_deg: float | None = None
    orientation_stated_deg: float | None = None
    known_deg: float | None = None
    blocks: Mapping[str, Block] = field(default_factory=dict)
    verdict: str = ""
    exit_status: int = 0
    refusal: str = ""
    named: tuple[tuple[str, str], ...] = ()
    causes: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    cost_per_dof: float | None = None
    tree_right: bool = False
    n_sus: int = 0
    n_undetermined: int = 0
    seconds: float = 0.0

    @property
    def position_ratio(self) -> float | None:
        """True position error over the stated one."""
        return _over(self.position_mm, self.position_stated_mm)

    @property
    def orientation_ratio(self) -> float | None:
        """True orientation error over the stated one."""
        return _over(self.orientation_deg, self.orientation_stated_deg)


def measured(recording: Recording, truth: Truth, settings: CalibrationSettings) -> Figures:
    """Calibrate and compare; that the package refuses a recording is part of it."""
    begin = time.perf_counter()
    try:
        found = calibrate(recording, settings)
        seconds = time.perf_counter() - begin
        with tempfile.TemporaryDirectory() as folder:
            return _compared(found, truth, Path(folder), seconds)
    except Skin2UrdfError as error:
        # A bad result is refused where it would be written.
        return Figures(
            exit_status=error.exit_status,
            refusal=f"{type(error).__name__}: {error}",
            n_sus=len(truth.sus),
            seconds=time.perf_counter() - begin,
        )


def _compared(found: Calibration, truth: Truth, folder: Path, seconds: float) -> Figures:
    """The figures of a result."""
    tree, seen = found.model.tree, found.observability
    verdicts = dict(zip(tree.su_names, seen.su_verdict, strict=True))
    free: Mapping[str, F64] = dict(zip(tree.su_names, seen.su_unobservable, strict=True))
    urdf, _ = save(found, folder / "estimate.urdf", visuals=False)
    true = folder / "truth.urdf"
    felt = truth_as_felt(truth, sensor_rotations(truth.sensor_matrix))
    true.write_text(felt, encoding="utf-8")
    plain = Figures(
        verdict=found.quality,
        exit_status=_exit_status(found),
        named=tuple((fault.kind, fault.subject) for fault in found.faults),
        causes=() if found.along is None else found.along.causes,
        notes=tuple(note_words(found.notes)),
        cost_per_dof=float(found.estimate.cost_per_dof),
        n_sus=len(truth.sus),
        n_undetermined=sum(verdict != "determined" for verdict in verdicts.values()),
        seconds=seconds,
    )
    try:
        comparison = compare(
            urdf, true, unobservable=free,
            anchors=[name for name, verdict in verdicts.items() if verdict == "determined"],
            open_directions=found.open_directions, sus=[su.name for su in truth.sus],
            n_configurations=CONFIGURATIONS, rng=np.random.default_rng(0),
        )  # fmt: skip
    except Skin2UrdfError as error:
        return replace(plain, refusal=f"not comparable: {error}")
    # Stated over configurations of the joints in the ranges that were seen, as any user has them.
    span = np.random.default_rng(0).uniform(size=(CONFIGURATIONS, tree.n_joints))
    q = found.limits[:, 0] + span * (found.limits[:, 1] - found.limits[:, 0])
    position, orientation = aligned_deviations(found.estimate, seen, q)
    row = {name: u for u, name in enumerate(tree.su_names)}
    placed = [su for su in comparison.sus if su.position is not None]
    turned = [su for su in comparison.sus if su.orientation is not None]
    known = [su for su in turned if verdicts[su.name] == "determined"]
    blocks = _blocks(found, truth) if comparison.tree_equal else {}
    return replace(
        plain,
        position_mm=_scaled(rms(su.position.rms for su in placed if su.position), 1e3),
        position_stated_mm=_scaled(rms(position[row[su.name]] for su in placed), 1e3),
        orientation_deg=_scaled(rms(su.orientation.rms for su in turned if su.orientation), _DEG),
        orientation_stated_deg=_scaled(rms(orientation[row[su.name]] for su in turned), _DEG),
        known_deg=_scaled(rms(su.orientation.rms for su in known if su.orientation), _DEG),
        blocks={name: blocks[name] for name in NORMALISED if name in blocks},
        tree_right=comparison.tree_equal,
    )


def _blocks(found: Calibration, truth: Truth) -> Mapping[str, Block]:
    """Errors over stated variances; none without patterns, or where joints are in another order."""
    if found.features is None:
        return {}
    try:
        return blocks_of(found, truth)
    except ValueError:  # of joints that can be exchanged
        return {}


def _exit_status(found: Calibration) -> int:
    """What the command line exits with for a result."""
    if found.quality == "bad":
        return 1
    return 3 if is_to_repair(found) else 0


_DEG = float(np.rad2deg(1.0))


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else float(value * scale)


def _over(above: float | None, below: float | None) -> float | None:
    return above / below if above is not None and below else None
