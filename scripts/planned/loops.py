"""From a plan over its recording to a calibration: what was foreseen, stated, and is true."""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from batch.figures import rms
from batch.records import Record

from planned.trials import with_model
from skin2urdf import Calibration, CalibrationSettings, calibrate, compare, save
from skin2urdf.errors import Skin2UrdfError
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.geometry.earth import ANOMALY
from skin2urdf.planning.expected import expected, sensors_of
from skin2urdf.planning.files import rounded
from skin2urdf.planning.kinematics import PlacedSu, kinematic_model
from skin2urdf.planning.plan import make_plan
from skin2urdf.planning.records import PlanSettings
from skin2urdf.recording.writing import write
from skin2urdf.simulation import GRADES, Simulation, SimulationSettings, load_robot, simulate
from skin2urdf.simulation.mechanism import load_mechanism

_OPEN = "not observable"
_DEG = float(np.rad2deg(1.0))


@dataclass(frozen=True)
class Case:
    """A plan to make, to record and to calibrate from.

    Attributes:
        robot: name in robots/.
        seed: of SUs, plan and recordings.
        grade: of the accelerometers.
        part: length of the plan over that of the default recording.
        default: whether the default recording is calibrated as well.
    """

    robot: str
    seed: int
    grade: str = "mems"
    part: float = 0.48
    default: bool = True

    @property
    def group(self) -> str:
        """All but the seed, in words."""
        return f"{self.robot} {self.grade} {self.part:g}" + " with default" * self.default

    @property
    def key(self) -> str:
        """Names the case."""
        return f"{self.group} seed{self.seed}"


@dataclass(frozen=True)
class Deviations:
    """Of all SUs whose placement is observable, rms; None where there is no figure.

    Attributes:
        position_mm: of positions [mm].
        orientation_deg: of orientations [deg].
    """

    position_mm: float | None = None
    orientation_deg: float | None = None


@dataclass(frozen=True)
class Judged:
    """A recording and its calibration.

    Attributes:
        seconds: its length [s].
        stated: what the calibration states.
        true: what is true.
        verdict: of the calibration, or why there is none.
        tree_right: whether the tree is right.
    """

    seconds: float
    stated: Deviations = Deviations()
    true: Deviations = Deviations()
    verdict: str = ""
    tree_right: bool = False


@dataclass(frozen=True)
class Figures:
    """What came of it: foreseen, found from the plan, and from the default recording."""

    foreseen: Deviations
    planned: Judged
    default: Judged


Loop = Record[Case, Figures]
"""One line of the output."""


def perform(case: Case) -> Figures:
    """Do a case."""
    import pinocchio as pin

    warnings.simplefilter("ignore")
    spec, of = load_robot(case.robot), with_model(case.robot)
    default = simulate(spec, SimulationSettings(grade=case.grade, seed=case.seed))
    mechanism = load_mechanism(spec, spec.base_rpy)
    placed = [PlacedSu(su.name, su.joint, su.T_joint_su) for su in default.truth.sus]
    R = np.asarray(pin.rpy.rpyToMatrix(*spec.base_rpy))
    model = kinematic_model(mechanism.model, list(mechanism.prismatic), R, placed)
    minutes = case.part * default.recording.duration / 60
    plan = make_plan(of.limits, PlanSettings(minutes=minutes, seed=case.seed), model, of.checker)
    seen = expected(plan.trajectory, model, sensors_of(GRADES[case.grade]))
    known = np.array([verdict != _OPEN for verdict in seen.observability.su_verdict])
    foreseen = _deviations(seen.position[known], seen.orientation[known])
    of_default = Judged(default.recording.duration)
    if case.default:
        of_default = judged(default)
    del default
    follow = SimulationSettings(grade=case.grade, seed=case.seed, plan=rounded(plan.trajectory))
    return Figures(foreseen, judged(simulate(spec, follow)), of_default)


def judged(simulation: Simulation) -> Judged:
    """Calibrate a recording from its file, as users do, and hold what is stated against the truth.

    Stamps that scatter are smoothed where a file is read, and not in a recording in memory.
    """
    plain = Judged(simulation.recording.duration)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.mcap"
        write(simulation.recording, log)
        try:
            found = calibrate(log, CalibrationSettings(gravity_deviation=ANOMALY))
        except Skin2UrdfError as error:
            return replace(plain, verdict=str(error).splitlines()[0])
    verdicts = dict(zip(found.model.tree.su_names, found.observability.su_verdict, strict=True))
    known = np.array([verdict != _OPEN for verdict in verdicts.values()])
    low, high = found.limits.T
    q = low + (high - low) * np.random.default_rng(0).random((200, len(low)))
    position, orientation = aligned_deviations(found.estimate, found.observability, q)
    stated = _deviations(position[known], orientation[known])
    plain = replace(plain, stated=stated, verdict=found.quality)
    return _compared(plain, found, simulation, {n for n, v in verdicts.items() if v != _OPEN})


def _compared(plain: Judged, found: Calibration, simulation: Simulation, known: set[str]) -> Judged:
    """The same with the true errors of SUs whose names are given."""
    with tempfile.TemporaryDirectory() as folder:
        urdf, _ = save(found, Path(folder) / "robot.urdf", visuals=False)
        true = Path(folder) / "truth.urdf"
        true.write_text(simulation.truth.urdf, encoding="utf-8")
        held = compare(urdf, true, rng=np.random.default_rng(0))
    sus = [su for su in held.sus if su.name in known]
    position = np.array([su.position.rms for su in sus if su.position])
    orientation = np.array([su.orientation.rms for su in sus if su.orientation])
    return replace(plain, true=_deviations(position, orientation), tree_right=held.tree_equal)


def _deviations(position: np.ndarray, orientation: np.ndarray) -> Deviations:
    """Root mean squares from metres and radians."""
    in_mm, in_deg = rms(1e3 * position), rms(_DEG * orientation)
    return Deviations(in_mm, in_deg)
