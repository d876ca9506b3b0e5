"""One trial: put a fault into a recording, calibrate, and see what was found and what it cost."""

from __future__ import annotations

import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from batch.figures import rms
from batch.records import Record
from validation.cases import Excitation
from validation.measure import sensor_rotations, truth_as_felt

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import InsufficientDataError, Skin2UrdfError
from skin2urdf.recording.records import Recording
from skin2urdf.recording.retiming import retimed
from skin2urdf.report.faults import fault_words
from skin2urdf.report.notes import note_words
from skin2urdf.simulation import SimulationSettings, Truth, load_robot, simulate
from skin2urdf.simulation.faults import FAULTS, Sound, in_two
from skin2urdf.simulation.joint_faults import JOINT_FAULTS
from skin2urdf.urdf.compare import compare
from skin2urdf.urdf.emit import emit

CLEAN, CLEAN_TWO = "clean", "clean in two logs"
"""Recordings without a fault: as they are, and cut into two logs."""
INJECTIONS = {**FAULTS, **JOINT_FAULTS}
"""All faults by name."""
IN_TWO = ("swapped", "encoder_sign")
"""Faults that take two logs, and are held against the same recording in two logs."""
CONFIGURATIONS = 60


@dataclass(frozen=True)
class Setting:
    """What the recordings of a batch have in common.

    Attributes:
        robot: name in robots/.
        grade: sensor grade.
        excite: one DoF after the other, or all at once.
        poses: number of poses.
        encoder_bits: resolution of the encoders.
    """

    robot: str = "panda"
    grade: str = "mems"
    excite: Excitation = "all"
    poses: int = 6
    encoder_bits: int = 17

    @property
    def words(self) -> str:
        """For tables and keys."""
        return f"{self.robot} {self.grade} {self.excite} {self.poses}poses {self.encoder_bits}bit"


@dataclass(frozen=True)
class Case:
    """A trial to do.

    Attributes:
        setting: the recording's circumstances.
        kind: name of the fault, or ``clean``.
        seed: of the recording and of the fault.
    """

    setting: Setting
    kind: str
    seed: int

    @property
    def key(self) -> str:
        """Names the case."""
        return f"{self.setting.words} {self.kind} seed{self.seed}"


@dataclass(frozen=True)
class Figures:
    """What came of it; None where there is no figure.

    Attributes:
        expected: kind of fault that should be named.
        subjects: who has it.
        injected: what was done to them.
        faults: (kind, subject, words) of what was named.
        quality: verdict of the calibration; empty where it gave none.
        cost_per_dof: of the calibration.
        tree_right: whether the tree of the SUs without a fault is right.
        position_mm: rms position error of the SUs without a fault [mm].
        position_clean_mm: the same of the same SUs where there is no fault in the recording.
        orientation_deg: rms orientation error, beside what cross-axis errors hide [deg].
        orientation_clean_deg: likewise.
        notes: of the calibration.
        problem: why the package gave no calibration.
        seconds: processor time of the calibration [s].
        seconds_clean: the same of the recording without the fault [s].
    """

    expected: str = ""
    subjects: tuple[str, ...] = ()
    injected: str = ""
    faults: tuple[tuple[str, str, str], ...] = ()
    quality: str = ""
    cost_per_dof: float | None = None
    tree_right: bool = False
    position_mm: float | None = None
    position_clean_mm: float | None = None
    orientation_deg: float | None = None
    orientation_clean_deg: float | None = None
    notes: tuple[str, ...] = ()
    problem: str = ""
    seconds: float | None = None
    seconds_clean: float | None = None

    @property
    def found(self) -> bool:
        """Whether the fault was named: the right kind, of all who have it."""
        named = {(kind, subject) for kind, subject, _ in self.faults}
        return bool(self.subjects) and all((self.expected, s) in named for s in self.subjects)

    @property
    def false_alarms(self) -> tuple[str, ...]:
        """What was named although it is not there."""
        return tuple(
            words
            for kind, subject, words in self.faults
            if kind != self.expected or subject not in self.subjects
        )


@dataclass(frozen=True, eq=False)
class Timed:
    """A calibration, and the processor time that it took [s]."""

    found: Calibration
    seconds: float


Trial = Record[Case, Figures]
"""One line of the output."""


def perform(case: Case) -> Figures:
    """Do a trial; that the package refuses a recording is part of it."""
    warnings.simplefilter("ignore")
    sound = _sound(case.setting, case.seed)
    truth = sound.simulation.truth
    if case.kind in (CLEAN, CLEAN_TWO):
        try:
            clean = _clean(case.setting, case.seed, case.kind == CLEAN_TWO)
        except Skin2UrdfError as error:
            return Figures(problem=_words(error))
        return _judged(Figures(), clean, truth, ())
    rng = np.random.default_rng([case.seed, *case.kind.encode()])
    faulty = INJECTIONS[case.kind](sound, rng)
    blank = Figures(expected=faulty.kind, subjects=faulty.subjects, injected=faulty.words)
    try:
        # The sound one goes first, so that neither pays for what is loaded once.
        clean = _clean(case.setting, case.seed, case.kind in IN_TWO)
        figures = _judged(blank, _calibrated(faulty.recordings), truth, faulty.subjects)
        reference = _judged(blank, clean, truth, faulty.subjects)
    except Skin2UrdfError as error:
        return replace(blank, problem=_words(error))
    return replace(
        figures,
        position_clean_mm=reference.position_mm,
        orientation_clean_deg=reference.orientation_deg,
        seconds_clean=reference.seconds,
    )


def _words(error: Skin2UrdfError) -> str:
    return f"{type(error).__name__}: {error}"


@lru_cache(maxsize=2)
def _sound(setting: Setting, seed: int) -> Sound:
    settings = SimulationSettings(
        n_poses=setting.poses, excite=setting.excite, seed=seed, grade=setting.grade,
        encoder_bits=setting.encoder_bits,
    )  # fmt: skip
    robot = load_robot(setting.robot)
    return Sound(robot, settings, simulate(robot, settings))


@lru_cache(maxsize=4)
def _clean(setting: Setting, seed: int, two: bool) -> Timed:
    sound = _sound(setting, seed)
    return _calibrated(in_two(sound) if two else (sound.recording,))


def _calibrated(recordings: Sequence[Recording]) -> Timed:
    known = CalibrationSettings(gravity_deviation=0.0)
    begin = time.process_time()
    found = calibrate([retimed(recording) for recording in recordings], known)
    return Timed(found, time.process_time() - begin)


def _judged(blank: Figures, timed: Timed, truth: Truth, without: Sequence[str]) -> Figures:
    """The figures with what a calibration says, and its errors over all SUs but some."""
    found = timed.found
    position, orientation, tree_right = errors(found, truth, without)
    return replace(
        blank,
        faults=tuple(
            (fault.kind, fault.subject, str(fault_words(fault, len(found.sources))))
            for fault in found.faults
        ),
        quality=found.quality,
        cost_per_dof=found.estimate.cost_per_dof,
        tree_right=tree_right,
        position_mm=position,
        orientation_deg=orientation,
        notes=tuple(note_words(found.notes)),
        seconds=timed.seconds,
    )


def errors(found: Calibration, truth: Truth, without: Sequence[str]) -> tuple[float, float, bool]:
    """Errors of a calibration over all SUs but some, which do not align it either.

    Returns:
        rms position [mm] and orientation [deg] beside what cross-axis errors hide, and whether
        the tree is right.
    """
    tree, seen = found.model.tree, found.observability
    names = [su.name for su in truth.sus if su.name not in without]
    free: Mapping[str, Any] = dict(zip(tree.su_names, seen.su_unobservable, strict=True))
    anchors = [
        name
        for name, verdict in zip(tree.su_names, seen.su_verdict, strict=True)
        if verdict == "determined" and name in names
    ]
    text = emit(
        found.model, name="estimate", limits=found.limits, velocity=found.velocity,
        continuous=found.continuous,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        estimate, true = Path(folder) / "estimate.urdf", Path(folder) / "truth.urdf"
        estimate.write_text(text, encoding="utf-8")
        felt = truth_as_felt(truth, sensor_rotations(truth.sensor_matrix))
        true.write_text(felt, encoding="utf-8")
        comparison = compare(
            estimate, true, unobservable=free, anchors=anchors, sus=names,
            open_directions=found.open_directions,
            n_configurations=CONFIGURATIONS, rng=np.random.default_rng(0),
        )  # fmt: skip
    sus = [su for su in comparison.sus if su.name in names]
    position = rms(su.position.rms for su in sus if su.position)
    orientation = rms(su.orientation.rms for su in sus if su.orientation)
    if position is None or orientation is None:
        raise InsufficientDataError("nothing is observable of the SUs without a fault", "")
    return position * 1e3, float(np.rad2deg(orientation)), comparison.tree_equal
